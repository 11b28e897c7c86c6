"""Base class of sources that receive messages, and the receiver that posts the hands in them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Sequence
from typing import Final, Literal, TypeAlias

from smooth_operator.errors import ConfigError, RecordingError, SmoothOperatorError
from smooth_operator.teleop.sources.inboxes import Inbox, Message
from smooth_operator.teleop.sources.live import Running, SourceHealth, ThreadedSource
from smooth_operator.teleop.sources.payload import Reading
from smooth_operator.types import Side

Hands: TypeAlias = Literal["right", "left", "both"]
"""Hands that a source uses."""

Reader: TypeAlias = Callable[[Message, float], Sequence[Reading]]
"""Function that reads the hands of a message, given its time of receipt by the loop's clock [s]."""

SILENCE_S: Final = 1.0
"""Time without a message after which a source waits for its tracker [s]."""
_MAX_REASON = 300
_APART_S = 1e-6
_POLL_S = 0.1  # longest time until a silent source notices a request to stop
_SIDES: Final[dict[str, tuple[Side, ...]]] = {
    "right": ("right",),
    "left": ("left",),
    "both": ("right", "left"),
}


def sides_of(hands: str) -> tuple[Side, ...]:
    """Converts ``right``, ``left`` or ``both`` to a tuple of sides; ConfigError if the text is none
    of these."""
    if hands not in _SIDES:
        raise ConfigError(f"side must be 'right', 'left' or 'both', not {hands!r}")
    return _SIDES[hands]


def only_side(hands: str) -> Side | None:
    """Converts ``right`` or ``left`` to a side; returns None for ``both``."""
    sides = sides_of(hands)
    return sides[0] if len(sides) == 1 else None


class StreamSource(ThreadedSource):
    """Base class of sources that receive messages. Subclasses open the inbox and read its messages.

    Attributes:
        side: hands to use.
    """

    side: Hands

    def __post_init__(self) -> None:
        sides_of(self.side)
        port = getattr(self, "port", None)
        if port is not None and not 0 <= port <= 65_535:
            raise ConfigError(f"port must be 0 to 65535, not {port}")

    @abstractmethod
    def connect(self) -> Inbox:
        """Opens the inbox.

        Raises:
            SourceError: it can't be opened.
            MissingExtraError: its library is not installed.
        """

    @abstractmethod
    def reader(self) -> Reader:
        """Returns a function that reads the messages of one run and may raise RecordingError."""

    @property
    def sides(self) -> Collection[Side]:
        """Sides of the hands in use."""
        return sides_of(self.side)

    @property
    def hint(self) -> str:
        """Advice to show before the first message arrives. It is empty, or begins with a comma or
        semicolon."""
        return ""

    @property
    def endpoint(self) -> str | None:
        """Address on which the source listens, with the actual port; None before the start."""
        inbox: Inbox | None = getattr(self, "_inbox", None)
        return None if inbox is None else inbox.address

    def open(self) -> None:
        """Opens the inbox, so that the caller receives the errors."""
        object.__setattr__(self, "_inbox", self.connect())

    def run(self, running: Running) -> None:
        """Receives messages until the source is stopped."""
        inbox: Inbox = getattr(self, "_inbox")  # noqa: B009  (set in open(), past the frozen fields)
        read = self.reader()
        try:
            receiver = MessageReceiver(running, inbox.address, self.sides, read, self.hint)
            while not running.stopping.is_set():
                messages = inbox.receive(_POLL_S)
                received = running.mailbox.clock()
                for number, message in enumerate(messages):
                    # Stamps of messages that came together must differ, or the loop takes the
                    # newest frame for a repeated one.
                    receiver.take(message, received + number * _APART_S)
                if not messages:
                    receiver.silent(inbox.problem)
        finally:
            inbox.close()


class MessageReceiver:
    """Reads messages and posts the hands in them.

    An unreadable message does not end the source: the health states the number of such messages and
    the last reason. The session number of a hand increases when its tracker sends a new
    ``session``, or when it starts or stops sending stamps. The mailbox detects jumps of the stamps,
    and the loop refuses stamps that repeat or go back a little.

    Args:
        running: the started source.
        where: address of the source, for the health.
        sides: sides of the hands in use.
        read: function that reads a message.
        hint: advice to show before the first message, for the health.
    """

    def __init__(
        self,
        running: Running,
        where: str,
        sides: Collection[Side],
        read: Reader,
        hint: str = "",
    ) -> None:
        self.messages = 0
        self.unreadable = 0
        self.refused = 0
        self._running = running
        self._where = where
        self._sides = frozenset(sides)
        self._read = read
        self._reason = ""
        self._refusal = ""
        self._accepted = 0
        self._other_side = 0
        self._last: float | None = None
        self._sessions: dict[Side, tuple[int, tuple[bool, str | None]]] = {}
        running.health = SourceHealth("waiting", f"listening on {where}{hint}")

    def take(self, message: Message, received: float) -> None:
        """Reads a message and posts its hands; ``received`` is a time on the loop's clock [s]."""
        if isinstance(message[0], RecordingError):
            self.refused += 1
            self._refusal = str(message[0])[:_MAX_REASON]
            self._running.health = SourceHealth(self._running.health.state, self._detail())
            self.silent()  # a refused connection does not end a silence
            return
        self.messages += 1
        self._last = received
        try:
            readings = self._read(message, received)
        except SmoothOperatorError as error:
            self.unreadable += 1
            self._reason = str(error)[:_MAX_REASON]
        else:
            for reading in readings:
                self._post(reading, received)
        self._running.health = SourceHealth(
            "running" if self._accepted else "waiting", self._detail()
        )

    def silent(self, problem: str = "") -> None:
        """Reports that no messages arrive, or the reason why none can arrive."""
        if problem:
            self._running.health = SourceHealth("waiting", problem)
            return
        if self._last is None:
            return
        silence = self._running.mailbox.clock() - self._last
        if silence > SILENCE_S:
            facts = [f"no message at {self._where} for {silence:.0f} s", *self._refusals()]
            self._running.health = SourceHealth("waiting", "; ".join(facts))

    def _post(self, reading: Reading, received: float) -> None:
        side = reading.frame.side
        if side not in self._sides:
            self._other_side += 1
            return
        start = (reading.frame.stamp is not None, reading.session)
        session, before = self._sessions.get(side, (0, start))
        session += start != before
        self._sessions[side] = session, start
        self._accepted += 1
        self._running.mailbox.post(reading.frame, received=received, session=session)

    def _detail(self) -> str:
        facts = self._refusals()
        if self.unreadable:
            facts.append(
                f"{self.unreadable} of {self.messages} messages could not be read: {self._reason}"
            )
        if self._other_side and not self._accepted:
            facts.append(
                f"{self._other_side} frames were of the other hand; this source accepts only "
                f"the {' and '.join(sorted(self._sides))}"
            )
        return "; ".join(facts) or f"receiving on {self._where}"

    def _refusals(self) -> list[str]:
        if not self.refused:
            return []
        return [f"connections closed: {self.refused}; {self._refusal}"]


class OneSender:
    """Accepts messages only from the first address that sends, until it has been silent for a
    second.

    An app may open a socket for each hand, so all programs at one address count as one sender.
    """

    def __init__(self) -> None:
        self._host: bytes | None = None
        self._last = 0.0

    def check(self, host: bytes, received: float) -> None:
        """Raises RecordingError for a message from another address; takes the time of receipt
        [s]."""
        if self._host not in (None, host) and received - self._last <= SILENCE_S:
            first = (self._host or b"").decode()
            raise RecordingError(
                f"{host.decode()} is also sending to this port, and is ignored while {first} is "
                "sending; stop one of them, or use a different port for each"
            )
        self._host, self._last = host, received
