"""Workers that stay: one function over lists of tasks that are not all known at the beginning."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from types import TracebackType
from typing import Any, Generic, TypeVar

from smooth_operator.errors import ConfigError
from smooth_operator.parallel.pool import Pool
from smooth_operator.parallel.results import TaskResult, timed
from smooth_operator.parallel.run import usable_cores

T = TypeVar("T")
R = TypeVar("R")


class PersistentPool(Generic[T, R]):
    """Processes that keep what they have compiled from one list of tasks to the next.

    For a search, whose next tasks depend on the results of the last. What ``run_tasks`` says of
    failures and retries holds here too. Use it as a context manager: at its end the workers end.

    Args:
        function: importable by its module and name.
        workers: how many; None for as many as there are usable cores, 0 for none: tasks then run in
            this process.
        retries: how often a task is tried again whose worker died.

    Raises:
        ConfigError: a number is negative.
    """

    def __init__(
        self, function: Callable[[T], R], workers: int | None = None, retries: int = 2
    ) -> None:
        if workers is not None and workers < 0:
            raise ConfigError(f"workers must be 0 or more, not {workers}")
        self._function = function
        self._workers = usable_cores() if workers is None else workers
        self._pool: Pool | None = Pool(function, retries) if self._workers else None
        self._before = 0

    def run(self, tasks: Sequence[T]) -> Iterator[TaskResult[R]]:
        """One result per task, in the order in which they finish; to be read to the end."""
        if self._pool is None:
            for index, task in enumerate(tasks):
                value, error, seconds = timed(self._function, task)
                yield TaskResult(index, value, error, seconds, 1)
            return
        first = self._before
        self._before += len(tasks)
        self._pool.add(tasks)
        self._pool.start_up_to(min(self._workers, len(tasks)))
        for result in self._pool.results():
            yield replace(result, index=result.index - first)

    def close(self) -> None:
        """Ends the workers."""
        if self._pool is not None:
            self._pool.stop()

    def __enter__(self) -> PersistentPool[T, R]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> Any:
        self.close()
