"""Landmarks over ZeroMQ: ``zmq:tcp://127.0.0.1:5557`` (extra ``zmq``)."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from smooth_operator.errors import MissingExtraError, SourceError
from smooth_operator.io.anatomy import layout_order
from smooth_operator.teleop.sources.message_receiver import Message
from smooth_operator.teleop.sources.payload import (
    Forms,
    MatrixOrder,
    PayloadReader,
    QuaternionOrder,
    Reading,
    StampUnit,
)
from smooth_operator.teleop.sources.stream import KEPT, Hands, StreamSource, only_side, sides_of


@dataclass(frozen=True)
class ZmqSource(StreamSource):
    """Each message a hand, as ``smooth_operator.teleop.sources.payload`` says.

    A message may have a topic before it, as a separate part or as the words that ``topic`` gives.

    Attributes:
        address: address of the publisher; it need not be there yet.
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


Pattern: TypeAlias = Literal["sub", "pull"]
"""The socket: ``sub`` for publishers (PUB), ``pull`` for those that push (PUSH)."""

# What is not read for a while piles up to here; beyond, the sender's messages are dropped. Fewer
# would be worse: the rest then waits, older and older, in the network's own buffers.
_QUEUE: Final = 256
_LARGEST: Final = 1 << 17  # a sender of more is disconnected before it fills the memory [bytes]
_RECONNECT_MS: Final = (50, 500)  # first and longest wait for a publisher that is not there
_AT_ONCE: Final = 10_000


class ZmqInbox:
    """An open ZeroMQ socket with its own context.

    Connecting needs no publisher: it may start later, and start again.

    Args:
        feature: what needs it, for the message where pyzmq is missing.
        address: such as ``tcp://127.0.0.1:5557``; ``tcp://127.0.0.1:*`` binds any free port.
        bind: listen there, in place of connecting.
        pattern: kind of socket.
        topic: what messages start with, for ``sub``.

    Raises:
        MissingExtraError: pyzmq is not installed.
        SourceError: the address can't be used.
    """

    def __init__(
        self,
        feature: str,
        address: str,
        *,
        bind: bool = False,
        pattern: Pattern = "sub",
        topic: str = "",
    ) -> None:
        self._zmq = zmq = load_zmq(feature)
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB if pattern == "sub" else zmq.PULL)
        try:
            self._set_up(pattern, topic)
            (self._socket.bind if bind else self._socket.connect)(address)
        except zmq.ZMQError as error:
            self.close()
            raise SourceError(
                f"ZeroMQ can't {'listen on' if bind else 'connect to'} {address!r} ({error}); an "
                "address looks like tcp://127.0.0.1:5557"
            ) from error
        endpoint = self._socket.getsockopt(zmq.LAST_ENDPOINT).rstrip(b"\0").decode()
        self.address = endpoint if bind and endpoint else address

    def _set_up(self, pattern: Pattern, topic: str) -> None:
        zmq = self._zmq
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.RCVHWM, _QUEUE)
        self._socket.setsockopt(zmq.MAXMSGSIZE, _LARGEST)
        self._socket.setsockopt(zmq.RECONNECT_IVL, _RECONNECT_MS[0])
        self._socket.setsockopt(zmq.RECONNECT_IVL_MAX, _RECONNECT_MS[1])
        # Without this a publisher whose machine or cable died is waited for in vain.
        self._socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
        if pattern == "sub":
            self._socket.setsockopt_string(zmq.SUBSCRIBE, topic)

    def receive(self, timeout: float) -> list[Message]:
        """See ``Inbox``."""
        zmq = self._zmq
        newest: deque[Message] = deque(maxlen=KEPT)
        try:
            if not self._socket.poll(round(timeout * 1e3), zmq.POLLIN):
                return []
            for _ in range(_AT_ONCE):
                newest.append(tuple(self._socket.recv_multipart(zmq.NOBLOCK)))
        except zmq.Again:
            pass
        except zmq.ZMQError as error:
            raise SourceError(f"{self.address} can't be received from: {error}") from error
        return list(newest)

    def close(self) -> None:
        """Close the socket without waiting."""
        self._socket.close(linger=0)
        self._context.term()


def load_zmq(feature: str) -> Any:
    """The module ``zmq``.

    Raises:
        MissingExtraError: pyzmq is not installed.
    """
    try:
        import zmq
    except ImportError as error:
        raise MissingExtraError(feature, "zmq") from error
    return zmq
