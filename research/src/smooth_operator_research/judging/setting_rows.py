"""One method with other settings, row by row: what ``method_tables`` measures, keeps and writes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smooth_operator import SmoothOperatorError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.formats.setting_paths import numeric_settings, with_settings, with_unchecked
from smooth_operator.lab.benchmark.cells import hand_identity
from smooth_operator.lab.benchmark.recordings import Source
from smooth_operator.lab.tuning.score import figure
from smooth_operator.lab.tuning.trial import TrialTask, run_trial
from smooth_operator.lab.tuning.trial_log import Trial, TrialLog
from smooth_operator.methods.method import MethodConfig
from smooth_operator.parallel import TaskResult, run_tasks
from smooth_operator_research.judging.kept_figures import code_of
from smooth_operator_research.run_report import BenchmarkError

Values = Mapping[str, float]
"""Path of a setting -> its value; the others are those of the preset."""
Row = tuple[str, str]
"""Table and name of a row."""
Found = Mapping[Row, Sequence[Mapping[str, Any] | None]]
"""Row -> figures on each recording; None where it failed."""


@dataclass(frozen=True, eq=False)
class Variants:
    """What is measured, but for the rows.

    Attributes:
        config: whose settings rows change.
        sources: recordings.
        hand: robot hand.
        like_any_value: settings whose 0 a compiled program takes as it takes any value. Other
            zeros mean that something is left out while it is compiled, and cost a program.
        seed: of the method's random numbers.
        workers: processes; 0 for none.
        log: file of the rows that were measured.
    """

    config: MethodConfig
    sources: tuple[Source, ...]
    hand: str
    like_any_value: frozenset[str]
    seed: int
    workers: int
    log: Path

    @property
    def key(self) -> dict[str, Any]:
        """What the figures of a row depend on but for its values and for code."""
        return {
            "config": self.config,
            "hand": [hand_identity(self.hand, source.side, ()) for source in self.sources],
            "frames": [source.digest for source in self.sources],
            "seed": self.seed,
        }

    def task(self, values: Values) -> TrialTask:
        """A row, its values arguments of a compiled program as far as they can be."""
        constant = {
            path: value
            for path, value in values.items()
            if isinstance(value, int) or (value == 0 and path not in self.like_any_value)
        }
        return TrialTask(
            tuple(source.request for source in self.sources),
            tuple(source.digest for source in self.sources),
            self.hand,
            with_unchecked(self.config, constant),  # checked before, with the others
            {path: value for path, value in values.items() if path not in constant},
            self.seed,
        )


def full_values(config: MethodConfig, rows: Mapping[Row, Values]) -> dict[Row, Values]:
    """Row -> the values there of all settings that any row changes.

    Raises:
        BenchmarkError: a row names a setting that is none, or a value that can't be.
    """
    paths = dict.fromkeys(path for values in rows.values() for path in values)
    full: dict[Row, Values] = {}
    for (table, name), values in rows.items():
        try:
            now = numeric_settings(with_settings(config, values))
        except SmoothOperatorError as error:
            raise BenchmarkError(f"row {name!r} of {table!r} can't be: {error}") from error
        full[table, name] = now
    return {row: {path: now[path] for path in paths} for row, now in full.items()}


def measure_rows(variants: Variants, rows: Mapping[Row, Values]) -> tuple[Found, list[str]]:
    """Measures what is not known; rows of the same values are measured once.

    Args:
        variants: what is measured, but for the rows.
        rows: row -> what it changes.

    Returns:
        the figures, and why rows failed.
    """
    full = full_values(variants.config, rows)
    log = TrialLog(variants.log, variants.key, code_of(variants.config))
    preset = numeric_settings(variants.config)
    rows_of: dict[str, Row] = {}
    for row, values in full.items():
        rows_of.setdefault(to_json(values), row)
    tasks = {key: variants.task(full[row]) for key, row in rows_of.items()}
    # those of one program one after the other, so that a worker compiles it once
    order = sorted(tasks, key=lambda key: to_json(tasks[key].config))
    todo = [(_changed(full[rows_of[key]], preset), tasks[key]) for key in order]
    missing = [task for values, task in todo if log.find(values) is None]
    if missing:
        programs = len({to_json(task.config) for task in missing})
        print(
            f"rows to measure: {len(missing)}, kept: {len(todo) - len(missing)}; "
            f"programs to compile: {programs}",
            file=sys.stderr,
        )
    known: dict[str, Trial] = {}
    failures: list[str] = []
    done = 0

    def execute(tasks: Sequence[TrialTask]) -> Iterable[TaskResult[Any]]:
        return run_tasks(run_trial, tasks, workers=variants.workers)

    for i, trial, fresh in log.run(todo, execute, keep_failures=False):
        table, name = rows_of[order[i]]
        known[order[i]] = trial
        if trial.metrics is None:
            failures.append(f"{name} ({table}) failed: {trial.reason}")
        if fresh:
            done += 1
            said = "" if trial.reason is None else f": {trial.reason}"
            print(f"{done} of {len(missing)}: {table}, {name}{said}", file=sys.stderr)
    nothing = [None] * len(variants.sources)
    found = {row: list(known[to_json(v)].metrics or nothing) for row, v in full.items()}
    return found, failures


def _changed(values: Values, preset: Values) -> dict[str, float]:
    """Those that are not the preset's own: by them a row is known, whatever the others are."""
    return {path: value for path, value in values.items() if value != preset[path]}


# -- how figures are written ----------------------------------------------------------------------


@dataclass(frozen=True)
class Column:
    """A figure in the tables: how it is written with others in a cell, and alone."""

    name: str
    metric: str
    beside: Callable[[float], str]
    alone: Callable[[float], str]
    unit: str = ""

    def cell(self, values: Sequence[float | None]) -> str:
        """The values of a row, those that were not measured left out."""
        known = [value for value in values if value is not None]
        write = self.beside if len(values) > 1 else self.alone
        return " / ".join(write(value) for value in known) + self.unit if known else "–"


def _fixed(digits: int) -> Callable[[float], str]:
    return lambda value: f"{value:.{digits}f}"


def _short(digits: int) -> Callable[[float], str]:
    return lambda value: f"{value:.{digits}f}".removeprefix("0")


def _power(value: float) -> str:
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def _percent(value: float) -> str:
    return f"{100 * value:.0f}"


COLUMNS = (
    Column("cos thumb", "cosine_similarity", _short(4), _fixed(4)),
    Column("cos all", "cosine_similarity_all", _short(4), _fixed(4)),
    Column("motion", "motion_preservation", _short(3), _fixed(3)),
    Column("flatness [m²]", "flatness", _power, _power),
    Column("vel. corr.", "velocity_correlation", _short(3), _fixed(3)),
    Column("collision", "self_collision.share", _percent, _percent, " %"),
    Column("pinch [mm]", "pinch_error_mm", _fixed(1), _fixed(1)),
)
HEADER = tuple(column.name for column in COLUMNS)


def figures_of(metrics: Mapping[str, Any] | None) -> dict[str, float | None]:
    """Metric of a column -> figure."""
    return {c.metric: None if metrics is None else figure(metrics, c.metric) for c in COLUMNS}


def cells_of(figures: Sequence[Mapping[str, float | None]]) -> list[str]:
    """A row of the tables from the figures on each recording."""
    return [column.cell([one[column.metric] for one in figures]) for column in COLUMNS]
