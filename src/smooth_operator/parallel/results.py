"""Results of tasks."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class TaskResult(Generic[R]):
    """What came of one task.

    Attributes:
        index: its position among the tasks.
        value: what the function returned; None if it failed.
        error: why it failed, one line for a person with the type of the exception; None if it
            did not.
        seconds: how long the last attempt took, without waiting for its turn [s].
        attempts: how often it was started; more than 1 if a worker died at it.
    """

    index: int
    value: R | None
    error: str | None
    seconds: float
    attempts: int


def timed(function: Callable[[T], R], task: T) -> tuple[R | None, str | None, float]:
    """Value, error and seconds of one call; an exception of the function is an answer like another.

    ``SystemExit`` counts as one: a library that leaves the program must not take a worker with it.
    """
    started = time.perf_counter()
    value: R | None = None
    error: str | None = None
    try:
        value = function(task)
    except (Exception, SystemExit) as failure:
        error = describe(failure)
    return value, error, time.perf_counter() - started


def describe(error: BaseException) -> str:
    """An exception as one line for a person."""
    text = " ".join(str(error).split())
    kind = type(error).__name__
    return f"{kind}: {text}" if text else kind


def death(attempts: int, how: str) -> str:
    """Why a task is given up whose workers died."""
    times = "once" if attempts == 1 else f"{attempts} times"
    return (
        f"WorkerDied: the process that worked on it died {times} ({how}); if memory ran out, "
        "use fewer workers"
    )
