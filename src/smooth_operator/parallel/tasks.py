"""Runs a task and packs its result, and prepares a process to work on tasks."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from typing import Any, Final, Generic, TypeVar

T = TypeVar("T")
R = TypeVar("R")

DIED: Final = "WorkerDied"
"""Beginning of the error message of a task whose workers died."""


@dataclass(frozen=True)
class TaskResult(Generic[R]):
    """The result of one task.

    Attributes:
        index: position of the task.
        value: value of the function; None after a failure.
        error: type and text of the exception in one line; None without a failure.
        seconds: time of the last attempt, without waiting [s].
        attempts: number of starts; more than 1 if a worker died.
    """

    index: int
    value: R | None
    error: str | None
    seconds: float
    attempts: int


def timed(function: Callable[[T], R], task: T) -> tuple[R | None, str | None, float]:
    """Calls a function with a task; returns the value, the error and the time taken [s]. An
    exception of the function becomes the error.

    This includes ``SystemExit``, because a library that exits must not end a worker.
    """
    started = time.perf_counter()
    value: R | None = None
    error: str | None = None
    try:
        value = function(task)
    except (Exception, SystemExit) as failure:
        error = describe(failure)
    return value, error, time.perf_counter() - started


def packed_answer(function: Callable[[Any], Any], raw: bytes) -> bytes:
    """Runs a pickled task in a worker; returns its value, error and time taken, pickled."""
    answer = timed(lambda _: function(ForkingPickler.loads(raw)), None)
    try:
        return pack(*answer)
    except Exception as error:
        return pack(None, f"the result can't be sent back: {describe(error)}", answer[2])


def pack(value: Any, error: str | None, seconds: float = 0.0) -> bytes:
    """Pickles the answer to a task."""
    return bytes(ForkingPickler.dumps((value, error, seconds)))


def describe(error: BaseException) -> str:
    """Describes an exception in one human-readable line."""
    text = " ".join(str(error).split())
    kind = type(error).__name__
    return f"{kind}: {text}" if text else kind


def death(attempts: int, how: str) -> str:
    """Error message of a task whose workers died."""
    times = "once" if attempts == 1 else f"{attempts} times"
    return f"{DIED}: its worker process died {times} ({how}); if memory ran out, use fewer workers"


@contextmanager
def one_thread(slot: int) -> Iterator[Callable[[], None]]:
    """Makes multithreaded libraries use only one thread inside the block.

    Small programs are faster with one: the preset realtime takes 0.6 ms per frame on one of XLA's
    threads and 0.8 ms on two. Also, as many workers as cores then do not compete for the cores.

    XLA and BLAS size their pools once, by the cores that the process may use at that time. The
    process may therefore use one core in the block, and all of them afterwards, since a worker on a
    single core waits while another process uses that core. XLA's switch
    (``xla_cpu_multi_thread_eigen``) is not set: it changes the compiled program, and with it the
    last bits of the results.

    On systems without a choice of cores (macOS, Windows) nothing is limited; the results are the
    same.

    Args:
        slot: number of the worker; neighbours start on different cores.

    Yields:
        a function to call after all libraries are imported, with which XLA, if it is imported,
        starts its threads immediately rather than at its first use.
    """
    # Several processes share an accelerator; by default the first would take all its memory.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    if not hasattr(os, "sched_setaffinity"):
        yield _start_threads
        return
    all_cores = os.sched_getaffinity(0)
    with suppress(OSError):  # a sandbox may forbid it
        os.sched_setaffinity(0, {sorted(all_cores)[slot % len(all_cores)]})
    try:
        yield _start_threads
    finally:
        with suppress(OSError):
            os.sched_setaffinity(0, all_cores)


def _start_threads() -> None:
    # Not imported here, since workers without JAX must not wait for it.
    jax: Any = sys.modules.get("jax")
    if jax is not None:
        with suppress(AttributeError):  # a JAX that has no such option
            # Compute on the calling thread, which would only wait for another one.
            jax.config.update("jax_cpu_enable_async_dispatch", False)
        jax.devices()
