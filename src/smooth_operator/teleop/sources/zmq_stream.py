"""Landmarks over ZeroMQ: ``zmq:tcp://127.0.0.1:5557`` (extra ``zmq``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from smooth_operator.io.anatomy import layout_order
from smooth_operator.teleop.sources.message_receiver import Message
from smooth_operator.teleop.sources.message_stamps import StampUnit
from smooth_operator.teleop.sources.payload import Forms, PayloadReader, Reading
from smooth_operator.teleop.sources.point_forms import MatrixOrder, QuaternionOrder
from smooth_operator.teleop.sources.stream import Hands, StreamSource, only_side, sides_of
from smooth_operator.teleop.sources.zmq_inbox import Pattern, ZmqInbox
from smooth_operator.types import Side


@dataclass(frozen=True)
class ZmqSource(StreamSource):
    """Each message a hand, as ``smooth_operator.teleop.sources.payload`` says.

    A message may have a topic before it, as a separate part or as the words that ``topic`` gives.

    Attributes:
        address: of the publisher; it need not be there yet.
        side: the hand of a message that does not say, and the only one that is taken; with
            ``both`` each message must say.
        bind: listen on the address, for publishers that connect.
        topic: take messages that start with this only.
        pattern: ``sub`` for a publisher, ``pull`` for a pusher.
        layout: order of the landmarks in a message of 21, by its name in
            ``LAYOUTS``.
        stamp_unit: unit of the stamps in JSON.
        quaternion: order of the quaternion in rows of 7.
        matrix: how 4 x 4 matrices are written: row by row or column by column; ``auto`` decides
            by where 0 0 0 1 stands.

    Raises:
        ConfigError: a setting is outside its range.
        UnknownNameError: there is no such layout.
    """

    address: str = "tcp://127.0.0.1:5557"
    side: Hands = "right"
    bind: bool = False
    topic: str = ""
    pattern: Pattern = "sub"
    layout: str = "mediapipe"
    stamp_unit: StampUnit = "s"
    quaternion: QuaternionOrder = "wxyz"
    matrix: MatrixOrder = "auto"

    def __post_init__(self) -> None:
        sides_of(self.side)
        layout_order(self.layout)

    @property
    def label(self) -> str:
        """What it is, in a few words."""
        return f"ZeroMQ {self.address}"

    @property
    def sides(self) -> tuple[Side, ...]:
        """The hands that it takes."""
        return sides_of(self.side)

    def connect(self) -> ZmqInbox:
        """Open the socket."""
        object.__setattr__(self, "_reader", self._new_reader())
        return ZmqInbox(
            "the source 'zmq'",
            self.address,
            bind=self.bind,
            pattern=self.pattern,
            topic=self.topic,
        )

    def read(self, message: Message, received: float) -> Sequence[Reading]:
        """The hands of a message; of several parts the last."""
        data = message[-1]
        if len(message) == 1 and self.topic:
            data = data.removeprefix(self.topic.encode()).lstrip(b" ")
        reader: PayloadReader | None = getattr(self, "_reader", None)
        return (reader or self._new_reader()).read(data, received)

    def _new_reader(self) -> PayloadReader:
        forms = Forms(self.layout, self.stamp_unit, self.quaternion, self.matrix)
        return PayloadReader(only_side(self.side), forms)
