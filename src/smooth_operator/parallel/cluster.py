"""Tasks on a Ray cluster, under the rules of the local pool.

Ray replaces workers and nodes that die. How often a task is tried again is counted here, since
Ray's own count does not hold where memory runs out: it then tries for ever.
"""

from __future__ import annotations

import builtins
import contextlib
import logging
import os
import signal
import socket
import sys
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeVar

from smooth_operator.errors import MissingExtraError, WorkerError
from smooth_operator.parallel.results import TaskResult, death, describe, timed
from smooth_operator.parallel.threads import one_thread

T = TypeVar("T")
R = TypeVar("R")

LOCAL: Final = "local"
"""The cluster that is started for one run, on this machine."""

_GRACE_S: Final = 5.0
_KNOCK_S: Final = 10.0
_AUTH_MODE: Final = "RAY_AUTH_MODE"


def run_on_cluster(
    function: Callable[[T], R],
    tasks: Sequence[T],
    workers: int | None,
    cluster: str,
    retries: int,
) -> Iterator[TaskResult[R]]:
    """See ``run_tasks``."""
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("working on a cluster", "cluster") from error
    return _run(ray, function, tasks, workers, cluster, retries)


def _run(
    ray: Any,
    function: Callable[[T], R],
    tasks: Sequence[T],
    workers: int | None,
    cluster: str,
    retries: int,
) -> Iterator[TaskResult[R]]:
    with connected(ray, cluster, workers):
        at_once = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
        remote = ray.remote(num_cpus=1, max_retries=0)(_call)
        shared = ray.put(function)
        waiting = deque(range(len(tasks)))
        attempts = [0] * len(tasks)
        running: dict[Any, int] = {}
        try:
            while waiting or running:
                while waiting and len(running) < at_once:
                    index = waiting.popleft()
                    attempts[index] += 1
                    try:
                        running[remote.remote(shared, tasks[index])] = index
                    except TypeError as failure:  # Ray's for what can't be pickled
                        reason = f"the task can't be sent: {describe(failure)}"
                        yield TaskResult(index, None, reason, 0.0, attempts[index])
                if not running:
                    continue
                (done,), _ = ray.wait(list(running), num_returns=1)
                index = running.pop(done)
                answer: tuple[R | None, str | None, float]
                try:
                    answer = ray.get(done)
                except ray.exceptions.RayTaskError as failure:  # before or after our own code
                    answer = None, _last_line(failure), 0.0
                except ray.exceptions.RayError as failure:
                    if attempts[index] <= retries:
                        waiting.appendleft(index)
                        continue
                    answer = None, death(attempts[index], type(failure).__name__), 0.0
                yield TaskResult(index, *answer, attempts[index])
        finally:
            _cancel(ray, list(running))


def _call(function: Callable[[T], R], task: T) -> tuple[R | None, str | None, float]:
    """In a worker of the cluster."""
    if not _limited:
        with one_thread(os.getpid()) as start_threads:
            start_threads()
        _limited.append(True)
    return timed(function, task)


_limited: Final[list[bool]] = []
"""Not empty in a process that has its one thread."""


@contextlib.contextmanager
def connected(ray: Any, cluster: str, workers: int | None) -> Iterator[None]:
    """A connection to a cluster while the block lasts; that of the program that embeds us stays.

    Args:
        ray: the module.
        cluster: as in ``run_tasks``.
        workers: CPUs of a cluster that is started for this; None for all cores.

    Raises:
        WorkerError: the cluster can't be reached.
    """
    if ray.is_initialized():  # by the program that embeds us: its connection, not ours to end
        yield
        return
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if cluster == LOCAL:
        options |= {"num_cpus": workers, "include_dashboard": False}
        # What this process can import, workers on the same machine can.
        options["runtime_env"] = {
            "env_vars": {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        }
    with _as_it_was():
        try:
            try:
                _knock(cluster)
                with warnings.catch_warnings():
                    # JAX's, of its threads; what Ray forks becomes another program immediately.
                    warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
                    _connect(ray, cluster, options)
            except Exception as error:  # ConnectionError, RuntimeError, ...: as Ray likes
                raise WorkerError(
                    f"can't reach the Ray cluster {cluster!r} ({describe(error)}); expected "
                    "'auto', the address of a running one ('ray start --head' prints it), or "
                    "'local'. To an address Ray sends the cluster's token (by default it asks for "
                    "one) only with RAY_AUTH_MODE=token in the environment"
                ) from error
            yield
        finally:
            ray.shutdown()


def _connect(ray: Any, cluster: str, options: dict[str, Any]) -> None:
    """``ray.init``; a local cluster that started too slowly is started a second time.

    Ray gives its own processes 30 seconds, which a busy machine may exceed once, while their files
    are read for the first time.
    """
    try:
        ray.init(address=cluster, **options)
    except Exception as error:
        if cluster != LOCAL or "timed out" not in str(error):
            raise
        ray.shutdown()
        ray.init(address=cluster, **options)


@contextlib.contextmanager
def _as_it_was() -> Iterator[None]:
    """Gives back what Ray takes for itself and keeps.

    That is SIGTERM, ``print``, the last word on errors, and the mode of authentication.
    """
    shown, hook, handler = builtins.print, sys.excepthook, signal.getsignal(signal.SIGTERM)
    mode = os.environ.get(_AUTH_MODE)
    try:
        yield
    finally:
        builtins.print, sys.excepthook = shown, hook
        os.environ.pop(_AUTH_MODE, None)
        if mode is not None:
            os.environ[_AUTH_MODE] = mode
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)


def _knock(cluster: str) -> None:
    """Whether anybody is at an address; Ray itself goes on trying for minutes.

    Raises:
        OSError: nobody is.
        ValueError: it has no port.
    """
    if cluster in (LOCAL, "auto"):
        return
    host, _, port = cluster.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        raise ValueError("an address is HOST:PORT")
    socket.create_connection((host.strip("[]"), int(port)), timeout=_KNOCK_S).close()


def _last_line(failure: Any) -> str:
    """Of what Ray says, which is a whole traceback."""
    cause = failure.cause or failure
    lines = str(cause).strip().splitlines() or [""]
    return f"{type(cause).__name__}: {lines[-1].strip()}"


def _cancel(ray: Any, running: list[Any]) -> None:
    """Ends what still runs: first as Ctrl-C would, so that it cleans up, then by force."""
    if not running:
        return
    with contextlib.suppress(Exception):  # the cluster may be what went away
        for reference in running:
            ray.cancel(reference)
        _, left = ray.wait(running, num_returns=len(running), timeout=_GRACE_S)
        for reference in left:
            ray.cancel(reference, force=True)
