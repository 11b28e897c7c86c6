"""Every hand, every method, both sides: quality on recordings and the operator, and a round trip.

    python research/benchmarks/hands.py glove.npz@2600:2800 video.npz@30hz synthetic@10hz
    python research/benchmarks/hands.py synthetic@10hz --hands shadow_dexee --methods sbr dexpilot

A recording is named as for ``smooth-operator bench``. It drives the hands of its own side as it is,
and those of the other side mirrored. The round trip goes from poses of the robot to their landmarks
and back. What a method can't do for a hand stands in the notes with the reason. Latencies are
those of cells that run one after the other in one process.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from smooth_operator import HandRecording, SmoothOperatorError, hand_names, load_hand
from smooth_operator.baselines.geort import GeortConfig, built_in_model, write_geort_model
from smooth_operator.hands.hand import Hand
from smooth_operator.lab.benchmark.recordings import load_sources, parse_request
from smooth_operator.lab.offline import build, execute
from smooth_operator.lab.training import (
    GeortTrainer,
    GeortTraining,
    synthetic_recordings,
    training_data,
)
from smooth_operator.lab.validation import round_trip
from smooth_operator.methods.presets import PRESETS, method_config, method_names
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.metrics import METRICS, evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.planning import Plan
from smooth_operator.types import Side
from smooth_operator_research.run_report import BenchmarkError, Report

SIDES = ("right", "left")
COLUMNS = {
    "cosine_similarity": "cos thumb",
    "cosine_similarity_all": "cos all",
    "scale_ratio": "scale",
    "motion_preservation": "motion",
    "flatness": "flatness [m²]",
    "pinch_error_mm": "pinch [mm]",
    "frozen_share": "frozen",
    "limit_violation_share": "beyond limits",
    "self_collision.share": "collision > 2 mm",
    "latency_ms.p50": "p50 [ms]",
    "latency_ms.p95": "p95 [ms]",
    "latency_ms.p99": "p99 [ms]",
    "held": "held frames",
}
"""What is kept of each cell; ``held`` counts frames that were not answered."""
TRIP = {
    "free_median_mm": "round trip, median [mm]",
    "free_p95_mm": "p95 [mm]",
    "median_mm": "with the pull to neutral, median [mm]",
    "p95_mm": "p95 [mm]",
}
"""What is kept of the round trip; of the two sides the worse is shown."""
WORST = ("frozen_share", "limit_violation_share", "held")
"""Of these the worst cell is shown, of the others the mean."""

Cells = dict[tuple[str, str, str, str], dict[str, float | None]]
"""(hand, side, method, recording) -> figures."""
Trips = dict[tuple[str, str], dict[str, float]]
"""(hand, side) -> figures of the round trip."""


@dataclass(frozen=True)
class Settings:
    """What to run.

    Attributes:
        recordings: PATH or synthetic[:SEED], with settings after an @.
        frames: range A:B of the frames of those that name none.
        rate: frame rate of files without stamps [Hz].
        hands: which hands; all of the catalogue if none is named.
        methods: which methods; all if none is named.
        sides: of the robot.
        poses: of the round trip of sbr; 0 leaves it out.
        geort_epochs: epochs of a GeoRT model for each hand without a built-in one, trained on the
            built-in operators; 0 for none, so that GeoRT serves hands with a built-in model only.
        seed: of the methods and of the poses.
        output: JSON file; build/benchmarks/hands.json unless given.
        compare: an earlier JSON file to compare this run with.
    """

    recordings: Annotated[tuple[str, ...], tyro.conf.Positional] = ("synthetic@10hz",)
    frames: str = ":200"
    rate: float | None = None
    hands: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    sides: tuple[str, ...] = SIDES
    poses: int = 40
    geort_epochs: int = 0
    seed: int = 0
    output: Path | None = None
    compare: Path | None = None


def main(settings: Settings) -> None:
    hands = settings.hands or hand_names()
    methods = settings.methods or method_names()
    requests = [
        parse_request(text, frames=settings.frames, rate=settings.rate)
        for text in settings.recordings
    ]
    sources = load_sources(requests)
    recordings = [replace(s.recording, name=s.name) for s in sources if s.recording is not None]
    report = Report("hands", vars(settings))
    report.notes += [f"{s.name}: {s.error}" for s in sources if s.error is not None]
    report.notes += [f"{r.name}: {len(r)} frames at {r.rate_hz:.0f} Hz" for r in recordings]

    cells, trips = measure_all(report, settings, hands, methods, recordings)
    if not cells:
        raise BenchmarkError("nothing could be measured: " + "; ".join(report.notes))
    show(report, cells, trips, methods)
    report.finish(settings.output, settings.compare)


def measure_all(
    report: Report,
    settings: Settings,
    hands: Sequence[str],
    methods: Sequence[str],
    recordings: Sequence[HandRecording],
) -> tuple[Cells, Trips]:
    """All cells, hand by hand; Ctrl-C ends it early and keeps what there is."""
    cells: Cells = {}
    trips: Trips = {}
    total = len(hands) * len(settings.sides) * len(methods)
    with tempfile.TemporaryDirectory() as at, bar(total) as advance:
        for name, side, method in product(hands, settings.sides, methods):
            line = f"{name} {side} {method}"
            try:
                todo = plan_for(load_hand(name, side), method, settings, Path(at))
                built = build(todo)
                for recording in recordings:
                    mine = recording if recording.side == side else mirrored(recording)
                    figures = measured(replace(todo, recording=mine), built)
                    cells[name, side, method, recording.name] = figures
                    report.add(f"{name}/{side}/{method}/{recording.name}", figures)
                    line += f" {figures['cosine_similarity'] or np.nan:.3f}"
                if method == "sbr" and settings.poses:
                    trips[name, side] = trip(built[0], todo, settings)
                    report.add(f"{name}/{side}/round_trip", trips[name, side])
                    line += f", round trip {trips[name, side]['free_median_mm']:.2f} mm"
            except SmoothOperatorError as error:
                report.notes.append(f"{name}, {side}, {method}: {error}")
                line += ": refused"
            except KeyboardInterrupt:
                report.notes.append(f"stopped at {line}: what comes after it is missing")
                break
            advance(line)
    return cells, trips


def plan_for(hand: Hand, method: str, settings: Settings, at: Path) -> Plan:
    """The method's default preset on a hand, without a recording as yet."""
    config = method_config(method)
    if (
        isinstance(config, GeortConfig)
        and settings.geort_epochs
        and built_in_model(hand.name) is None
    ):
        # A mirrored hand is served by the other side's model.
        side = "right" if hand.spec.mirror else hand.spec.side
        model = at / f"{hand.name}_{side}.npz"
        if not model.exists():
            train(load_hand(hand.name, side), settings, model)
        config = replace(config, model=model)
    nothing = HandRecording(np.zeros((1, 21, 3)), np.zeros(1), hand.spec.side)
    return Plan(nothing, hand, method, next(iter(PRESETS[method])), config, settings.seed)


def train(hand: Hand, settings: Settings, model: Path) -> None:
    training, apart = synthetic_recordings(hand.spec.side)
    how = GeortTraining(epochs=settings.geort_epochs)
    trainer = GeortTrainer(hand, training_data(training, hand, how, apart), how)
    state = trainer.init()
    for later in trainer.epochs(state):
        state = later
    write_geort_model(model, trainer.model(state))


def mirrored(recording: HandRecording) -> HandRecording:
    """The same as a hand of the other side would have done it: x of the tracker's frame flipped."""
    landmarks = recording.landmarks * (-1.0, 1.0, 1.0)
    side: Side = "left" if recording.side == "right" else "right"
    return HandRecording(landmarks, recording.stamps, side, recording.valid, name=recording.name)


def measured(todo: Plan, built: tuple[Retargeter, float]) -> dict[str, float | None]:
    commands = execute(todo, built).commands
    trace = assemble_trace(
        todo.recording, commands, todo.hand, todo.config.alignment, reach_samples=0
    )
    figures = evaluate(trace, extra={"held": float((commands.status != 0).sum())})
    metrics = {metric.name: metric for metric in METRICS}
    values = {n: metrics[n].of(figures) if n in metrics else figures[n] for n in COLUMNS}
    return {n: float(v) if isinstance(v, int | float) else None for n, v in values.items()}


def trip(built: Retargeter, todo: Plan, settings: Settings) -> dict[str, float]:
    """From random poses to landmarks and back: as configured, and without the pull to neutral."""
    free = build(replace(todo, config=todo.config.without_pull()))[0]
    figures: dict[str, float] = {}
    for name, retargeter in (("", built), ("free_", free)):
        result = round_trip(retargeter, poses=settings.poses, seed=settings.seed)
        figures |= {f"{name}median_mm": result.median, f"{name}p95_mm": result.p95}
    return figures


def show(
    report: Report,
    cells: Cells,
    trips: Trips,
    methods: Sequence[str],
) -> None:
    """Tables: one method on all hands in full, then a figure of all methods on all hands."""
    hands = list(dict.fromkeys(key[0] for key in cells))
    first = methods[0]

    def of(hand: str | None, method: str, figure: str) -> float | None:
        chosen = (v[figure] for k, v in cells.items() if hand in (None, k[0]) and k[2] == method)
        values = [v for v in chosen if v is not None]
        return None if not values else max(values) if figure in WORST else float(np.mean(values))

    def went(hand: str, figure: str) -> float | None:
        values = [v[figure] for k, v in trips.items() if k[0] == hand]
        return max(values) if values else None

    figures = [f for f in COLUMNS if not f.startswith("latency")]
    report.table(
        f"{first} on every hand, mean over recordings and sides",
        ("hand", *(COLUMNS[f] for f in figures), *TRIP.values()),
        [
            [hand, *(of(hand, first, f) for f in figures), *(went(hand, f) for f in TRIP)]
            for hand in hands
        ],
    )
    for figure in ("cosine_similarity", "cosine_similarity_all", "scale_ratio",
                   "motion_preservation", "pinch_error_mm", "self_collision.share"):  # fmt: skip
        report.table(
            f"{COLUMNS[figure]}, mean over recordings and sides",
            ("hand", *methods),
            [[hand, *(of(hand, method, figure) for method in methods)] for hand in hands],
        )
    report.table(
        "worst cell and latency of each method, over all hands, recordings and sides",
        ("method", *(COLUMNS[f] for f in COLUMNS if f in WORST or f.startswith("latency"))),
        [
            [m, *(of(None, m, f) for f in COLUMNS if f in WORST or f.startswith("latency"))]
            for m in methods
        ],
    )


@contextmanager
def bar(total: int) -> Iterator[Callable[[str], None]]:
    """Progress on standard error: a bar on a terminal, a line a cell elsewhere."""
    console = Console(stderr=True, highlight=False)
    display = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TimeRemainingColumn(), console=console, disable=not console.is_terminal,
    )  # fmt: skip
    done = 0
    with display:
        task: Any = display.add_task("", total=total)

        def advance(label: str) -> None:
            nonlocal done
            done += 1
            display.update(task, advance=1, description=label)
            if not console.is_terminal:
                console.print(f"{done}/{total} {label}", markup=False)

        yield advance


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
