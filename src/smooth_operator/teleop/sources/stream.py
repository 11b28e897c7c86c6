"""Sources that receive messages: what UDP, ZeroMQ and gloves have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Sequence
from typing import Final, Literal, Protocol, TypeAlias

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.sources.live import Running, ThreadedSource
from smooth_operator.teleop.sources.message_receiver import Message, MessageReceiver
from smooth_operator.teleop.sources.payload import Reading
from smooth_operator.types import Side

Hands: TypeAlias = Literal["right", "left", "both"]
"""Which hands a source takes."""

KEPT: Final = 8
"""Messages that are read when more have come together, the newest. Two hands, their both
alternating, and a broken one between, leave each hand its newest frame."""

_APART_S = 1e-6
_POLL_S = 0.1  # how long a source that hears nothing needs to notice that it is to stop
_SIDES: Final[dict[str, tuple[Side, ...]]] = {
    "right": ("right",),
    "left": ("left",),
    "both": ("right", "left"),
}


def sides_of(hands: str) -> tuple[Side, ...]:
    """The sides of ``right``, ``left`` or ``both``.

    Raises:
        ConfigError: it is none of them.
    """
    if hands not in _SIDES:
        raise ConfigError(f"side must be 'right', 'left' or 'both', not {hands!r}")
    return _SIDES[hands]


def only_side(hands: str) -> Side | None:
    """The side of ``right`` or ``left``; None for ``both``."""
    sides = sides_of(hands)
    return sides[0] if len(sides) == 1 else None


def check_port(port: int | None) -> None:
    """Refuse a port that is none; None stands for a default.

    Raises:
        ConfigError: it is outside 0 to 65535.
    """
    if port is not None and not 0 <= port <= 65_535:
        raise ConfigError(f"port must be 0 to 65535, not {port}")


class Inbox(Protocol):
    """An open socket."""

    @property
    def address(self) -> str:
        """Where it listens or what it is connected to; an asked-for port 0 is the real one."""

    def receive(self, timeout: float) -> Sequence[Message]:
        """Wait for messages up to ``timeout`` [s]; of all that are here, the newest few in order.

        Raises:
            SourceError: the socket gave up.
        """

    def close(self) -> None:
        """Give it back."""


class StreamSource(ThreadedSource):
    """A source with an inbox; subclasses open it and read its messages.

    Attributes:
        side: the hands that are taken.
    """

    side: Hands

    @abstractmethod
    def connect(self) -> Inbox:
        """Open the inbox.

        Raises:
            SourceError: it can't be opened.
            MissingExtraError: its library is not installed.
        """

    @abstractmethod
    def read(self, message: Message, received: float) -> Sequence[Reading]:
        """The hands of a message.

        Raises:
            RecordingError: it can't be read.
        """

    @property
    def sides(self) -> Collection[Side]:
        """The hands that it takes."""
        return sides_of(self.side)

    @property
    def hint(self) -> str:
        """What to look at while nothing has come: a clause that begins with a sign, or nothing."""
        return ""

    def problem(self, inbox: Inbox) -> str:
        """Why nothing can come, for an inbox that connects; empty where nothing is wrong."""
        return ""

    @property
    def endpoint(self) -> str | None:
        """What it listens to, an asked-for free port being a real one; None before its start."""
        inbox: Inbox | None = getattr(self, "_inbox", None)
        return None if inbox is None else inbox.address

    def open(self) -> None:
        """Open the inbox here, where its errors reach the caller."""
        object.__setattr__(self, "_inbox", self.connect())

    def run(self, running: Running) -> None:
        """Take messages until it is to stop."""
        inbox: Inbox = getattr(self, "_inbox")  # noqa: B009  (set in open(), past the frozen fields)
        try:
            receiver = MessageReceiver(running, inbox.address, self.sides, self.read, self.hint)
            while not running.stopping.is_set():
                messages = inbox.receive(_POLL_S)
                received = running.mailbox.clock()
                for number, message in enumerate(messages):
                    # Messages that came together have an order: a stamp that is the time of receipt
                    # must increase, or the loop takes the newest frame for a repeated one.
                    receiver.take(message, received + number * _APART_S)
                if not messages:
                    receiver.silent(self.problem(inbox))
        finally:
            inbox.close()
