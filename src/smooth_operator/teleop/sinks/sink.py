"""What every sink is to the loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.types import Side

if TYPE_CHECKING:  # the command line names sinks in its help, and that must not import JAX
    from smooth_operator.hands.hand import Hand


class Sink(Protocol):
    """Where commands go: a robot, a simulation, a file, a bus.

    Sinks are dataclasses of settings. The loop calls ``send`` from one thread and never waits
    for the far side: a sink that may have to wait keeps the newest command for a thread of its own.
    A sink that raises is closed, opened again after a while, and does not stop the others.

    A sink with an attribute ``observes`` that is true moves nothing, and gets its ticks after the
    others have theirs, with the time that took among the stages: the log, the table.
    """

    @property
    def label(self) -> str:
        """What it is, in a few words."""

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Get ready for the commands of these hands; may be called again after ``close``.

        Args:
            hands: side -> robot hand.
            config: the resolved configuration of the run, JSON-serialisable, for sinks that keep
                it.

        Raises:
            SinkError: it can't be opened.
            OutputError: its file can't be written.
            MissingExtraError: a library that it needs is not installed.
        """

    def send(self, tick: Tick) -> None:
        """Hand over a command, in well under a millisecond.

        Raises:
            SinkError: the far side is gone.
            OutputError: the disk is full.
        """

    def stalled(self, seconds: float) -> None:
        """The watchdog's word, from its own thread: no command has come for so long.

        Called again and again while the silence lasts.
        """

    def close(self) -> None:
        """Write what is pending and give everything back; a second call does nothing."""
