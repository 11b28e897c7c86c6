"""Gets the chunks of a simulation: finished chunks from a log, the others from workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from smooth_operator.errors import StudyError
from smooth_operator.parallel import run_tasks
from smooth_operator.result_cache import (
    Job,
    JobResult,
    code_digest,
    compute_results,
    find_results,
)
from smooth_operator_study.result_log import ResultLog

T = TypeVar("T")

HOME: Final = Path(__file__).resolve().parent
"""Folder of this package."""


def study_digest() -> str:
    """Digest of the code that simulates and analyses studies, for stored chunks."""
    return code_digest("design", "power", "analysis", home=HOME)


def chunk_values(
    jobs: Sequence[Job[T]],
    log: ResultLog,
    work: Callable[[T], Any],
    *,
    field: str,
    workers: int | None,
    report: Callable[[int, int], None] | None,
) -> Iterator[tuple[T, Any]]:
    """Yields each chunk with its value.

    Args:
        jobs: chunks; ``label`` names the work for errors, ``effort`` is the size for ``report``.
        work: function that computes the value of a chunk, in a worker.
        field: name of the value in the log.
        workers: number of processes; None for one for each core, 0 for this process.
        report: called with the finished and the whole size, after the chunks of the log and after
            every further chunk.
    """
    finished, missing = find_results(jobs, log)
    total, done = round(sum(job.effort for job in jobs)), 0

    def value_of(result: JobResult[T]) -> tuple[T, Any]:
        nonlocal done
        if result.value is None:
            raise StudyError(f"{result.job.label} failed: {result.error}")
        done += round(result.job.effort)
        return result.job.task, result.value[field]

    for result in finished:
        yield value_of(result)
    if report is not None:
        report(done, total)
    for result in compute_results(
        missing,
        log,
        lambda tasks: run_tasks(work, tasks, workers=workers),
        lambda job, result: None if result.value is None else {field: result.value},
    ):
        yield value_of(result)
        if report is not None:
            report(done, total)
