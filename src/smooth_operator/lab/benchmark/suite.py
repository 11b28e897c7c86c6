"""Running a benchmark: quality of all cells in workers, then latency with nothing else running."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TypeAlias

from smooth_operator.lab.benchmark.benchmark_folder import BenchmarkFolder, check_folder
from smooth_operator.lab.benchmark.cells import Cell, cells_of
from smooth_operator.lab.benchmark.latency import Latency, measure_latency
from smooth_operator.lab.benchmark.quality import Measured, Task, measure_cell
from smooth_operator.lab.benchmark.recordings import load_sources, parse_request
from smooth_operator.lab.benchmark.settings import Settings, select_methods
from smooth_operator.metrics.registry import add_metrics
from smooth_operator.parallel import TaskResult, run_tasks
from smooth_operator.result_cache import (
    Job,
    Note,
    compute_results,
    find_results,
    longest_first,
    no_note,
)

Advance: TypeAlias = Callable[[str, str | None], None]
"""Called with the label of a cell that is done, and why it failed or None."""

RowKey: TypeAlias = tuple[str, str, str, str, str]
"""``Cell.key``."""

Track: TypeAlias = Callable[[str, int, int], AbstractContextManager[Advance]]
"""Opens the display of a phase: its name, how many cells it has, how many were done before."""


@dataclass(frozen=True, eq=False)
class Finished:
    """The result of a cell.

    Attributes:
        cell: the cell.
        measured: without latency; None where it failed.
        reason: why it failed; None where it did not.
        latency: measured alone; None where it was not asked for, or the cell failed.
        fresh: done by this run, not found done.
    """

    cell: Cell
    measured: Measured | None
    reason: str | None
    latency: Latency | None
    fresh: bool


@contextmanager
def silent(name: str, total: int, done: int) -> Iterator[Advance]:
    """A display that shows nothing."""
    yield lambda label, reason: None


def plan_cells(settings: Settings) -> list[Cell]:
    """All that is to be measured; reads the recordings, writes nothing.

    Raises:
        SmoothOperatorError: the settings can't be met: an unknown name, no recording that can be
            read, a folder that holds something else.
    """
    check_folder(settings.output)
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
    settings: Settings, cells: Sequence[Cell], track: Track = silent, note: Note = no_note
) -> list[Finished]:
    """Measures all cells; those that an earlier run in the folder has finished are taken from it.

    Each finished cell is written before the next, so that a run that is stopped loses only those
    that it was at. A cell that fails has a reason in place of figures, and the rest goes on.

    Args:
        cells: result of ``plan_cells``.
        note: called with kept cells that can't be used.

    Returns:
        The result of each cell, in their order.

    Raises:
        OutputError: a result can't be written.
        ConfigError: the workers can't be.
    """
    store = BenchmarkFolder(settings, note)
    reasons = {c.key: c.source.error for c in cells if c.source.error is not None}
    jobs = [store.job(cell) for cell in cells if cell.key not in reasons]
    results, missing = find_results(jobs, store.measured)
    measured: dict[RowKey, Measured] = {r.job.task.key: r.value for r in results}  # type: ignore[misc]
    before = set(measured)
    _measure_quality(store, missing, measured, reasons, track)
    latencies: dict[tuple[str, ...], Latency] = {}
    if settings.latency_frames:
        alive = [cell for cell in cells if cell.key in measured]
        _measure_latency(store, alive, latencies, track)
    return [
        Finished(
            cell,
            measured.get(cell.key),
            reasons.get(cell.key),
            latencies.get(cell.key),
            cell.key not in before,
        )
        for cell in cells
    ]


def _measure_quality(
    store: BenchmarkFolder,
    jobs: Sequence[Job[Cell]],
    measured: dict[RowKey, Measured],
    reasons: dict[RowKey, str],
    track: Track,
) -> None:
    settings = store.settings

    def execute(cells: Sequence[Cell]) -> Iterable[TaskResult[Measured]]:
        tasks = [_task(cell, settings) for cell in cells]
        return run_tasks(measure_cell, tasks, workers=settings.workers, cluster=settings.cluster)

    with track("quality", len(measured) + len(jobs), len(measured)) as advance:
        for result in compute_results(longest_first(jobs), store.measured, execute, _to_keep):
            cell = result.job.task
            if result.value is None:
                reasons[cell.key] = result.error or "it returned nothing"
            else:
                measured[cell.key] = result.value
            advance(cell.label, reasons.get(cell.key))


def _to_keep(job: Job[Cell], result: TaskResult[Measured]) -> Measured | None:
    if result.value is None:
        return None
    source = job.task.source
    # As `retarget` has them, so that `view` finds the frames again.
    facts = {"source": source.facts, "rate": source.request.rate}
    return replace(
        result.value,
        configuration=result.value.configuration | facts,
        seconds=result.seconds,
    )


def _task(cell: Cell, settings: Settings) -> Task:
    assert cell.source.recording is not None  # those without are not begun
    return Task(
        cell.source.recording, cell.hand, cell.method, cell.preset, cell.config, settings.seed,
        settings.definition, cell.fingers, settings.metrics,
    )  # fmt: skip


def _measure_latency(
    store: BenchmarkFolder,
    cells: Sequence[Cell],
    latencies: dict[tuple[str, ...], Latency],
    track: Track,
) -> None:
    settings = store.settings
    # By hand first: its retargeters then serve one recording after the other.
    ordered = sorted(cells, key=lambda c: (c.hand, c.side, c.source.name))
    groups = [list(g) for _, g in groupby(ordered, lambda c: (c.hand, c.side, c.source.name))]
    todo = []
    for group in groups:
        loaded = [store.load_latency(cell) for cell in group]
        # All of a group or none: figures that shall be compared are taken side by side.
        if all(latency is not None for latency in loaded):
            latencies |= {c.key: ms for c, ms in zip(group, loaded, strict=True) if ms is not None}
        else:
            todo.append(group)
    left = sum(len(group) for group in todo)
    with track("latency, alone", len(cells), len(cells) - left) as advance:
        for group in todo:
            measured = measure_latency(
                group, settings.latency_frames, settings.seed, lambda c: advance(c.label, None)
            )
            for cell, latency in zip(group, measured, strict=True):
                latencies[cell.key] = latency
                if latency.reason is None:
                    store.save_latency(cell, latency)
