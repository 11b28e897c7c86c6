"""Landmarks over UDP: ``udp:PORT``."""

from __future__ import annotations

import select
import socket
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from smooth_operator.errors import SourceError
from smooth_operator.io.anatomy import layout_order
from smooth_operator.teleop.sources.message_receiver import Message
from smooth_operator.teleop.sources.payload import (
    MAX_BYTES,
    Forms,
    MatrixOrder,
    PayloadReader,
    QuaternionOrder,
    Reading,
    StampUnit,
)
from smooth_operator.teleop.sources.stream import (
    KEPT,
    Hands,
    StreamSource,
    check_port,
    only_side,
    sides_of,
)

_AT_ONCE = 10_000  # datagrams emptied in one go, so that a flood can't keep it from stopping


@dataclass(frozen=True)
class UdpSource(StreamSource):
    """Each datagram a hand, as ``smooth_operator.teleop.sources.payload`` says.

    Whoever can send to the port moves the hand; UDP knows no passwords. So it listens on this
    machine alone by default.

    Attributes:
        port: to listen on; 0 for any free one, see ``endpoint``.
        host: address to listen on; ``0.0.0.0`` for the whole network.
        side: the hand of a datagram that does not say, and the only one that is taken; with
            ``both`` each datagram must say.
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

    port: int = 5005
    host: str = "127.0.0.1"
    side: Hands = "right"
    layout: str = "mediapipe"
    stamp_unit: StampUnit = "s"
    quaternion: QuaternionOrder = "wxyz"
    matrix: MatrixOrder = "auto"

    def __post_init__(self) -> None:
        check_port(self.port)
        sides_of(self.side)
        layout_order(self.layout)

    @property
    def label(self) -> str:
        """What it is, in a few words."""
        return f"UDP port {self.port}"

    def connect(self) -> UdpInbox:
        """Take the port."""
        object.__setattr__(self, "_reader", self._new_reader())
        return UdpInbox(self.host, self.port)

    def read(self, message: Message, received: float) -> Sequence[Reading]:
        """The hands of a datagram."""
        reader: PayloadReader | None = getattr(self, "_reader", None)
        return (reader or self._new_reader()).read(message[0], received)

    def _new_reader(self) -> PayloadReader:
        forms = Forms(self.layout, self.stamp_unit, self.quaternion, self.matrix)
        return PayloadReader(only_side(self.side), forms)


class UdpInbox:
    """A bound UDP socket. A message is its bytes and the address that it came from.

    Args:
        host: address to listen on.
        port: to listen on; 0 for any free one.
        choose: how to name another port, for messages.

    Raises:
        SourceError: the port is taken, or the address is not of this machine.
    """

    def __init__(self, host: str, port: int, choose: str = "udp:PORT") -> None:
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(
                host, port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE
            )[0]
            self._socket = socket.socket(family, kind, protocol)
        except OSError as error:
            raise SourceError(f"UDP address {host!r} can't be used: {error}") from error
        try:
            self._socket.bind(where)
        except OSError as error:
            self._socket.close()
            raise SourceError(
                f"UDP port {port} on {host} can't be listened on ({error}); is another program "
                f"using it? Choose another: {choose}"
            ) from error
        self._socket.setblocking(False)
        name, bound = self._socket.getsockname()[:2]
        self.address = f"udp://{name}:{bound}"

    def sockets(self) -> list[socket.socket]:
        """What ``receive`` waits for."""
        return [self._socket]

    def receive(self, timeout: float) -> list[Message]:
        """See ``Inbox``."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return []
        newest: deque[Message] = deque(maxlen=KEPT)
        for _ in range(_AT_ONCE):
            try:
                # One byte more than is read, so that what is cut off is seen to be too long.
                data, where = self._socket.recvfrom(MAX_BYTES + 1)
                newest.append((data, str(where[0]).encode()))
            except (BlockingIOError, InterruptedError):
                break
            except ConnectionError:  # Windows: an earlier peer is gone, which is nothing to us
                continue
            except OSError as error:
                raise SourceError(f"{self.address} can't be received from: {error}") from error
        return list(newest)

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()
