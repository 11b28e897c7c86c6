"""MANUS gloves through a ZeroMQ bridge: ``manus:tcp://127.0.0.1:8000`` (extra ``zmq``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.sources.manus.manus_message import read_manus
from smooth_operator.teleop.sources.message_receiver import Message
from smooth_operator.teleop.sources.payload import Reading
from smooth_operator.teleop.sources.stream import Hands, StreamSource, only_side, sides_of
from smooth_operator.teleop.sources.zmq_inbox import Pattern, ZmqInbox
from smooth_operator.types import Side


@dataclass(frozen=True)
class ManusStream(StreamSource):
    """Each message a hand or two, as ``smooth_operator.teleop.sources.manus.manus_message`` says.

    Attributes:
        address: of the bridge; it need not be running yet.
        side: the hands that are taken. With one hand alone, messages that do not say which hand
            they are of are taken for it.
        right_glove: id of the right glove, for a bridge that does not say which hand is which.
        left_glove: id of the left glove.
        pattern: ``sub`` for bridges that publish, ``pull`` for those that push (Bidex).
        bind: listen on the address, for a bridge that connects.

    Raises:
        ConfigError: a setting is outside its range.
    """

    address: str = "tcp://127.0.0.1:8000"
    side: Hands = "both"
    right_glove: str | None = None
    left_glove: str | None = None
    pattern: Pattern = "sub"
    bind: bool = False

    def __post_init__(self) -> None:
        sides_of(self.side)
        if self.right_glove is not None and self.right_glove == self.left_glove:
            raise ConfigError(f"right_glove and left_glove are both {self.right_glove!r}")

    @property
    def label(self) -> str:
        """What it is, in a few words."""
        return f"MANUS gloves at {self.address}"

    @property
    def sides(self) -> tuple[Side, ...]:
        """The hands that it takes."""
        return sides_of(self.side)

    @property
    def gloves(self) -> dict[str, Side]:
        """Glove id -> side, where known."""
        named: dict[str, Side] = {}
        if self.right_glove is not None:
            named[self.right_glove.lower()] = "right"
        if self.left_glove is not None:
            named[self.left_glove.lower()] = "left"
        return named

    def connect(self) -> ZmqInbox:
        """Open the socket."""
        return ZmqInbox("the source 'manus'", self.address, bind=self.bind, pattern=self.pattern)

    def read(self, message: Message, received: float) -> Sequence[Reading]:
        """The hands of a message."""
        return read_manus(
            b" ".join(message), gloves=self.gloves, side=only_side(self.side), received=received
        )
