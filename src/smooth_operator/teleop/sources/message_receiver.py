"""From messages to the mailbox: counts, sessions, health; the same for every stream."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any, Final, TypeAlias

from smooth_operator.errors import RecordingError, SmoothOperatorError
from smooth_operator.teleop.sources.live import Running, SourceHealth
from smooth_operator.teleop.sources.payload import Reading
from smooth_operator.types import Side

Message: TypeAlias = tuple[Any, ...]
"""A message as it came, in one part or several: bytes, or what its library makes of them. Or an
error alone, for a connection that the inbox has closed since it speaks another protocol."""
Reader: TypeAlias = Callable[[Message, float], Sequence[Reading]]
"""The hands of a message that came at a time by the loop's clock [s]."""

SILENCE_S: Final = 1.0
"""Without a message for so long, a source waits for its tracker again [s]."""

_MAX_REASON = 300


class MessageReceiver:
    """Reads messages and posts what is in them.

    A message that can't be read is counted, and the health has the last reason; it never ends
    the source. A hand's session goes up by one when its tracker was started again: it says a new
    ``session``, or it begins or ceases to stamp. The mailbox finds jumps of the stamps, and the
    loop refuses stamps that repeat or go back a little.

    Args:
        running: the started source.
        where: what it listens to, for the health.
        sides: the hands that are wanted.
        read: reads a message.
        hint: what to look at while nothing has come, for the health.
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
        self._trackers: dict[Side, _Tracker] = {}
        running.health = SourceHealth("waiting", f"listening on {where}{hint}")

    def take(self, message: Message, received: float) -> None:
        """Read a message and post its hands.

        Args:
            message: as it came.
            received: when, by the loop's clock [s].
        """
        if isinstance(message[0], RecordingError):
            self.refused += 1
            self._refusal = str(message[0])[:_MAX_REASON]
            self._running.health = SourceHealth(self._running.health.state, self._detail())
            self.silent()  # which such a connection does not end
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
        """Say so if no message has come for a while, or why none can come."""
        if problem:
            self._running.health = SourceHealth("waiting", problem)
            return
        if self._last is None:
            return
        silence = self._running.mailbox.clock() - self._last
        if silence > SILENCE_S:
            facts = [f"no message on {self._where} for {silence:.0f} s", *self._refusals()]
            self._running.health = SourceHealth("waiting", "; ".join(facts))

    def _post(self, reading: Reading, received: float) -> None:
        side = reading.frame.side
        if side not in self._sides:
            self._other_side += 1
            return
        tracker = self._trackers.setdefault(side, _Tracker())
        session = tracker.session_of(reading)
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
                f"{self._other_side} frames were of the other hand, this source takes the "
                f"{' and '.join(sorted(self._sides))}"
            )
        return "; ".join(facts) or f"receiving on {self._where}"

    def _refusals(self) -> list[str]:
        if not self.refused:
            return []
        return [f"connections closed: {self.refused}; {self._refusal}"]


class _Tracker:
    """What is known of the tracker of one hand."""

    def __init__(self) -> None:
        self._session = 0
        self._start: tuple[bool, str | None] | None = None

    def session_of(self, reading: Reading) -> int:
        start = (reading.stamped, reading.session)
        if self._start is not None and start != self._start:
            self._session += 1
        self._start = start
        return self._session


class OneSender:
    """The first address that sends is listened to, until it has been silent for a second.

    Programs at one address count as one sender: an app may open a socket for each hand.
    """

    def __init__(self) -> None:
        self._host: bytes | None = None
        self._last = 0.0

    def check(self, host: bytes, received: float) -> None:
        """Take note of a message.

        Args:
            host: the address that it came from.
            received: when it came [s].

        Raises:
            RecordingError: it is from another address than the one that is listened to.
        """
        if self._host not in (None, host) and received - self._last <= SILENCE_S:
            heard = (self._host or b"").decode()
            raise RecordingError(
                f"{host.decode()} sends too, and is not used while {heard} does; stop one of "
                "them, or give each a port of its own"
            )
        self._host, self._last = host, received
