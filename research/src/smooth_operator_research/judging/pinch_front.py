"""Measures benefit and cost of ``pinch_damping`` of ``smooth``, as a table and a picture.

    python -m smooth_operator_research.judging.pinch_front --data RECORDINGS

Each row is a value of ``pinch_damping`` (the default is 100) or another method. For each recording,
the columns have the results of *pinch and hold* and how closely the hand follows the human. The
default was chosen on these recordings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import tyro

from smooth_operator import SmoothOperatorError
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.parallel import run_tasks
from smooth_operator.reporting.drawing import INK, styled, write_figure
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.preset_files import method_config, with_settings
from smooth_operator.retargeting.presets import default_preset
from smooth_operator_benchmark.recordings import load_sources, parse_request
from smooth_operator_research.physics.grasp_measures import PinchHold
from smooth_operator_research.physics.measure import Case, Unit
from smooth_operator_research.run_report import RESULTS, BenchmarkError, Report

RECORDINGS: Final = (
    "manus_right_subject-000_run-010.npz@2300:4600",
    "human_alex_21x3.npy@30hz",
    "wilor_test_long_21x3.npz@30hz",
)
OPERATORS: Final = ("synthetic:1",)
"""Recordings of the built-in operator, which need no file."""
PINCH: Final = ("held", "dropped", "let_go")
FOLLOWING: Final = {
    "cos thumb": "cosine_similarity",
    "motion": "motion_preservation",
    "vel. corr.": "velocity_correlation",
}


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes:
        damping: values of ``pinch_damping``.
        methods: other methods, with their default presets.
        data: folder of the recordings; without it, only a built-in operator is used.
        hand: robot hand.
        workers: number of processes; by default one per core, 0 for none.
        output: JSON file; the Markdown file and the picture are written next to it.
    """

    damping: tuple[float, ...] = (0.0, 30.0, 100.0, 300.0, 1000.0)
    methods: tuple[str, ...] = ("sbr", "ako", "keyvector", "hybrid", "dexpilot")
    data: Path | None = None
    hand: str = "mimic_p050"
    workers: int | None = None
    output: Path = RESULTS / "pinch_front.json"


class Task(NamedTuple):
    """One row of the table on one recording, whose name has the form for ``bench``."""

    row: str
    method: str
    config: MethodConfig
    hand: str
    request: str


def measure(task: Task) -> Mapping[str, float | None]:
    """Measures one row on one recording."""
    (source,) = load_sources([parse_request(task.request)])
    recording = source.recording
    if recording is None:
        raise BenchmarkError(str(source.error))
    unit = Unit(source.name, data=recording)
    case = Case(
        "pinch",
        task.hand,
        recording.side,
        task.method,
        default_preset(task.method),
        task.config,
        "",
        unit,
    )
    row = PinchHold().run(case).row
    trace = assemble_trace(recording, case.commands(recording), case.hand, reach_samples=0)
    figures = evaluate(trace)
    values: dict[str, float | None] = {name: _number(row[name]) for name in PINCH}
    return values | {name: _number(figures[metric]) for name, metric in FOLLOWING.items()}


def rows_of(settings: Settings) -> dict[str, tuple[str, MethodConfig]]:
    """Returns the method and configuration of each row."""
    rows: dict[str, tuple[str, MethodConfig]] = {
        f"{value:g}": ("smooth", with_settings(method_config(), {"pinch_damping": value}))
        for value in settings.damping
    }
    return rows | {name: (name, method_config(name)) for name in settings.methods}


def main(settings: Settings) -> None:
    """Measures all rows, prints the table and draws the picture."""
    requests = [f"{settings.data}/{name}" for name in RECORDINGS] if settings.data else []
    requests += OPERATORS
    rows = rows_of(settings)
    tasks = [
        Task(row, method, config, settings.hand, request)
        for row, (method, config) in rows.items()
        for request in requests
    ]
    report = Report("pinch_front", vars(settings))
    figures: dict[str, dict[str, Mapping[str, float | None]]] = {row: {} for row in rows}
    for result in run_tasks(measure, tasks, workers=settings.workers):
        task = tasks[result.index]
        if result.value is None:
            raise BenchmarkError(f"{task.row} on {task.request}: {result.error}")
        figures[task.row][task.request] = result.value
    columns = [*PINCH, *FOLLOWING]
    names = [Path(request.split("@")[0]).stem for request in requests]
    for name, request in zip(names, requests, strict=True):
        cells = [[row, *(figures[row][request][c] for c in columns)] for row in rows]
        report.table(name, ("pinch_damping, or method", *columns), cells)
    means = {
        row: {c: _mean([one[c] for one in figures[row].values()]) for c in columns} for row in rows
    }
    report.table(
        "Mean of the recordings",
        ("pinch_damping, or method", *columns),
        [[row, *(means[row][c] for c in columns)] for row in rows],
    )
    for row in rows:
        for name, request in zip(names, requests, strict=True):
            report.add(f"{row}/{name}", figures[row][request])
    settings.output.parent.mkdir(parents=True, exist_ok=True)
    report.finish(settings.output, None)
    settings.output.with_suffix(".md").write_text(report.tables() + "\n", encoding="utf-8")
    draw(means, len(settings.damping), settings.output.with_suffix(""))


def draw(means: Mapping[str, Mapping[str, float | None]], damped: int, stem: Path) -> None:
    """Draws the held and dropped shares over motion preservation, with a line through the values
    of ``pinch_damping``."""
    from matplotlib.figure import Figure

    with styled():
        drawn = Figure(figsize=(9.0, 3.6), layout="constrained")
        for ax, column in zip(drawn.subplots(1, 2), ("held", "dropped"), strict=True):
            points = [(row["motion"] or np.nan, row[column] or 0.0) for row in means.values()]
            line, others = np.array(points[:damped]), points[damped:]
            ax.plot(*line.T, marker="o", ms=5, label="smooth, by pinch_damping")
            ax.plot(*np.array(others).reshape(-1, 2).T, "s", ms=5, color=INK, label="other methods")
            for number, (name, point) in enumerate(zip(means, points, strict=True)):
                if number >= damped:
                    where = (4, 4, "left")
                else:  # off the line, which falls in one panel and rises in the other
                    where = (0, 7, "center") if column == "held" else (-3, 5, "right")
                ax.annotate(
                    name, point, where[:2], textcoords="offset points", size=6.5, ha=where[2]
                )
            ax.set(xlabel="motion preservation", ylabel=f"share {column}")
            ax.margins(0.16)
        ax.legend(fontsize=7)
        write_figure(drawn, stem)


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _mean(values: Sequence[float | None]) -> float | None:
    finite = [value for value in values if value is not None]
    return float(np.mean(finite)) if finite else None


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
