"""One function over many tasks: in this process, in a pool of processes, or on a Ray cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.reduction import ForkingPickler
from typing import TypeVar

from smooth_operator.errors import ConfigError
from smooth_operator.parallel.results import TaskResult, describe, timed

T = TypeVar("T")
R = TypeVar("R")


def run_tasks(
    function: Callable[[T], R],
    tasks: Sequence[T],
    *,
    workers: int | None = None,
    cluster: str | None = None,
    retries: int = 2,
) -> Iterator[TaskResult[R]]:
    """Calls a function with each task, several in parallel; results come as they finish.

    Tasks are started in their order. An exception of the function is the result of its task and is
    not tried again; a worker that dies (killed, out of memory) is replaced and its task tried
    again. Nothing that goes wrong with one task touches another. Each worker computes on one
    thread, which for small programs is faster than several. Where the caller stops, by an
    exception, Ctrl-C or closing the iterator, the workers are stopped too.

    Args:
        function: importable by its module and name. Workers import it, so a script that calls this
            needs the usual ``if __name__ == "__main__":``.
        tasks: values that can be pickled; they, and what the function returns, travel between
            processes, so large data is better named by a path.
        workers: how many in parallel; None for as many as there are usable cores, or on a running
            cluster CPUs. 0 without a cluster is none: the tasks run in this process, in turn.
        cluster: None for processes on this machine; ``"auto"`` or the address of a running Ray
            cluster; ``"local"`` for a Ray started for this run. Nodes need this package, and the
            folders that tasks name.
        retries: how often a task is tried again whose worker died.

    Returns:
        An iterator of one ``TaskResult`` per task, in the order in which they finish.

    Raises:
        ConfigError: a number is negative, or the function can't be sent to another process.
        MissingExtraError: ``cluster`` is given and Ray is not installed.
        WorkerError: the cluster can't be reached, or no worker starts.
    """
    if workers is not None and workers < 0:
        raise ConfigError(f"workers must be 0 or more, not {workers}")
    if retries < 0:
        raise ConfigError(f"retries must be 0 or more, not {retries}")
    if cluster is not None and workers == 0:
        raise ConfigError("a cluster needs workers: give 1 or more, or leave them out for all")
    if cluster is None and workers == 0:
        return _here(function, tasks)
    try:
        ForkingPickler.dumps(function)
    except Exception as error:
        raise ConfigError(
            f"{function!r} can't be sent to another process ({describe(error)}); expected a "
            "function at the top of an importable module"
        ) from error
    if cluster is not None:
        from smooth_operator.parallel.cluster import run_on_cluster

        return run_on_cluster(function, tasks, workers, cluster, retries)
    from smooth_operator.parallel.pool import run_in_pool

    return run_in_pool(function, tasks, usable_cores() if workers is None else workers, retries)


def usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _here(function: Callable[[T], R], tasks: Sequence[T]) -> Iterator[TaskResult[R]]:
    for index, task in enumerate(tasks):
        value, error, seconds = timed(function, task)
        yield TaskResult(index, value, error, seconds, 1)
