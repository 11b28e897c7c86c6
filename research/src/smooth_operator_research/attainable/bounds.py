r"""A bound on what any retargeting method could reach on a recording, frame by frame.

    python -m smooth_operator_research.attainable.bounds --data RECORDINGS
    python -m smooth_operator_research.attainable.bounds glove.npz@2600:3100 synthetic:11 \
        --methods smooth sbr dexpilot
    python -m smooth_operator_research.attainable.bounds synthetic:11 --every 20 --starts 12 48 96

For each frame alone, with no regard to smoothness, latency or what came before, the pose is sought
whose keyvectors point most like the human's: once those from the thumb to the other tips, once all
15. It must lie within the joint limits, and no two parts of the hand may be deeper than 2 mm in
each other. The better the direction of a pinch, the wider its gap, so this is done for several
limits of the gap: wherever the human's tips are under 15 mm apart (a pinch), the robot's may be at
most ``--gaps`` millimetres further apart. The tables have the methods on the same frames as well.

A method may be above the bound of a limit, because it keeps its gaps wider, or its parts deeper in
each other; it cannot be above the last line, that of no limit, unless it is too deep.

How to read it: what is found is the best of many local searches, so the bound itself may lie
higher, never lower. ``--starts 12 48 96`` repeats the search with more and more starts and shows
what that gains: if it gains nothing, the figures are the bound for all practical purposes. Some
gaps can't be reached at all, since fingertips have a thickness; such frames count as not solved.
Columns named "solved" are of the solved frames alone, on both sides; all others are of all frames,
with the narrowest gap that was found where a frame is not solved. "Gap in the mean" limits the mean
gap alone: some pinches may be wider for others that gain less. In the row of a method it is what
was attainable at that method's own mean gap.

Recordings are named as for ``smooth-operator bench``. Those of ``--data`` are the folder's glove
recording (frames 0-499 and 2600-3099), ``human_alex`` and ``wilor_test_long``; ``synthetic:11``
comes with them. The picture shows the attainable thumb cosine of pinching frames against the pinch
gap, a line for each recording, methods as points.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from smooth_operator import SmoothOperatorError
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.lab.benchmark.recordings import Source, load_sources, parse_request
from smooth_operator.lab.benchmark.settings import method_label, select_methods
from smooth_operator.metrics import summary
from smooth_operator.metrics.accuracy import PINCH_DISTANCE
from smooth_operator.parallel import run_tasks
from smooth_operator_research.attainable.pose_search import Aim
from smooth_operator_research.attainable.samples import (
    BINS,
    Sampled,
    Sums,
    draw,
    sample,
    spread,
    sums_of,
)
from smooth_operator_research.attainable.search import TOLERANCE, Attained, Frames, attain
from smooth_operator_research.judging.judge import FILES, GLOVE
from smooth_operator_research.run_report import RESULTS, BenchmarkError, Report

NAMES = tuple(name for name in FILES if name != GLOVE)
"""Of the judge's recordings all but the whole glove, whose windows are among them."""
OPERATOR = "synthetic:11"
CHUNK = 14
"""Frames of a task: they try each other's answers, and a core is never long at one task."""


@dataclass(frozen=True)
class Settings:
    """What to look at.

    Attributes:
        recordings: named as for ``smooth-operator bench``; the built-in operator, if left out.
        data: folder of the recordings that are always looked at.
        hand: robot hand.
        methods: METHOD, METHOD:PRESET or METHOD:FILE.toml; the first is in the tables, all are
            starts of the search and points of the picture.
        gaps: limits of a pinch's gap beyond the human's [mm]; no limit is always among them.
        frames: of each recording to look at, about, evenly spread.
        every: look at each N-th frame instead.
        aims: which mean cosines to seek: thumb, all.
        starts: starts of each search; more than one number repeats it and shows the gain.
        finish: how many of the starts are finished by SLSQP; a sixth of them, if that is more.
        rounds: at most, in which frames try what their neighbours found.
        seed: of random starts and of the methods' random numbers.
        workers: processes; one for each core, if left out, and none with 0.
        output: JSON file; a Markdown file and a picture of the same name stand next to it.
        compare: an earlier JSON file to compare this run with.
    """

    recordings: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    data: Path | None = None
    hand: str = "mimic_p050"
    methods: tuple[str, ...] = ("smooth",)
    gaps: tuple[float, ...] = (0.0, 1.0, 2.0, 3.0, 5.0)
    frames: int = 40
    every: int | None = None
    aims: tuple[Aim, ...] = ("thumb", "all")
    starts: tuple[int, ...] = (48,)
    finish: int = 4
    rounds: int = 5
    seed: int = 0
    workers: int | None = None
    output: Path = RESULTS / "attainable.json"
    compare: Path | None = None

    @property
    def limits(self) -> tuple[float, ...]:
        """Of the gaps [m], rising, no limit last."""
        return (*(1e-3 * gap for gap in sorted(set(self.gaps))), float("inf"))


def main(settings: Settings) -> None:
    """Searches, and writes tables and pictures."""
    dispatch_here()
    if min(settings.frames, settings.every or 1, settings.finish) < 1 or settings.rounds < 0:
        raise BenchmarkError("--frames, --every and --finish must be 1 or more, --rounds 0 or more")
    if not settings.starts or min(settings.starts) < 1:
        raise BenchmarkError("--starts needs numbers of 1 or more")
    if not settings.aims or not settings.methods:
        raise BenchmarkError("--aims and --methods need one word at least")
    if any(not gap >= 0 for gap in settings.gaps):
        raise BenchmarkError("--gaps must not be negative [mm]")
    choices = select_methods(settings.methods)
    report = Report("attainable", vars(settings))
    begun = time.perf_counter()
    samples = [
        sample(source, settings.hand, choices, settings.every, settings.frames, settings.seed)
        for source in sources_of(settings)
    ]
    results = [search(settings, samples, starts) for starts in sorted(settings.starts)]
    first = method_label(choices[0].method, choices[0].preset)
    for i, one in enumerate(samples):
        tables(report, settings, one, results[-1][i], first)
    convergence(report, settings, samples, results)
    report.notes += [
        "a lower estimate of the bound: the best of local searches, each frame alone; see "
        "the gain with the number of starts, and of the last round in which frames try their "
        "neighbours' answers",
        "solved: all limits kept to 0.05 mm by the exact shapes; elsewhere the narrowest gap found",
        f"scale of the human: that of each frame, for all alike; pinch: under "
        f"{1e3 * PINCH_DISTANCE:g} mm between the human's tips on that scale",
        "gap in the mean: attainable thumb cosine if only the mean gap is limited, to the human's "
        "and so much, or to a method's own mean gap; a frame is then as wide as pays most",
        "all-15 cosine: attainable when it is sought itself; the other columns are of the poses "
        "that the thumb cosine is sought with",
        f"took {time.perf_counter() - begun:.0f} s",
    ]
    report.finish(settings.output, settings.compare)
    notes = "".join(f"- {note}\n" for note in report.notes)
    text = f"{report.tables()}\n\n{notes}"
    settings.output.with_suffix(".md").write_text(text, encoding="utf-8")
    shown = [one.get("thumb") or one["all"] for one in results[-1]]
    draw(samples, shown, settings.limits, settings.output.with_suffix(".png"))


def sources_of(settings: Settings) -> list[Source]:
    """The recordings that are asked for."""
    words = list(settings.recordings)
    if settings.data is not None:
        words += [str(settings.data / name) for name in NAMES]
    if settings.data is not None or not words:
        words.append(OPERATOR)
    sources = load_sources([parse_request(word) for word in words])
    for source in sources:
        if source.error is not None:
            raise BenchmarkError(source.error)
    return sources


def search(
    settings: Settings, samples: Sequence[Sampled], starts: int
) -> list[dict[Aim, Attained]]:
    """For each recording what was found, of every aim."""
    tasks, owner = [], []
    for i, one in enumerate(samples):
        count = len(one.frames)
        for part in np.array_split(np.arange(count), max(1, round(count / CHUNK))):
            owner.append(i)
            tasks.append(Frames(
                settings.hand, one.side, one.human[part], one.known[part], settings.limits,
                settings.aims, starts, max(settings.finish, starts // 6), settings.rounds,
                settings.seed,
            ))  # fmt: skip
    parts: dict[int, dict[Aim, Attained]] = {}
    for result in run_tasks(attain, tasks, workers=settings.workers):
        if result.value is None:
            raise BenchmarkError(f"{samples[owner[result.index]].name}: {result.error}")
        parts[result.index] = result.value
        print(f"{len(parts)} of {len(tasks)} parts, {starts} starts", file=sys.stderr)
    return [
        {aim: joined([parts[k][aim] for k in sorted(parts) if owner[k] == i])
         for aim in settings.aims}
        for i in range(len(samples))
    ]  # fmt: skip


def joined(parts: Sequence[Attained]) -> Attained:
    """Parts of a recording as one."""
    rounds = max(len(part.gains) for part in parts)
    weights = [part.value.shape[1] for part in parts]
    gains = [[*part.gains, *[0.0] * (rounds - len(part.gains))] for part in parts]
    return Attained(
        np.concatenate([part.poses for part in parts], axis=1),
        np.concatenate([part.value for part in parts], axis=1),
        np.concatenate([part.excess for part in parts], axis=1),
        tuple(float(gain) for gain in np.average(gains, axis=0, weights=weights)),
    )


def tables(
    report: Report, settings: Settings, one: Sampled, attained: dict[Aim, Attained], method: str
) -> None:
    """Those of a recording: what is attainable, and which lengths the rest comes from."""
    shown = attained.get("thumb") or attained["all"]
    robots = [one.vectors(poses) for poses in shown.poses]
    for title, chosen in (("all frames", one.pinching | True), ("pinching frames", one.pinching)):
        if not chosen.any():
            report.notes.append(f"{one.name}: no pinch among the frames looked at")
            continue
        rows: list[list[object]] = []
        human = sums_of(one, one.human, chosen)
        shared = partial(spread, one, shown.poses, chosen)

        for g, gap in enumerate(settings.limits):
            solved = chosen & (shown.excess[g] <= TOLERANCE)
            got = sums_of(one, robots[g], chosen)
            alone = sums_of(one, robots[g], solved) if solved.any() else Sums()
            methods_sums = sums_of(one, one.answers[method], solved) if solved.any() else Sums()
            every = (
                summary.mean(attained["all"].value[g][chosen]) if "all" in attained else got.every
            )
            over = summary.scaled(summary.mean(shown.excess[g][chosen & ~solved]), 1e3)
            mean = None if human.gap_mm is None else human.gap_mm + 1e3 * gap
            rows.append([label(gap), f"{solved.sum()}/{chosen.sum()}", got.thumb, shared(mean),
                         every, got.gap_mm, got.scale, alone.thumb, methods_sums.thumb,
                         over])  # fmt: skip
            figures = {
                "thumb_cosine": got.thumb, "all_cosine": every, "pinch_gap_mm": got.gap_mm,
                "scale_ratio": got.scale, "solved_share": summary.mean(solved[chosen]),
                "solved_thumb_cosine": alone.thumb, "solved_beside": methods_sums.thumb,
                "mean_gap_thumb_cosine": shared(mean),
            }  # fmt: skip
            report.add(f"{one.name}/{title}/{label(gap)}", figures)
        for name, answers in one.answers.items():
            got, deep = sums_of(one, answers, chosen), one.depths[name][chosen] > TOLERANCE
            rows.append([name, f"{deep.sum()} too deep", got.thumb, shared(got.gap_mm),
                         got.every, got.gap_mm, got.scale, None, None, None])  # fmt: skip
            figures = {
                "thumb_cosine": got.thumb, "all_cosine": got.every, "pinch_gap_mm": got.gap_mm,
                "scale_ratio": got.scale, "too_deep_share": summary.mean(deep),
                "attainable_at_its_mean_gap": shared(got.gap_mm),
            }  # fmt: skip
            report.add(f"{one.name}/{title}/{name}", figures)
        rows.append(["human", "", 1.0, shared(human.gap_mm), 1.0, human.gap_mm, 1.0,
                     None, None, None])  # fmt: skip
        header = (
            "robot's gap, human's and", "solved", "thumb cosine", "gap in the mean",
            "all-15 cosine", "pinch gap [mm]", "scale ratio", "thumb cosine, solved",
            f"{method}, solved", "unsolved: too wide by [mm]",
        )  # fmt: skip
        report.table(f"{one.name}, {title}, {settings.hand}", header, rows)
    lengths = 1e3 * np.linalg.norm(one.human[:, one.thumb], axis=-1)
    parts: list[list[object]] = []
    for low, high in BINS:
        inside = (lengths >= low) & (lengths < high)
        lost = [float((1 - one.thumb_cosines(v))[inside].sum() / inside.size)
                for v in (one.answers[method], *robots)]  # fmt: skip
        name = f"{low:g}-{high:g}" if np.isfinite(high) else f"over {low:g}"
        parts.append([name, float(inside.mean()), *lost])
        names = (method, *(label(gap) for gap in settings.limits))
        report.add(f"{one.name}/lost/{name} mm", dict(zip(names, lost, strict=True)))
    limits = [label(gap) for gap in settings.limits]
    title = f"{one.name}, what 1 - thumb cosine is made of, all frames"
    report.table(title, ("human's length [mm]", "share", method, *limits), parts)


def convergence(
    report: Report,
    settings: Settings,
    samples: Sequence[Sampled],
    attained: Sequence[Sequence[dict[Aim, Attained]]],
) -> None:
    """What more starts gain, and the rounds."""
    rows: list[list[object]] = []
    limits = [label(gap) for gap in settings.limits]
    for i, one in enumerate(samples):
        chosen = one.pinching if one.pinching.any() else ~one.pinching
        for aim in settings.aims:
            always = np.all([run[i][aim].excess <= TOLERANCE for run in attained], axis=0)
            for starts, results in zip(sorted(settings.starts), attained, strict=True):
                got = results[i][aim]
                value = [summary.mean(row[columns]) for row, columns in
                         zip(got.value, always & chosen, strict=True)]  # fmt: skip
                solved = [int((row[chosen] <= TOLERANCE).sum()) for row in got.excess]
                wide = [summary.mean(row[chosen]) or 0.0 for row in got.excess]
                cells = [
                    f"{'–' if v is None else f'{v:.4f}'} ({n}, {1e3 * w:.2f} mm)"
                    for v, n, w in zip(value, solved, wide, strict=True)
                ]
                gains = ", ".join(f"{gain:.0e}" for gain in got.gains)
                rows.append([f"{one.name}, {aim}", starts, *cells, gains])
                figures = dict(zip(limits, value, strict=True))
                report.add(f"{one.name}/starts {starts}/{aim}", figures)
    title = (
        "convergence, pinching frames: the cosine sought, on those that all runs solve "
        "(how many this run solves, by how much gaps are too wide in the mean)"
    )
    header = ("", "starts", *limits, "gain by round, a gap's mm counts 10")
    report.table(title, header, rows)


def label(gap: float) -> str:
    """How a limit of the pinch gap is called in tables."""
    return f"+{1e3 * gap:g} mm" if np.isfinite(gap) else "no limit"


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
