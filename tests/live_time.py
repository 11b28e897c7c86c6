"""Time and mailboxes for tests of live sources: time that passes only where someone waits."""

import time
from collections.abc import Callable
from typing import Any

from smooth_operator.teleop.sources.live import Arrival, Mailbox, Running
from smooth_operator.types import HandFrame

PATIENCE_S = 600.0
"""Longest wait for something that comes about on an idle machine at once [s]. A wait that is over
early costs nothing, and a machine with twenty programs for each core is slow."""


class Kept(Mailbox):
    """A mailbox that also keeps all that was ever posted."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        super().__init__(clock)
        self.all: list[Arrival] = []

    def post(
        self,
        frame: HandFrame,
        *,
        received: float | None = None,
        session: int = 0,
        speed: float = 1.0,
    ) -> Arrival:
        arrival = super().post(frame, received=received, session=session, speed=speed)
        self.all.append(arrival)
        return arrival


class Waits:
    """A clock, and the event that a source waits on: waiting is what moves the clock.

    Args:
        until: when the event is set [s].
        overshoot: by how much each wait is too long [s].
    """

    def __init__(self, until: float = float("inf"), overshoot: float = 0.0) -> None:
        self.now = 0.0
        self._until = until
        self._overshoot = overshoot

    def clock(self) -> float:
        return self.now

    def wait(self, timeout: float) -> bool:
        assert timeout > 0.0
        self.now += timeout + self._overshoot
        return self.is_set()

    def is_set(self) -> bool:
        return self.now > self._until


def started(waits: Waits) -> tuple[Running, Kept]:
    """A running source without its thread, in a time of its own."""
    mailbox = Kept(waits.clock)
    running = Running(mailbox, "test")
    running.stopping = waits
    return running, mailbox


def until(condition: Callable[[], Any], timeout: float = PATIENCE_S) -> Any:
    """Wait until something is true; its value. A busy machine takes long.

    Raises:
        AssertionError: it never came to be.
    """
    end = time.monotonic() + timeout
    while not (value := condition()):
        assert time.monotonic() < end, "it did not come to be in time"
        time.sleep(0.005)
    return value
