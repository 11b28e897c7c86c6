"""A second thread for the loop: it answers one hand's frame while the loop answers the other's.

A step of a method is a function of a state and a frame, and XLA gives up Python's lock while it
runs. So the answer to a frame that waits for its turn can be worked out meanwhile, and taken when
its turn comes; if the turn comes before the thread has begun, nothing is lost.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any


class Ahead:
    """A call that another thread may make before its value is asked for.

    Args:
        function: what to call.
        arguments: with what.
    """

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self._function, self.arguments = function, arguments
        self._begun, self._done = threading.Lock(), threading.Lock()
        self._done.acquire()
        self._value: Any = None
        self._error: BaseException | None = None

    def work(self) -> None:
        """Make the call, unless it was withdrawn."""
        if not self._begun.acquire(blocking=False):
            return
        try:
            self._value = self._function(*self.arguments)
        except BaseException as error:
            self._error = error
        finally:
            self._done.release()

    def withdraw(self) -> bool:
        """Have the call not be made; whether that was possible. Otherwise it waits for its end."""
        if self._begun.acquire(blocking=False):
            return True
        with self._done:
            return False

    def value(self) -> Any:
        """What the call gave, or raised; it is made here if no thread has begun with it."""
        self.work()
        with self._done:
            if self._error is not None:
                raise self._error
            return self._value


class Helper:
    """A thread that works ahead, in the order of the calls; its thread runs while it is entered."""

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[Ahead | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="ahead", daemon=True)

    def begin(self, function: Callable[..., Any], *arguments: Any) -> Ahead:
        """Have a call made as soon as may be."""
        call = Ahead(function, *arguments)
        self._calls.put(call)
        return call

    def __enter__(self) -> Helper:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._calls.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            call.work()
