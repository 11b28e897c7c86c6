"""Runs a function over many tasks: in this process, in processes of this machine, or on Ray.

Each worker is an executor of ``concurrent.futures`` with one process: when a process dies, its
executor breaks, which identifies the task, and no other task is affected.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection, parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from types import FrameType
from typing import Any, Final, Generic, TypeVar

from smooth_operator.errors import ConfigError, WorkerError
from smooth_operator.parallel.tasks import (
    TaskResult,
    death,
    describe,
    one_thread,
    pack,
    packed_answer,
    timed,
)
from smooth_operator.signals import ENDING, leave_to_parent

T = TypeVar("T")
R = TypeVar("R")

_GRACE_S: Final = 5.0
"""Time that a worker has to clean up before it is killed [s]; compiling can't be interrupted."""

_REPEAT_S: Final = 1.0
_MESSAGE: Final = 2048
"""Largest result that is sent through a pipe [bytes]; a pipe writes 4,096 atomically."""


def run_tasks(
    function: Callable[[T], R],
    tasks: Sequence[T],
    *,
    workers: int | None = None,
    cluster: str | None = None,
    retries: int = 2,
) -> Generator[TaskResult[R]]:
    """Calls a function with each task, several in parallel.

    Tasks are started in their order. An exception of the function is the result of its task,
    without a retry. A worker that dies (killed, out of memory), even while it sends a result, is
    replaced, and its task is retried. A failure of one task does not affect another. Each worker
    computes on one thread, which is faster for small programs. When the caller stops, by an
    exception, Ctrl-C or closing the iterator, the workers are stopped.

    Args:
        function: a function that is importable by its module and name. Workers import it, so a
            script that calls this needs ``if __name__ == "__main__":``.
        tasks: values that can be pickled. They and the results are sent between processes, so
            large data should be passed as a path.
        workers: number of workers; None for all usable cores, or all CPUs of a running cluster.
            With 0, and without a cluster, the tasks run in this process.
        cluster: None for processes on this machine; ``"auto"`` or the address of a running Ray
            cluster; ``"local"`` for a Ray started for this run. Nodes need this package, and the
            folders that tasks name.
        retries: number of retries of a task whose worker died.

    Returns:
        an iterator of one ``TaskResult`` per task, in the order in which they finish.

    Raises:
        ConfigError: a number is negative, or the function can't be sent to another process.
        MissingExtraError: ``cluster`` is given and Ray is not installed.
        WorkerError: the cluster can't be reached, or no worker starts.
    """
    if cluster is None:
        return _in_pool(PersistentPool(function, workers, retries), tasks)
    if workers == 0:
        raise ConfigError("a cluster needs at least one worker; omit the number to use all workers")
    _check(workers, retries)
    from smooth_operator.parallel.cluster import run_on_cluster

    return run_on_cluster(function, tasks, cluster, workers=workers, retries=retries)


def usable_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class PersistentPool(Generic[T, R]):
    """Worker processes that keep their compiled programs from one list of tasks to the next.

    It is meant for a search in which the next tasks depend on previous results. Failures and
    retries are handled as in ``run_tasks``. Use it as a context manager: the workers end with the
    block.

    Args:
        function: a function that is importable by its module and name.
        workers: number of workers; None for all usable cores. With 0, tasks run in this process.
        retries: number of retries of a task whose worker died.

    Raises:
        ConfigError: a number is negative, or the function can't be sent to another process.
    """

    def __init__(
        self, function: Callable[[T], R], workers: int | None = None, retries: int = 2
    ) -> None:
        _check(workers, retries)
        self._function, self._retries = function, retries
        self._workers = usable_cores() if workers is None else workers
        self._all: list[_Worker] = []
        self._idle: list[_Worker] = []
        self._starts = self._false_starts = 0
        self._folder = ""
        self._raw = b""
        if self._workers:
            try:
                self._raw = bytes(ForkingPickler.dumps(function))
            except Exception as error:
                raise ConfigError(
                    f"{function!r} can't be sent to another process ({describe(error)}); expected "
                    "a function at the top level of an importable module"
                ) from error

    def run(self, tasks: Sequence[T]) -> Generator[TaskResult[R]]:
        """Yields one result per task, in the order in which the tasks finish."""
        if not self._workers:
            for index, task in enumerate(tasks):
                yield TaskResult(index, *timed(self._function, task), 1)
            return
        attempts = [0] * len(tasks)
        waiting = deque(range(len(tasks)))
        running: dict[Future[bytes | str], tuple[int, _Worker, float]] = {}
        finished: list[TaskResult[R]] = []
        try:
            while waiting or running:
                while waiting and len(running) < self._workers:
                    index = waiting.popleft()
                    try:
                        raw = bytes(ForkingPickler.dumps(tasks[index]))
                    except Exception as error:
                        reason = f"the task can't be sent: {describe(error)}"
                        finished.append(TaskResult(index, None, reason, 0.0, 1))
                        continue
                    attempts[index] += 1
                    future, worker = self._submit(raw)
                    running[future] = index, worker, time.perf_counter()
                yield from finished  # after the workers got their next tasks
                finished.clear()
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    index, worker, since = running.pop(future)
                    if future.exception() is None:
                        self._false_starts = 0
                        self._idle.append(worker)
                        finished.append(TaskResult(index, *_answer(future), attempts[index]))
                    elif self._bury(worker) and attempts[index] > self._retries:
                        seconds = time.perf_counter() - since
                        cause = death(attempts[index], worker.exit())
                        finished.append(TaskResult(index, None, cause, seconds, attempts[index]))
                    else:
                        attempts[index] -= not worker.started()
                        waiting.appendleft(index)
            yield from finished
        finally:
            if running:
                self.close()

    def _submit(self, raw: bytes) -> tuple[Future[bytes | str], _Worker]:
        """Submit a pickled task to an idle worker, or to a new one."""
        while True:
            if self._idle:
                worker = self._idle.pop()
            else:
                self._starts += 1
                self._folder = self._folder or tempfile.mkdtemp(prefix="results-")
                with _no_interrupt():
                    worker = _Worker(self._raw, self._starts, self._folder)
                    self._all.append(worker)
            try:
                return worker.submit(raw), worker
            except BrokenProcessPool:  # it died while idle
                self._bury(worker)

    def _bury(self, worker: _Worker) -> bool:
        """Clean up after the death of a worker; False if it died before its first task. WorkerError
        if workers repeatedly die at their start."""
        _end([worker])
        self._all.remove(worker)
        if worker.started():
            return True
        self._false_starts += 1
        if self._false_starts > max(2, self._retries):
            raise WorkerError(
                f"{self._false_starts} workers in a row ended before their first task "
                f"({worker.exit()}); their messages are on standard error. A script that "
                "starts workers needs 'if __name__ == \"__main__\":' around its main code; each "
                "worker needs memory for its own libraries"
            )
        return False

    def close(self) -> None:
        """Ends the workers. A worker that is busy with a task can clean up first."""
        _end(self._all)
        self._all.clear()
        self._idle.clear()
        if self._folder:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = ""

    def __enter__(self) -> PersistentPool[T, R]:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _check(workers: int | None, retries: int) -> None:
    for name, value in (("workers", workers), ("retries", retries)):
        if value is not None and value < 0:
            raise ConfigError(f"{name} must be 0 or more, not {value}")


def _in_pool(pool: PersistentPool[T, R], tasks: Sequence[T]) -> Generator[TaskResult[R]]:
    with pool:
        yield from pool.run(tasks)


def _answer(future: Future[bytes | str]) -> tuple[Any, str | None, float]:
    """Reads the value, the error and the seconds of a result."""
    try:
        raw = future.result()
        if isinstance(raw, str):
            file = Path(raw)
            raw = file.read_bytes()
            file.unlink()
        value, error, seconds = ForkingPickler.loads(raw)
    except Exception as failure:
        return None, f"the result can't be read: {describe(failure)}", 0.0
    return value, error, seconds


class _Context(SpawnContext):
    """A spawning context that stores its process; fork is unsafe with JAX's threads."""

    process: SpawnProcess

    def Process(self, *args: Any, **options: Any) -> SpawnProcess:  # type: ignore[override]
        """Create the process of an executor."""
        self.process = SpawnProcess(*args, **options)
        return self.process


class _Worker:
    """An executor with one process.

    Args:
        function: the pickled function.
        slot: number of the worker.
        folder: folder for large results.

    Attributes:
        ready: done once the worker has the function.
        process: the process.
    """

    def __init__(self, function: bytes, slot: int, folder: str) -> None:
        context = _Context()
        self._executor = ProcessPoolExecutor(1, context, _begin, (function, slot, folder))
        self.ready: Future[int] = self._executor.submit(os.getpid)
        self.process = context.process
        self._task: Future[bytes | str] | None = None

    def submit(self, raw: bytes) -> Future[bytes | str]:
        """Submit a pickled task to the worker."""
        self._task = self._executor.submit(_work, raw)
        return self._task

    def started(self) -> bool:
        """True if the worker was ready for its first task."""
        return self.ready.done() and self.ready.exception() is None

    def exit(self) -> str:
        """Exit status or signal of the process, for a message."""
        code = self.process.exitcode
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"signal {signal.Signals(-code).name}"
        return f"exit status {code}"

    def end(self) -> None:
        """End the process; a task can clean up first."""
        killer = threading.Timer(_GRACE_S, self.process.kill)
        killer.start()
        if not (self.started() if self._task is None else self._task.done()):
            self.process.terminate()
        self._executor.shutdown(cancel_futures=True)
        killer.cancel()
        killer.join()


def _end(workers: Sequence[_Worker]) -> None:
    # At the exit of the interpreter no thread can start; concurrent.futures then ends the workers.
    with (
        contextlib.suppress(RuntimeError),
        ThreadPoolExecutor(max(1, len(workers))) as threads,
    ):
        list(threads.map(_Worker.end, workers))


@contextlib.contextmanager
def _no_interrupt() -> Iterator[None]:
    """Blocks signals of a terminal inside the block, and in a child process that starts in it."""
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
    """Raised when the parent ends this task; a BaseException, so that the function does not catch
    it.
    """


_function: Callable[[Any], Any]
_folder: str
_busy = False


def _begin(function: bytes, slot: int, folder: str) -> None:
    """Sets up a worker: signals, one thread, the function."""
    global _function, _folder
    _folder = folder
    leave_to_parent()
    threading.Thread(target=_die_with_parent, daemon=True).start()
    with one_thread(slot) as start_threads:
        _function = ForkingPickler.loads(function)
        start_threads()
    sys.unraisablehook = _unraisable
    signal.signal(signal.SIGTERM, _stop)
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, _stop)


def _work(raw: bytes) -> bytes | str:
    """Runs a pickled task; returns its pickled value, error and seconds, or the path of a file with
    them.

    An executor would wait endlessly for the rest of a message whose sender is killed. Therefore
    messages are small, so that they are written atomically.
    """
    global _busy
    try:
        _busy = True
        answer = packed_answer(_function, raw)
        if len(answer) <= _MESSAGE:
            return answer
        with tempfile.NamedTemporaryFile(dir=_folder, delete=False) as file:
            file.write(answer)
        return file.name
    except OSError as error:
        return pack(None, f"the result can't be sent back: {describe(error)}")
    finally:
        _busy = False


def _stop(_signal: int, _frame: FrameType | None) -> None:
    if _busy:  # without a task the executor ends the process
        if hasattr(signal, "setitimer"):
            # Repeat it, since an exception in a callback of the garbage collector is lost.
            signal.setitimer(signal.ITIMER_REAL, _REPEAT_S)
        raise _Stopped


def _unraisable(lost: sys.UnraisableHookArgs) -> None:
    if lost.exc_type is not _Stopped:
        sys.__unraisablehook__(lost)


def _die_with_parent() -> None:
    # A killed parent closes nothing, and its workers must not write during a second run.
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        shutil.rmtree(_folder, ignore_errors=True)
        os._exit(1)
