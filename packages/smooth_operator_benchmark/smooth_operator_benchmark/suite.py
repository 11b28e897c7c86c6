"""Runs a benchmark: first the quality of all cells in workers, then latency while nothing else
runs.

In the folder of a benchmark, ``config.json`` contains the settings; ``cells/SLUG.npz`` and
``.json`` the commands and measurements of a cell, as ``smooth-operator retarget`` writes them;
``cells/SLUG.latency.json`` its latency; and ``results.json`` and ``report.html`` the results of all
cells. Files are written atomically.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from smooth_operator.atomic_files import write_json
from smooth_operator.cli.outputs import CONFIG, check_folder
from smooth_operator.errors import DocumentError, RecordingError, UnknownNameError
from smooth_operator.formats.commands import read_commands, write_commands
from smooth_operator.formats.environment import environment
from smooth_operator.io.documents import read_json
from smooth_operator.metrics import Metric
from smooth_operator.metrics.table import add_metrics
from smooth_operator.parallel import TaskResult, run_tasks
from smooth_operator.planning import PROGRAM
from smooth_operator.reporter import Reporter
from smooth_operator.reporting.drawing import method_label
from smooth_operator.result_cache import (
    Job,
    Note,
    ResultCache,
    compute_results,
    find_results,
    no_note,
)
from smooth_operator.types import CommandTrajectory
from smooth_operator_benchmark.cells import (
    Cell,
    Settings,
    benchmark_code,
    cells_of,
    fingerprint,
    select_methods,
)
from smooth_operator_benchmark.quality import (
    Latency,
    Measured,
    measure_cell,
    measure_latency,
)
from smooth_operator_benchmark.recordings import UNKNOWN_TRACKER, load_sources, parse_request

COMMAND: Final = "bench"
CELLS: Final = "cells"
RESULTS: Final = "results.json"
REPORT: Final = "report.html"
PLOTS: Final = "plots"
_FORMER: Final = "an earlier benchmark"


class MeasuredCache(ResultCache):
    """Store of measured cells, with commands and configuration as ``smooth-operator retarget``
    writes them.

    The configuration has the metrics and the inputs of the cell under ``cell``.
    """

    def _read(self, path: Path) -> tuple[Mapping[str, Any], Measured]:
        content = dict(read_json(path))
        record = content.pop("cell")
        commands = read_commands(path.with_suffix(".npz"))
        # The two files are written one after the other, and a crash may come between them.
        if record["commands"] != _digest(commands):
            raise DocumentError(f"it does not belong to {path.stem}.npz")
        return record, Measured(
            commands, dict(record["metrics"]), dict(record["fingers"]), content, record["seconds"]
        )

    def _write(self, path: Path, record: Mapping[str, str], value: Measured) -> None:
        cell = {
            **record,
            "commands": _digest(value.commands),
            "metrics": value.metrics,
            "fingers": value.fingers,
            "seconds": value.seconds,
        }
        write_commands(
            path.with_suffix(".npz"), value.commands, value.configuration | {"cell": cell}
        )


class BenchmarkFolder:
    """The folder of one benchmark.

    Args:
        settings: settings of the benchmark; its ``output`` is the folder, which is created.
        note: called with stored cells that can't be used.

    Attributes:
        measured: measurements of cells, without latency.

    Raises:
        OutputError: the folder can't be written to, or contains something else.
    """

    def __init__(self, settings: Settings, note: Note = no_note) -> None:
        self.settings = settings
        self.folder = settings.output
        self.environment = environment()
        check_folder(self.folder, COMMAND, _FORMER)
        self.measured = MeasuredCache(self.folder / CELLS, note)
        self._latencies = ResultCache(self.folder / CELLS, note)
        config = {"program": PROGRAM, "command": COMMAND, "settings": settings}
        write_json(self.folder / CONFIG, config | self.environment, indent=2)

    def job(self, cell: Cell) -> Job[Cell]:
        """Makes the job that measures a cell. The cost of the job is the length of the
        recording."""
        key = fingerprint(cell, self.settings)
        effort = len(cell.source.recording or ())
        return Job(cell.slug, key, benchmark_code(), cell, cell.label, effort)

    def save_latency(self, cell: Cell, latency: Latency) -> None:
        """Stores the latency of a cell; OutputError if it can't be written."""
        self._latencies.keep(*self._latency(cell), asdict(latency))

    def load_latency(self, cell: Cell) -> Latency | None:
        """Loads the latency of a cell, if it was measured on this kind of machine; otherwise
        None."""
        content = self._latencies.find(*self._latency(cell))
        if content is None:
            return None
        return Latency(**{**content, "samples_ms": np.array(content["samples_ms"], np.float64)})

    def _latency(self, cell: Cell) -> tuple[str, object, str]:
        machine = [self.environment[key] for key in ("cpu", "cpu_cores", "device", "versions")]
        key = [fingerprint(cell, self.settings), self.settings.latency_frames, machine]
        return f"{cell.slug}.latency", key, benchmark_code()


def _digest(commands: CommandTrajectory) -> str:
    total = hashlib.sha256("\n".join(commands.joint_names).encode())
    for array in (commands.joint_positions, commands.stamps, commands.status):
        total.update(np.ascontiguousarray(array, "<f8").tobytes())
    return total.hexdigest()


RowKey: TypeAlias = tuple[str, str, str, str, str]
"""Type of ``Cell.key``."""


@dataclass(frozen=True, eq=False)
class Finished:
    """The result of one cell: one method with one hand on one recording.

    Attributes:
        cell: the cell.
        measured: measurements without latency; None if the cell failed.
        reason: reason of a failure; None without a failure.
        latency: latency; None if it was not requested or the cell failed.
    """

    cell: Cell
    measured: Measured | None
    reason: str | None
    latency: Latency | None


def plan_cells(settings: Settings) -> list[Cell]:
    """Reads the recordings and plans all cells to measure; writes nothing. Raises
    SmoothOperatorError for an unknown name, if no recording can be read, or if the folder has other
    contents."""
    check_folder(settings.output, COMMAND, _FORMER)
    add_metrics(settings.metrics)
    requests = [
        parse_request(
            text,
            frames=settings.frames,
            rate=settings.rate,
            side=settings.side,
            layout=settings.layout,
        )
        for text in settings.recordings
    ]
    return cells_of(load_sources(requests), settings, select_methods(settings.methods))


def run_suite(
    settings: Settings, cells: Sequence[Cell], reporter: Reporter | None = None
) -> list[Finished]:
    """Measures all cells. Results that an earlier run has left in the folder are reused.

    Each finished cell is written before the next one, so a stopped run loses only the cells in
    progress. A failed cell has a reason instead of metrics, and the run continues.

    Args:
        cells: result of ``plan_cells``.
        reporter: reporter of the progress, and of stored cells that can't be used.

    Returns:
        The result of each cell, in their order.

    Raises:
        OutputError: a result can't be written.
        ConfigError: the workers can't be started.
    """
    reporter = Reporter() if reporter is None else reporter
    store = BenchmarkFolder(settings, partial(reporter.note, matters=True))
    reasons = {c.key: c.source.error for c in cells if c.source.error is not None}
    jobs = [store.job(cell) for cell in cells if cell.key not in reasons]
    results, missing = find_results(jobs, store.measured)
    measured: dict[RowKey, Measured] = {r.job.task.key: r.value for r in results}  # type: ignore[misc]
    _measure_quality(store, missing, measured, reasons, reporter)
    latencies: dict[tuple[str, ...], Latency] = {}
    if settings.latency_frames:
        alive = [cell for cell in cells if cell.key in measured]
        _measure_latency(store, alive, latencies, reporter)
    return [
        Finished(
            cell,
            measured.get(cell.key),
            reasons.get(cell.key),
            latencies.get(cell.key),
        )
        for cell in cells
    ]


def _measure_quality(
    store: BenchmarkFolder,
    jobs: Sequence[Job[Cell]],
    measured: dict[RowKey, Measured],
    reasons: dict[RowKey, str],
    reporter: Reporter,
) -> None:
    settings = store.settings

    def execute(cells: Sequence[Cell]) -> Iterable[TaskResult[Measured]]:
        tasks = [(cell, settings) for cell in cells]
        return run_tasks(measure_cell, tasks, workers=settings.workers, cluster=settings.cluster)

    done = len(measured)
    with reporter.counting("quality", done + len(jobs), "cells", done=done) as advance:
        for result in compute_results(longest_first(jobs), store.measured, execute, _to_keep):
            cell = result.job.task
            if result.value is None:
                reasons[cell.key] = result.error or "it returned nothing"
            else:
                measured[cell.key] = result.value
            advance(label=cell.label, reason=reasons.get(cell.key))


def longest_first(jobs: Iterable[Job[Cell]]) -> list[Job[Cell]]:
    """Sorts jobs by decreasing effort, so that no worker starts a long one when the others have
    finished."""
    return sorted(jobs, key=lambda job: -job.effort)


def _to_keep(job: Job[Cell], result: TaskResult[Measured]) -> Measured | None:
    if result.value is None:
        return None
    source = job.task.source
    # The entries that `retarget` writes, so that `view` finds the frames.
    facts = {"source": source.facts, "rate": source.request.rate}
    return replace(
        result.value,
        configuration=result.value.configuration | facts,
        seconds=result.seconds,
    )


def _measure_latency(
    store: BenchmarkFolder,
    cells: Sequence[Cell],
    latencies: dict[tuple[str, ...], Latency],
    reporter: Reporter,
) -> None:
    settings = store.settings
    # Sorted by hand, so that its retargeters serve one recording after the other.
    ordered = sorted(cells, key=lambda c: (c.hand, c.side, c.source.name))
    groups = [list(g) for _, g in groupby(ordered, lambda c: (c.hand, c.side, c.source.name))]
    todo = []
    for group in groups:
        loaded = [store.load_latency(cell) for cell in group]
        # All of a group or none, since compared latencies must be measured side by side.
        if all(latency is not None for latency in loaded):
            latencies |= {c.key: ms for c, ms in zip(group, loaded, strict=True) if ms is not None}
        else:
            todo.append(group)
    done = len(cells) - sum(len(group) for group in todo)
    with reporter.counting("latency, alone", len(cells), "cells", done=done) as advance:
        for group in todo:
            measured = measure_latency(
                group, settings.latency_frames, settings.seed, lambda c: advance(label=c.label)
            )
            for cell, latency in zip(group, measured, strict=True):
                latencies[cell.key] = latency
                if latency.reason is None:
                    store.save_latency(cell, latency)


Row: TypeAlias = dict[str, Any]
"""Results of one cell: ``recording``, ``hand``, ``side``, ``method``, ``preset``, ``status``,
``reason``, ``metrics`` (from ``evaluate``, but with the latency measured separately),
``fingers``, ``latency``, ``source``, ``seed``, ``definition``, ``fingers_driven`` (as chosen; null
for all), ``operator`` (the calibration; null without one), ``cell``, ``seconds``, ``versions``,
``hardware``, ``date``."""

KEY: Final = ("recording", "hand", "side", "method", "preset")
"""Fields that together identify a row."""

_HARDWARE: Final = ("platform", "cpu", "cpu_cores", "device")


_MOST_BYTES = 100_000_000  # a row for each cell, with a few kB


def make_rows(finished: Iterable[Finished], settings: Settings) -> list[Row]:
    """Makes the rows of the results, in the order of the cells."""
    return [_row(one, settings) for one in finished]


def _row(finished: Finished, settings: Settings) -> Row:
    cell, measured, latency = finished.cell, finished.measured, finished.latency
    row: Row = dict(zip(KEY, cell.key, strict=True))
    row |= {
        "status": "error" if measured is None else "ok",
        "reason": finished.reason,
        "metrics": None,
        "fingers": None,
        "latency": None,
        "source": cell.source.facts,
        "seed": settings.seed,
        "definition": settings.definition,
        "fingers_driven": settings.fingers,
        "operator": settings.operator,
        "cell": None,
        "seconds": None,
        "versions": None,
        "hardware": None,
        "date": None,
    }
    if measured is None:
        return row
    configuration = measured.configuration
    none = dict.fromkeys(("mean", "p50", "p95", "p99", "first"))
    alone = none if latency is None else latency.summary
    return row | {
        "metrics": measured.metrics | {"latency_ms": alone},
        "fingers": measured.fingers,
        "latency": None if latency is None else latency.facts,
        "cell": f"{CELLS}/{cell.slug}.npz",
        "seconds": measured.seconds,
        "versions": configuration.get("versions"),
        "hardware": {key: configuration.get(key) for key in _HARDWARE},
        "date": configuration.get("created"),
    }


def row_key(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Values that identify a row of the results."""
    return tuple(str(row[name]) for name in KEY)


def row_method(row: Mapping[str, Any]) -> str:
    """Name of the row's method in tables."""
    return method_label(str(row["method"]), str(row["preset"]))


def row_tracker(row: Mapping[str, Any]) -> str:
    """Kind of tracker of the row's recording."""
    return str(_source(row).get("tracker", UNKNOWN_TRACKER))


def row_unit(row: Mapping[str, Any]) -> str:
    """The whole recording from which the row's frames are taken; parts of the same file share
    it."""
    return str(_source(row).get("unit") or row["recording"])


def _source(row: Mapping[str, Any]) -> Mapping[str, Any]:
    source = row.get("source")
    return source if isinstance(source, Mapping) else {}


def value_of(row: Mapping[str, Any], metric: Metric) -> float | None:
    """A metric of a row as a number; None if the cell failed, or the metric was not measured or is
    not a number."""
    metrics = row.get("metrics")
    if not isinstance(metrics, Mapping):
        return None
    try:
        value = metric.of(metrics)
    except UnknownNameError:  # an earlier version did not measure it
        return None
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if number else None  # type: ignore[arg-type]


def read_results(path: Path) -> list[Row]:
    """Reads ``results.json`` of this benchmark or of an earlier one.

    Args:
        path: the file, or the folder of the benchmark.

    Raises:
        RecordingError: the file does not exist, is damaged, or does not contain results.
    """
    if path.is_dir():
        path = path / RESULTS
    expected = f"expected the {RESULTS} that `smooth-operator bench` writes"
    try:
        rows = read_json(path, most_bytes=_MOST_BYTES)
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file; {expected}") from None
    except OSError as error:
        raise RecordingError(f"{path}: can't be read: {error.strerror or error}") from error
    except ValueError as error:
        raise RecordingError(f"{path}: damaged, or not JSON ({error}); {expected}") from None
    if not isinstance(rows, list):
        raise RecordingError(f"{path}: it contains a {type(rows).__name__}, not a list; {expected}")
    for i, row in enumerate(rows):
        missing = [
            name for name in KEY if not (isinstance(row, dict) and isinstance(row.get(name), str))
        ]
        if missing:
            raise RecordingError(f"{path}: row {i} lacks {', '.join(missing)}; {expected}")
        if not isinstance(row.get("metrics"), (dict, type(None))):
            raise RecordingError(
                f"{path}: the metrics of row {i} are not a JSON object; {expected}"
            )
    return rows
