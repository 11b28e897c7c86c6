"""One function over many tasks: in this process, in processes of this machine, or on Ray.

The processes are those of ``concurrent.futures``. When one of them dies, its pool is lost; the
tasks that were in hand are then run again one by one, so that a death is known to be of that task.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection, parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.reduction import ForkingPickler
from types import FrameType, TracebackType
from typing import IO, Any, Final, Generic, TypeVar

from smooth_operator.errors import ConfigError, WorkerError
from smooth_operator.parallel.tasks import (
    DIED,
    TaskResult,
    death,
    describe,
    one_thread,
    packed_answer,
    timed,
)
from smooth_operator.signals import ENDING, leave_to_parent

T = TypeVar("T")
R = TypeVar("R")

_GRACE_S: Final = 3.0
"""Time that a worker has to clean up before it is killed; compiling can't be interrupted [s]."""

_AGAIN_S: Final = 0.1
_TAIL: Final = 4096
"""Bytes of a dead worker's standard error that are read."""


def run_tasks(
    function: Callable[[T], R],
    tasks: Sequence[T],
    *,
    workers: int | None = None,
    cluster: str | None = None,
    retries: int = 2,
) -> Generator[TaskResult[R]]:
    """Calls a function with each task, several in parallel; results come as they finish.

    Tasks are started in their order. An exception of the function is the result of its task and is
    not tried again; a worker that dies (killed, out of memory) is replaced, and the tasks that were
    in hand are tried again. Nothing that goes wrong with one task touches the result of another.
    Each worker computes on one thread, which for small programs is faster than several. Where the
    caller stops, by an exception, Ctrl-C or closing the iterator, the workers are stopped too.

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
    if cluster is None:
        return _in_pool(PersistentPool(function, workers, retries), tasks)
    if workers == 0:
        raise ConfigError("a cluster needs workers: give 1 or more, or leave them out for all")
    _check(workers, retries)
    from smooth_operator.parallel.cluster import run_on_cluster

    return run_on_cluster(function, tasks, cluster, workers=workers, retries=retries)


def run_groups(
    function: Callable[[T], R],
    groups: Sequence[T],
    split: Callable[[T], Sequence[T]],
    *,
    workers: int | None = None,
    cluster: str | None = None,
    retries: int = 2,
) -> Generator[tuple[T, TaskResult[R]]]:
    """Results of groups of work; a group at which workers die is split, each part tried alone.

    Args:
        function: as in ``run_tasks``.
        groups: tasks that may hold several parts.
        split: parts of a group, each a group of its own.
        workers, cluster, retries: as in ``run_tasks``.

    Yields:
        groups, or parts of them, each with its result.
    """
    parts: list[T] = []
    options: dict[str, Any] = {"workers": workers, "cluster": cluster, "retries": retries}
    with contextlib.closing(run_tasks(function, groups, **options)) as results:
        for result in results:
            group = groups[result.index]
            lost = (result.error or "").startswith((DIED, MemoryError.__name__))
            if lost and len(alone := split(group)) > 1:
                parts += alone
            else:
                yield group, result
    if parts:
        with contextlib.closing(run_tasks(function, parts, **options)) as results:
            yield from ((parts[result.index], result) for result in results)


def usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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
        ConfigError: a number is negative, or the function can't be sent to another process.
    """

    def __init__(
        self, function: Callable[[T], R], workers: int | None = None, retries: int = 2
    ) -> None:
        _check(workers, retries)
        self._function, self._retries = function, retries
        self._workers = usable_cores() if workers is None else workers
        self._pool: _Workers | None = None
        self._raw = b""
        if self._workers:
            try:
                self._raw = bytes(ForkingPickler.dumps(function))
            except Exception as error:
                raise ConfigError(
                    f"{function!r} can't be sent to another process ({describe(error)}); expected "
                    "a function at the top of an importable module"
                ) from error

    def run(self, tasks: Sequence[T]) -> Generator[TaskResult[R]]:
        """One result per task, in the order in which they finish; to be read to the end."""
        if not self._workers:
            for index, task in enumerate(tasks):
                yield TaskResult(index, *timed(self._function, task), 1)
            return
        attempts = [0] * len(tasks)
        waiting = deque(range(len(tasks)))
        running: dict[Future[bytes], int] = {}
        finished: list[TaskResult[R]] = []
        try:
            while waiting or running:
                # No more than there are workers: what a death may have touched stays small.
                while waiting and len(running) < self._workers:
                    index = waiting.popleft()
                    try:
                        raw = bytes(ForkingPickler.dumps(tasks[index]))
                    except Exception as error:
                        reason = f"the task can't be sent: {describe(error)}"
                        finished.append(TaskResult(index, None, reason, 0.0, 1))
                        continue
                    if self._pool is None:
                        self._pool = _Workers(self._raw, self._workers)
                    try:
                        running[self._pool.submit(raw)] = index
                    except BrokenProcessPool:  # a worker died without a task
                        waiting.appendleft(index)
                        if not running:
                            self.close()
                        break
                    attempts[index] += 1
                yield from finished  # the workers have their next tasks meanwhile
                finished.clear()
                if not running:
                    continue
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                if any(future.exception() is not None for future in done):  # a worker died
                    pool, lost = self._pool, sorted(running.values())
                    running.clear()
                    self.close()
                    if len(lost) == 1 and attempts[lost[0]] > self._retries:
                        cause = death(attempts[lost[0]], "" if pool is None else pool.exit())
                        yield TaskResult(lost[0], None, cause, 0.0, attempts[lost[0]])
                    else:
                        for index in lost:
                            yield self._alone(index, tasks[index], attempts[index])
                for future in done & running.keys():
                    index = running.pop(future)
                    finished.append(TaskResult(index, *_answer(future), attempts[index]))
            yield from finished
        finally:
            if running:
                self.close()

    def _alone(self, index: int, task: T, attempts: int) -> TaskResult[R]:
        """The result of a task whose pool was lost, from workers that have no other.

        Raises:
            WorkerError: no worker starts.
        """
        raw = bytes(ForkingPickler.dumps(task))
        since = time.perf_counter()
        with tempfile.TemporaryFile() as errors:
            while True:
                attempts += 1
                pool = _Workers(self._raw, 1, errors)
                try:
                    future = pool.submit(raw)
                    wait([future])
                finally:
                    pool.end()
                if future.exception() is None:
                    return TaskResult(index, *_answer(future), attempts)
                if attempts > self._retries:
                    break
            errors.seek(max(0, errors.seek(0, os.SEEK_END) - _TAIL))
            text = errors.read().decode(errors="replace")
        print(text, end="", file=sys.stderr)
        lines = [line.strip() for line in text.split("\n") if line.strip()]
        last = lines[-1][-300:] if lines else ""
        if pool.started():
            how = pool.exit() + (f"; its last line: {last}" if last else "")
            seconds = time.perf_counter() - since
            return TaskResult(index, None, death(attempts, how), seconds, attempts)
        if "bootstrapping phase" in text:  # multiprocessing's own words
            last = (
                "a script that starts workers needs 'if __name__ == \"__main__\":' around what it "
                "does"
            )
        last = last or "each worker needs memory for its own libraries: use fewer workers"
        raise WorkerError(
            f"{attempts} workers in a row ended before their first task ({pool.exit()}); {last}"
        )

    def close(self) -> None:
        """Ends the workers; those at a task may clean up first."""
        if self._pool is not None:
            self._pool.end()
        self._pool = None

    def __enter__(self) -> PersistentPool[T, R]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _check(workers: int | None, retries: int) -> None:
    for name, value in (("workers", workers), ("retries", retries)):
        if value is not None and value < 0:
            raise ConfigError(f"{name} must be 0 or more, not {value}")


def _in_pool(pool: PersistentPool[T, R], tasks: Sequence[T]) -> Generator[TaskResult[R]]:
    with pool:
        yield from pool.run(tasks)


def _answer(future: Future[bytes]) -> tuple[Any, str | None, float]:
    """Value, error and seconds."""
    try:
        value, error, seconds = ForkingPickler.loads(future.result())
    except Exception as failure:
        return None, f"the result can't be read: {describe(failure)}", 0.0
    return value, error, seconds


class _Context(SpawnContext):
    """Processes by spawning (fork is unsafe with JAX's threads); keeps a list of them."""

    def __init__(self) -> None:
        super().__init__()
        self._processes: list[SpawnProcess] = []

    @property
    def processes(self) -> list[SpawnProcess]:
        """Processes that were started."""
        return [process for process in self._processes if process.pid is not None]

    def Process(self, *args: Any, **options: Any) -> SpawnProcess:  # type: ignore[override]
        """A process that an executor is about to start."""
        process = SpawnProcess(*args, **options)
        self._processes.append(process)
        return process


class _Workers:
    """A pool of processes until one of them dies.

    Args:
        function: pickled.
        count: most processes.
        errors: file for their standard error; None for that of this process.
    """

    def __init__(self, function: bytes, count: int, errors: IO[bytes] | None = None) -> None:
        self._context = _Context()
        self._errors = errors
        with _no_interrupt():  # may start the process that watches over semaphores
            self._started = self._context.Event()
            self._pool = ProcessPoolExecutor(
                count, self._context, _begin, (function, self._started)
            )

    def submit(self, raw: bytes) -> Future[bytes]:
        """Gives a pickled task to a worker; may start one."""
        with _standard_error(self._errors), _no_interrupt():
            return self._pool.submit(_work, raw)

    def started(self) -> bool:
        """Whether a worker came as far as its first task."""
        return self._started.is_set()

    def exit(self) -> str:
        """The end of the worker that died, for a message."""
        deadline = time.monotonic() + 1.0  # the executor's thread may be about to read a status
        while None in (codes := [process.exitcode for process in self._context.processes]):
            if time.monotonic() > deadline:
                break
            time.sleep(0.01)
        ended = (0, None, -signal.SIGTERM)  # by us
        code = next((code for code in codes if code not in ended), codes[-1])
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"signal {signal.Signals(-code).name}"
        return f"exit status {code}"

    def end(self) -> None:
        """Ends the workers."""
        for process in self._context.processes:
            process.terminate()
        deadline = time.monotonic() + _GRACE_S
        for process in self._context.processes:
            process.join(max(0.0, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()
        # Without waiting: the thread of a pool whose worker was killed in the middle of a message
        # may wait for the rest of it.
        self._pool.shutdown(wait=False, cancel_futures=True)


@contextlib.contextmanager
def _standard_error(target: IO[bytes] | None) -> Iterator[None]:
    """Processes that start in this block write their standard error to a file."""
    if target is None:
        yield
        return
    before = os.dup(2)
    os.dup2(target.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)


@contextlib.contextmanager
def _no_interrupt() -> Iterator[None]:
    """A terminal's signals wait for the end of the block; a child that starts in it never gets
    them."""
    if not hasattr(signal, "pthread_sigmask") or threading.current_thread() is not (
        threading.main_thread()
    ):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {*ENDING} - {signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# In a worker.


class _Stopped(BaseException):
    """The parent ends this worker; not an Exception, so that no function swallows it."""


_function: Callable[[Any], Any]
_busy = False


def _begin(function: bytes, started: Any) -> None:
    """Prepares a worker: signals, one thread, the function."""
    global _function
    leave_to_parent()
    signal.signal(signal.SIGTERM, _stop)
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, _stop)
    threading.Thread(target=_die_with_parent, daemon=True).start()
    with one_thread(os.getpid()) as start_threads:
        _function = ForkingPickler.loads(function)
        start_threads()
    started.set()


def _work(raw: bytes) -> bytes:
    """Pickled value, error and seconds of a pickled task."""
    global _busy
    _busy = True
    try:
        return packed_answer(_function, raw)
    except _Stopped:
        _leave()
        raise
    finally:
        _busy = False


def _stop(_signal: int, frame: FrameType | None) -> None:
    if _busy:
        raise _Stopped
    while frame is not None:
        if frame.f_code.co_name == "_sendback_result":  # half a message would hold up the parent
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
            return
        frame = frame.f_back
    _leave()


def _leave() -> None:
    # The executor's own loop would take the next task.
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):
            stream.flush()
    os._exit(0)


def _die_with_parent() -> None:
    # A parent that was killed closes nothing; a worker must not go on writing during a second run.
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
