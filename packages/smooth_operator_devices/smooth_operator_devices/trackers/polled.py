"""Base of the sources that ask a library for poses at a rate of their own."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from smooth_operator.errors import ConfigError
from smooth_operator.headsets.repeats import Repeats
from smooth_operator.teleop.sources.inboxes import Inbox, Message
from smooth_operator.teleop.sources.payload import Reading
from smooth_operator.teleop.sources.stream import Hands, Reader, StreamSource
from smooth_operator.types import HandFrame


@dataclass(frozen=True)
class PolledSource(StreamSource):
    """Base of the sources ``openxr`` and ``isaac``: asks for both hands many times per second.

    A frame that repeats the last one in every bit is not posted.

    Attributes:
        rate: number of times per second that the library is asked [Hz].
        side: hands to use.

    Raises:
        ConfigError: a setting is outside its range.
    """

    rate: float = 90.0
    side: Hands = "both"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1.0 <= self.rate <= 1000.0:
            raise ConfigError(f"rate must be 1 to 1000 Hz, not {self.rate:g}")

    @abstractmethod
    def frame(self, message: Message) -> HandFrame:
        """Hand of a message of the inbox, without a stamp."""

    def reader(self) -> Reader:
        """Reads the hand of a message."""
        repeats = Repeats()

        def read(message: Message, received: float) -> Sequence[Reading]:
            frame = self.frame(message)
            return () if repeats.new(frame) is None else (Reading(frame),)

        return read


class PolledInbox(Inbox):
    """Base of the inboxes that ask a library.

    Args:
        rate: number of times per second that ``ask`` is called [Hz].
    """

    def __init__(self, rate: float) -> None:
        self._period, self._next = 1.0 / rate, 0.0

    @abstractmethod
    def ask(self) -> list[Message]:
        """Messages of the hands that are tracked now.

        Raises:
            SourceError: the library failed.
        """

    def receive(self, timeout: float) -> list[Message]:
        """Waits for the next time to ask, and asks; see ``Inbox``."""
        now = time.monotonic()
        self._next = max(self._next + self._period, now)
        time.sleep(min(timeout, self._next - now))
        return self.ask()
