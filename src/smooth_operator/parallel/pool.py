"""A pool of local processes in which a dead worker costs one attempt at one task.

The standard library's pools break, or wait for ever, when a worker is killed; here each worker has
its own link, so that a death is seen immediately and known to be that worker's.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, Final, TypeVar

from smooth_operator.errors import WorkerError
from smooth_operator.parallel.results import TaskResult, death, describe
from smooth_operator.parallel.worker import READY, serve
from smooth_operator.signals import ENDING

T = TypeVar("T")
R = TypeVar("R")

_GRACE_S: Final = 5.0
"""How long a worker may clean up before it is killed; compiling can't be interrupted."""


_START_S: Final = 60.0
_TAIL: Final = 4096
"""Bytes of a dead worker's standard error that are read."""


@dataclass
class _Worker:
    slot: int
    process: SpawnProcess
    link: Connection[Any, Any]
    ready: bool = False
    task: int | None = None
    since: float = 0.0


def run_in_pool(
    function: Callable[[T], R], tasks: Sequence[T], workers: int, retries: int
) -> Iterator[TaskResult[R]]:
    """See ``run_tasks``."""
    pool = Pool(function, retries)
    try:
        pool.add(tasks)
        pool.start_up_to(min(workers, len(tasks)))
        yield from pool.results()
    finally:
        pool.stop()


class Pool:
    """The processes; tasks may be added while they wait.

    Args:
        function: importable by its module and name.
        retries: how often a task is tried again whose worker died.
    """

    def __init__(self, function: Callable[[Any], Any], retries: int) -> None:
        self._function = function
        self._tasks: dict[int, Any] = {}
        self._retries = retries
        self._waiting: deque[int] = deque()
        self._attempts: list[int] = []
        self._workers: list[_Worker] = []
        self._false_starts = 0
        # Fork is unsafe with JAX's threads.
        self._context = multiprocessing.get_context("spawn")

    def add(self, tasks: Sequence[Any]) -> None:
        """More tasks; they are numbered on from those before."""
        first = len(self._attempts)
        self._tasks |= dict(enumerate(tasks, first))
        self._waiting.extend(range(first, first + len(tasks)))
        self._attempts += [0] * len(tasks)

    def start_up_to(self, count: int) -> None:
        """Has at least so many workers."""
        taken = {worker.slot for worker in self._workers}
        for slot in [slot for slot in range(count) if slot not in taken]:
            self._start(slot)

    def _start(self, slot: int) -> None:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=serve, args=(theirs, slot), daemon=True)
        with _no_interrupt():
            process.start()
        theirs.close()  # so that its end is the last one, and its death is read as the end
        self._workers.append(_Worker(slot, process, ours))
        with contextlib.suppress(OSError):  # it died at its start: seen when it is waited for
            ours.send(self._function)

    def results(self) -> Iterator[TaskResult[Any]]:
        """Until every task has its result."""
        for worker in list(self._workers):
            if worker.ready and worker.task is None:
                yield from self._give(worker)
        while self._waiting or any(w.task is not None for w in self._workers):
            links = {worker.link: worker for worker in self._workers}
            for link in connection.wait(list(links)):
                worker = links[link]  # type: ignore[index]
                try:
                    message = worker.link.recv()
                except (EOFError, OSError):
                    yield from self._bury(worker)
                    continue
                except Exception as error:
                    message = (None, f"the result can't be read: {describe(error)}", _since(worker))
                if worker.ready:
                    result = self._result(worker, *message)
                    yield from self._give(worker)  # first, so that it works while we are read
                    yield result
                elif message[0] == READY:
                    worker.ready = True
                    self._false_starts = 0
                    yield from self._give(worker)
                else:
                    raise WorkerError(f"workers can't import the function: {message[1]}")

    def stop(self) -> None:
        """Ends all workers; those at a task may clean up first."""
        for worker in self._workers:
            worker.link.close()
            if worker.task is not None or not worker.ready:
                worker.process.terminate()
        deadline = time.monotonic() + _GRACE_S
        for worker in self._workers:
            worker.process.join(max(0.0, deadline - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.process.close()
        self._workers.clear()

    def _give(self, worker: _Worker) -> Iterator[TaskResult[Any]]:
        """The next task, if there is one; a result where that task can't be sent."""
        while self._waiting:
            index = self._waiting.popleft()
            self._attempts[index] += 1
            worker.task, worker.since = index, time.perf_counter()
            try:
                worker.link.send(self._tasks[index])
            except OSError:
                return  # it has died: seen when it is waited for
            except Exception as error:  # nothing was sent: pickling comes first
                yield self._result(worker, None, f"the task can't be sent: {describe(error)}", 0.0)
                continue
            return

    def _result(
        self, worker: _Worker, value: Any, error: str | None, seconds: float
    ) -> TaskResult[Any]:
        index, worker.task = worker.task, None
        assert index is not None
        self._tasks.pop(index, None)
        return TaskResult(index, value, error, seconds, self._attempts[index])

    def _bury(self, worker: _Worker) -> Iterator[TaskResult[Any]]:
        """After a death: a fresh worker where there is work, and its task again or given up."""
        self._workers.remove(worker)
        worker.link.close()
        worker.process.join(_GRACE_S)
        how = _how(worker.process)
        if not worker.ready:
            self._false_starts += 1
            if self._false_starts > max(2, self._retries):
                raise WorkerError(
                    f"{self._false_starts} workers in a row ended before their first task ({how}); "
                    + self._reason()
                )
        if worker.task is not None:
            index = worker.task
            if self._attempts[index] > self._retries:
                error = death(self._attempts[index], how)
                yield TaskResult(index, None, error, _since(worker), self._attempts[index])
            else:
                self._waiting.appendleft(index)
        if self._waiting:
            self._start(worker.slot)

    def _reason(self) -> str:
        """Why workers die at their start, by what one more of them writes to standard error."""
        with tempfile.TemporaryFile() as errors:
            with _standard_error(errors.fileno()):
                self._start(0)
            worker = self._workers.pop()
            connection.wait([worker.link], _START_S)
            worker.link.close()
            worker.process.join(_GRACE_S)
            worker.process.kill()
            errors.seek(max(0, errors.seek(0, os.SEEK_END) - _TAIL))
            text = errors.read().decode(errors="replace")
        print(text, end="", file=sys.stderr)
        if "bootstrapping phase" in text:  # multiprocessing's own words
            return (
                "a script that starts workers needs 'if __name__ == \"__main__\":' around what it "
                "does"
            )
        lines = text.split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "")
        return last[-300:] or "each worker needs memory for its own libraries: use fewer workers"


def _since(worker: _Worker) -> float:
    return time.perf_counter() - worker.since


def _how(process: SpawnProcess) -> str:
    code = process.exitcode
    if code is not None and code < 0:
        with contextlib.suppress(ValueError):
            return f"signal {signal.Signals(-code).name}"
    return f"exit status {code}"


@contextlib.contextmanager
def _standard_error(target: int) -> Iterator[None]:
    """What starts in this block writes its standard error to a file."""
    before = os.dup(2)
    os.dup2(target, 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)


@contextlib.contextmanager
def _no_interrupt() -> Iterator[None]:
    """Signals of a terminal wait until the block is over; the child that starts in it never sees
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
