"""Running jobs whose results are kept: only those are computed that are not there yet."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeAlias, TypeVar

from smooth_operator.parallel import TaskResult

T = TypeVar("T")

Execute: TypeAlias = Callable[[Sequence[T]], Iterable[TaskResult[Any]]]
"""Computes tasks in any order; ``run_tasks`` with a function, or ``PersistentPool.run``."""


class Cache(Protocol):
    """Where results are kept: a ``ResultCache`` or a ``ResultLog``."""

    def find(self, name: str, key: object, code: str) -> Any | None:
        """A result; None if there is none of this key and code."""

    def keep(self, name: str, key: object, code: str, value: Any) -> None:
        """Writes a result."""

    def note_outdated(self) -> None:
        """Says how many results were of other code."""


@dataclass(frozen=True, eq=False)
class Job(Generic[T]):
    """Something to be computed unless its result is there already.

    Attributes:
        name: of its file; unique among the results of a cache.
        key: what the result depends on, but for code; anything with a JSON form.
        code: digest of the code that computes it.
        task: what ``execute`` is given.
        label: for a person.
        effort: about how long it takes; only the proportions matter.
    """

    name: str
    key: object
    code: str
    task: T
    label: str = ""
    effort: float = 0.0


@dataclass(frozen=True, eq=False)
class JobResult(Generic[T]):
    """What came of a job.

    Attributes:
        job: the job.
        value: its result; None if it failed.
        error: why it failed; None if it did not.
        seconds: how long it took now [s]; 0 if the result was there.
        fresh: computed now.
    """

    job: Job[T]
    value: Any | None
    error: str | None = None
    seconds: float = 0.0
    fresh: bool = False


def find_results(jobs: Sequence[Job[T]], cache: Cache) -> tuple[list[JobResult[T]], list[Job[T]]]:
    """The results that are there, and the jobs that have none."""
    found, missing = [], []
    for job in jobs:
        value = cache.find(job.name, job.key, job.code)
        if value is None:
            missing.append(job)
        else:
            found.append(JobResult(job, value))
    cache.note_outdated()
    return found, missing


def longest_first(jobs: Iterable[Job[T]]) -> list[Job[T]]:
    """Jobs in an order in which no worker begins a long one while the others have nothing left."""
    return sorted(jobs, key=lambda job: -job.effort)


def _value(job: Job[Any], result: TaskResult[Any]) -> Any:
    return result.value


def compute_results(
    jobs: Sequence[Job[T]],
    cache: Cache,
    execute: Execute[T],
    value: Callable[[Job[T], TaskResult[Any]], Any] = _value,
) -> Iterator[JobResult[T]]:
    """Computes jobs, and keeps each result as soon as it is there.

    Args:
        jobs: what to compute, in the order in which it is begun.
        cache: where results are kept.
        execute: computes their tasks.
        value: what is kept of the result of a task; None for nothing, as of a failure.

    Raises:
        OutputError: a result can't be written.
    """
    if not jobs:
        return
    results = execute([job.task for job in jobs])
    try:
        for result in results:
            job = jobs[result.index]
            kept = value(job, result)
            if kept is not None:
                cache.keep(job.name, job.key, job.code, kept)
            yield JobResult(job, kept, result.error, result.seconds, fresh=True)
    finally:
        close = getattr(results, "close", None)
        if close is not None:
            close()  # ends the workers now, and not when the generator is collected


def run_jobs(
    jobs: Sequence[Job[T]],
    cache: Cache,
    execute: Execute[T],
    value: Callable[[Job[T], TaskResult[Any]], Any] = _value,
) -> Iterator[JobResult[T]]:
    """Results of jobs: those that are there first, then the others as they are computed and kept.

    Args:
        jobs: what is asked for.
        cache: where results are kept.
        execute: as in ``compute_results``.
        value: as in ``compute_results``.

    Raises:
        OutputError: a result can't be written.
    """
    found, missing = find_results(jobs, cache)
    yield from found
    yield from compute_results(longest_first(missing), cache, execute, value)
