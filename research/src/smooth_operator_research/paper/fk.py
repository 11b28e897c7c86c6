"""Experiment ``fk``: libraries of forward kinematics over the size of the batch."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.formats.jsonable import to_json
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark.quality import Watch
from smooth_operator.lab.offline.finished import digest
from smooth_operator_research.paper import fk_libraries
from smooth_operator_research.paper.experiment import (
    Drawing,
    ExperimentContext,
    Outcome,
    Table,
    cell_job,
)
from smooth_operator_research.paper.figures import fk_figure
from smooth_operator_research.paper.fk_libraries import (
    AGREEMENT,
    LIBRARIES,
    MJX,
    MUJOCO,
    OURS,
    PINOCCHIO,
    PYTORCH,
    Library,
    Run,
    disagreement,
    library_version,
    make_library,
    missing,
    random_poses,
    write_urdf,
)
from smooth_operator_research.paper.intervals import (
    Estimate,
    Samples,
    contrast,
    independent,
    typical,
)
from smooth_operator_research.paper.more_sizes import more_size
from smooth_operator_research.paper.verdicts import Direction, Verdict, judge

INSTALL: Final = 'python -m pip install "./research[fk]"'
"""Command that installs the compared libraries, in a clone."""
SLICE_S: Final = 0.05
"""A round repeats a call for so long [s], or makes one that takes longer."""

CHECKED: Final = 200
"""Poses that a library must agree on before it is timed."""


@dataclass(frozen=True, eq=False)
class Timing:
    """What was measured.

    Attributes:
        batches: sizes.
        per_pose: library -> batch -> one figure for each round [ns].
        gaps: library -> why it has none.
        worst: library -> its largest disagreement with MuJoCo [m].
        others: the largest share of the cores that other processes took; None where unknown.
    """

    batches: Sequence[int]
    per_pose: Mapping[str, Mapping[int, list[float]]]
    gaps: Mapping[str, str]
    worst: Mapping[str, float]
    others: float | None

    def rounds(self, library: str, batch: int) -> Samples:
        """Time a pose in each round [ns]; all count, since those kept by their speed would differ
        less than the machine does."""
        return independent(self.per_pose[library][batch])

    def mean(self, library: str, batch: int) -> Estimate:
        """Time a pose [ns], geometric, with an interval over rounds."""
        return typical(self.rounds(library, batch))

    def over(self, slow: str, fast: str, batch: int) -> Estimate:
        """How many times as long one takes as another, round by round."""
        return contrast(self.rounds(slow, batch), self.rounds(fast, batch), "ratio")


class FkLibraries:
    """Ours, MJX, Pinocchio, PyTorch Kinematics and MuJoCo's C on the same poses."""

    title = "Libraries of forward kinematics"
    claim = "MJX is fast enough even at large batch sizes, and was chosen for it"

    def run(self, context: ExperimentContext) -> Outcome:
        """See ``Experiment``."""
        hand = load_hand(context.hand, context.sources[0].side)
        timing = time_libraries(context, hand)
        device = str(context.store.environment["device"])
        return Outcome(
            f"Fingertips of {hand.name} ({len(hand.joint_names)} joints) in its palm frame, from "
            "the same random poses within the limits, given beforehand in the form that each "
            "library likes best; the model of Pinocchio and PyTorch Kinematics is URDF that is "
            "written from the compiled one. Before the clock starts each must agree with MuJoCo's "
            f"own kinematics on {CHECKED} poses to {1e6 * AGREEMENT:g} µm. Warm; libraries take "
            f"turns, {more_size(context).fk_rounds} rounds, and are compared round by round; a "
            f"round is the median of the calls in {1e3 * SLICE_S:g} ms. Intervals are over the "
            "rounds of this run on this machine, and say nothing of another. Ours, MJX and PyTorch "
            f"Kinematics compute in float32 and on as many threads as they like ({device}); "
            "Pinocchio and MuJoCo C in float64, a pose at a time in a Python loop, since they have "
            "no batch."
            + "".join(f" {name}: {why}, so there is a gap." for name, why in timing.gaps.items()),
            [_paper_verdict(timing), _own_verdict(timing)],
            [_table(timing)],
            [
                Drawing(
                    "fk",
                    "Time a pose over the size of the batch; lower is faster. Bars: 95 % intervals "
                    "over rounds, mostly smaller than the marks. Libraries that are missing here "
                    "are named.",
                    fk_figure(timing.batches, timing.mean, list(timing.per_pose), timing.gaps),
                )
            ],
            {
                "batches": timing.batches,
                "ns_per_pose": timing.per_pose,
                "gaps": timing.gaps,
                "disagreement_m": timing.worst,
                "versions": {name: library_version(name) for name in timing.per_pose},
                "others": timing.others,
            },
        )


def time_libraries(context: ExperimentContext, hand: Hand) -> Timing:
    """Times what is installed and agrees; the other libraries are gaps with a reason."""
    gaps = {name: why for name in LIBRARIES if (why := missing(name)) is not None}
    library: Callable[[str], Library] = cache(lambda name: make_library(name, hand))
    here = [name for name in LIBRARIES if name not in gaps]

    def key(kind: str, names: Sequence[str], **more: Any) -> dict[str, Any]:
        versions = {name: library_version(name) for name in names}
        model = [write_urdf(hand).text, to_json(hand.limits), digest(Path(fk_libraries.__file__))]
        return {
            "kind": kind,
            "libraries": versions,
            "model": model,
            "machine": context.store.machine,
            **more,
        }

    def checked(name: str, advance: object) -> dict[str, np.ndarray]:
        return {
            "worst": np.array(disagreement(library(name), hand, random_poses(hand, CHECKED, 0)))
        }

    jobs = [
        cell_job(f"{name}: agreement", key("fk-check", [name]), 3000.0, partial(checked, name))
        for name in here
    ]
    cells = context.finish("agreement of the libraries", jobs)
    worst = {name: float(cell["worst"]) for name, cell in zip(here, cells, strict=True)}
    for name, error in worst.items():
        if not error < AGREEMENT:  # NaN is none
            gaps[name] = f"its fingertips are up to {error:.1e} m from MuJoCo's, so it is not timed"
    here = [name for name in here if name not in gaps]

    size = more_size(context)

    def timed(batch: int, advance: Callable[[float], None]) -> dict[str, np.ndarray]:
        poses = random_poses(hand, batch, 1)
        watch = Watch()
        runs = {name: library(name).prepare(poses) for name in here}
        times = rounds_of(runs, size.fk_rounds, lambda: advance(1 / size.fk_rounds))
        others = watch.others()
        return {
            "names": np.array(here),
            "ns": 1e9 * np.array([times[name] for name in here]) / batch,
            "others": np.array(np.nan if others is None else others),
        }

    jobs = [
        cell_job(
            f"batch {batch:,}", key("fk-time", here, batch=batch, rounds=size.fk_rounds),
            1000.0 + size.fk_rounds * len(here) * max(50.0, 0.03 * batch),
            lambda advance, b=batch: timed(b, advance),  # type: ignore[misc]
        )
        for batch in size.fk_batches
    ]  # fmt: skip
    cells = context.finish("forward kinematics", jobs)
    shares = [float(cell["others"]) for cell in cells if np.isfinite(cell["others"])]
    per_pose = {
        name: {
            batch: cell["ns"][list(cell["names"]).index(name)].tolist()
            for batch, cell in zip(size.fk_batches, cells, strict=True)
        }
        for name in here
    }
    return Timing(size.fk_batches, per_pose, gaps, worst, max(shares, default=None))


def rounds_of(
    runs: Mapping[str, Run], rounds: int, done: Callable[[], None]
) -> dict[str, list[float]]:
    """Times of calls that take turns, so that noise of the machine hits all alike.

    Args:
        runs: name -> what is timed.
        rounds: how many; who begins changes from one to the next.
        done: called after each.

    Returns:
        name -> one time for each round [s].
    """
    for run in runs.values():  # compiles, fills caches, wakes the clock
        run()
        run()
    names = list(runs)
    times: dict[str, list[float]] = {name: [] for name in names}
    for turn in range(rounds):
        for name in names if turn % 2 == 0 else names[::-1]:
            times[name].append(_round(runs[name]))
        done()
    return times


def _round(run: Run) -> float:
    calls: list[float] = []
    started = time.perf_counter()
    while not calls or time.perf_counter() - started < SLICE_S:
        before = time.perf_counter()
        run()
        calls.append(time.perf_counter() - before)
    return float(np.median(calls))


def _paper_verdict(timing: Timing) -> Verdict:
    largest = timing.batches[-1]
    rivals = [name for name in (PINOCCHIO, PYTORCH) if name in timing.per_pose]
    absent = [name for name in (MJX, PINOCCHIO, PYTORCH) if name not in timing.per_pose]
    claim = f"MJX is the fastest of the three at large batches ({largest:,} here)"
    gaps = "; ".join(f"{name}: {timing.gaps[name]}" for name in absent)
    note = f"Missing here: {gaps}. `{INSTALL}` brings them." if absent else ""
    if MJX not in timing.per_pose or not rivals:
        return Verdict(claim, "fastest, no figure", "not measured", "not shown", note)
    ratios = {name: timing.over(name, MJX, largest) for name in rivals}
    shown = ", ".join(f"{name} × {one.shown(3)}" for name, one in ratios.items())
    held = judge(Direction(1.0, upwards=True), list(ratios.values()), missing=len(absent))
    return Verdict(claim, "fastest, no figure", f"time over MJX's: {shown}", held, note)


def _own_verdict(timing: Timing) -> Verdict:
    rivals = [name for name in (MJX, PINOCCHIO, PYTORCH, MUJOCO) if name in timing.per_pose]
    batches = [batch for batch in timing.batches if batch >= 64]
    claim = "ours: the unrolled program is faster than any of them from a batch of 64 on"
    if OURS not in timing.per_pose or not rivals or not batches:
        why = timing.gaps.get(OURS, "there is nothing to compare it with")
        return Verdict(claim, "no claim", "not measured", "not shown", why)
    ratios = {(batch, name): timing.over(name, OURS, batch) for batch in batches for name in rivals}
    largest = timing.batches[-1]
    each = ", ".join(f"{name} × {ratios[largest, name].shown(3)}" for name in rivals)
    held = judge(Direction(1.0, upwards=True), list(ratios.values()))
    return Verdict(claim, "no claim", f"at {largest:,}: {each}", held)


def _table(timing: Timing) -> Table:
    rows = [
        [f"{batch:,}", *(timing.mean(name, batch).shown(3) for name in timing.per_pose)]
        for batch in timing.batches
    ]
    apart = ", ".join(f"{name} {1e6 * error:.2g} µm" for name, error in timing.worst.items())
    busy = (
        "" if timing.others is None
        else f" Other processes took up to {100 * timing.others:.0f} % of the cores."
    )  # fmt: skip
    return Table(
        "Time a pose [ns]",
        ["batch", *timing.per_pose],
        rows,
        "Geometric means with 95 % intervals over rounds. Largest disagreement with MuJoCo's "
        f"fingertips: {apart}." + busy,
    )
