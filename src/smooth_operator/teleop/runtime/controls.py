"""Controls of a running loop, for the page, the keyboard, messages and signals."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

from smooth_operator.teleop.sources.live import Mailbox

if TYPE_CHECKING:
    from smooth_operator.teleop.runtime.pipeline import HandPipeline

Change: TypeAlias = Callable[["HandPipeline"], None]
"""Something to be done to every hand, between two of its steps."""


class Controls:
    """Switches of a loop; safe to use from any thread and from a signal handler.

    Each takes effect before the loop's next command, and wakes the loop for it.

    Args:
        mailbox: what the loop sleeps on.
    """

    def __init__(self, mailbox: Mailbox) -> None:
        self._mailbox = mailbox
        self._pending: deque[Change] = deque()
        self._stops = 0  # how many there were: a release ends those that came before it, only
        self._quit = threading.Event()

    def pause(self) -> None:
        """Release the clutch: the robot holds."""
        self.change(lambda hand: hand.supervisor.pause())

    def resume(self) -> None:
        """Take the clutch: the robot goes over to where the operator's hand is now."""
        self.change(lambda hand: hand.supervisor.resume())

    def follow(self, on: bool) -> None:
        """Take the clutch of the wrist, or release it: fingers go on, the wrist holds."""
        self.change(lambda hand: hand.clutch.follow(on))

    def stop(self) -> None:
        """Emergency stop: the robot stands until a ``release`` that comes later."""
        self._stops += 1
        # before whatever else is waiting
        self._pending.appendleft(lambda hand: hand.supervisor.stop())
        self._mailbox.wake()

    def release(self) -> None:
        """End an emergency stop; one that comes before this has been done stays."""
        stops = self._stops

        def release(hand: HandPipeline) -> None:
            if self._stops == stops:
                hand.supervisor.release()

        self.change(release)

    def change(self, change: Change) -> None:
        """Have something done to every hand, on the loop's thread; it must be quick."""
        self._pending.append(change)
        self._mailbox.wake()

    def quit(self) -> None:
        """End the loop."""
        self._quit.set()
        # A signal handler may run inside the mailbox, on the thread that holds its lock.
        threading.Thread(target=self._mailbox.wake, daemon=True).start()

    @property
    def quitting(self) -> bool:
        """Whether the loop is to end."""
        return self._quit.is_set()

    @property
    def waiting(self) -> bool:
        """Whether there is something to do."""
        return bool(self._pending) or self.quitting

    def drain(self) -> list[Change]:
        """What is to be done now, in order; the loop's own."""
        changes = []
        while self._pending:
            changes.append(self._pending.popleft())
        return changes
