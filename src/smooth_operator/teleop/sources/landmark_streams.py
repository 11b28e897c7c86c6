"""Landmarks from other programs over UDP or ZeroMQ: ``udp:PORT``, ``zmq:ADDRESS``."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from smooth_operator.io.anatomy import layout_order
from smooth_operator.teleop.sources.inboxes import Inbox, Message, Pattern, UdpInbox, ZmqInbox
from smooth_operator.teleop.sources.payload import (
    Forms,
    MatrixOrder,
    PayloadReader,
    QuaternionOrder,
    StampUnit,
)
from smooth_operator.teleop.sources.stream import (
    Hands,
    Reader,
    StreamSource,
    check_port,
    only_side,
    sides_of,
)


@dataclass(frozen=True)
class LandmarkStream(StreamSource):
    """Source with one hand per message, in the forms of ``smooth_operator.teleop.sources.payload``.

    Attributes:
        side: side of messages without one, and the only one in use; with ``both`` each message
            must have its side.
        layout: order of the landmarks in a message of 21, by its name in ``LAYOUTS``.
        stamp_unit: unit of the stamps in JSON.
        quaternion: order of the quaternion in rows of 7.
        matrix: order of 4 x 4 matrices: row by row or column by column; ``auto`` decides by the
            place of 0 0 0 1.

    Raises:
        ConfigError: a setting is outside its range.
        UnknownNameError: there is no such layout.
    """

    _: KW_ONLY
    side: Hands = "right"
    layout: str = "mediapipe"
    stamp_unit: StampUnit = "s"
    quaternion: QuaternionOrder = "wxyz"
    matrix: MatrixOrder = "auto"

    def __post_init__(self) -> None:
        sides_of(self.side)
        layout_order(self.layout)

    def data_of(self, message: Message) -> bytes:
        """The bytes of a message that hold the hand: its first part."""
        data: bytes = message[0]
        return data

    def reader(self) -> Reader:
        """See ``StreamSource``."""
        forms = Forms(self.layout, self.stamp_unit, self.quaternion, self.matrix)
        payload = PayloadReader(only_side(self.side), forms)
        return lambda message, received: payload.read(self.data_of(message), received)


@dataclass(frozen=True)
class UdpSource(LandmarkStream):
    """Source with one hand per datagram; see ``LandmarkStream``.

    Everybody who can send to the port moves the hand, since UDP has no passwords. By default the
    source therefore listens on this machine only.

    Attributes:
        port: port to listen on; 0 for any free one, see ``endpoint``.
        host: address to listen on; ``0.0.0.0`` for the whole network.
    """

    port: int = 5005
    host: str = "127.0.0.1"

    def __post_init__(self) -> None:
        check_port(self.port)
        super().__post_init__()

    @property
    def label(self) -> str:
        """The source in a few words."""
        return f"UDP port {self.port}"

    def connect(self) -> Inbox:
        """Takes the port."""
        return UdpInbox(self.host, self.port)


@dataclass(frozen=True)
class ZmqSource(LandmarkStream):
    """Source with one hand per ZeroMQ message; see ``LandmarkStream``.

    A message may begin with a topic, as a separate part or as the text ``topic``.

    Attributes:
        address: address of the publisher, which may start later.
        bind: listen on the address, for publishers that connect.
        topic: use only messages that start with this text.
        pattern: ``sub`` for a publisher, ``pull`` for a pusher.
    """

    address: str = "tcp://127.0.0.1:5557"
    bind: bool = False
    topic: str = ""
    pattern: Pattern = "sub"

    @property
    def label(self) -> str:
        """The source in a few words."""
        return f"ZeroMQ {self.address}"

    def connect(self) -> Inbox:
        """Opens the socket."""
        return ZmqInbox(
            "the source 'zmq'", self.address, bind=self.bind, pattern=self.pattern, topic=self.topic
        )

    def data_of(self, message: Message) -> bytes:
        """The last part, without a topic that is not a part."""
        data: bytes = message[-1]
        if len(message) == 1 and self.topic:
            data = data.removeprefix(self.topic.encode()).lstrip(b" ")
        return data
