"""Messages over TCP from programs that connect, such as an app on a headset.

A web page may connect to any port of its user's computer and send what it likes after the header of
an HTTP request, so a connection whose first bytes are not of the protocol is closed.
"""

from __future__ import annotations

import contextlib
import select
import socket
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, Protocol, TypeAlias

from smooth_operator.errors import RecordingError, SourceError, brief
from smooth_operator.teleop.sources.message_receiver import Message
from smooth_operator.teleop.sources.payload import MAX_BYTES
from smooth_operator.web.listening import listen

Split: TypeAlias = Callable[[bytearray], Sequence[bytes]]
"""Takes whole messages from the front of a buffer, which keeps the rest."""
Begins: TypeAlias = Callable[[bytearray], bool]
"""Whether what has come on a connection so far can be the begin of its first message."""

_CONNECTIONS: Final = 8  # at a time; beyond, the one that has been silent for the longest is closed
_CHUNK: Final = 65_536
_AT_ONCE: Final = 64  # reads of one connection in one go, so that a flood can't hold the others up
KEPT: Final = 16
"""Messages that are read when more have come together: both hands of a few frames, in parts."""


class Sockets(Protocol):
    """An inbox whose sockets can be waited for together with others."""

    @property
    def address(self) -> str:
        """See ``Inbox``."""

    def sockets(self) -> list[socket.socket]:
        """What ``receive`` waits for."""

    def receive(self, timeout: float) -> Sequence[Message]:
        """See ``Inbox``."""

    def close(self) -> None:
        """See ``Inbox``."""


class TcpInbox:
    """A listening socket and the connections to it.

    A message is its bytes, the address that it came from, and the number of the connection; or, for
    a connection that was closed since it speaks another protocol, the error that says so.

    Args:
        host: address to listen on.
        port: to listen on; 0 for any free one.
        split: takes messages out of what came.
        begins: tells the protocol from others by the first bytes of a connection, however few.
        source: the word of the source, for messages.

    Raises:
        SourceError: the port is taken, or the address is not of this machine.
    """

    def __init__(self, host: str, port: int, split: Split, begins: Begins, source: str) -> None:
        self._split, self._begins = split, begins
        self._clients: dict[socket.socket, _Client] = {}
        self._opened = 0
        self._listening = listening = _listen(host, port, source)
        name, bound = listening.getsockname()[:2]
        self.address = f"tcp://{name}:{bound}"

    def sockets(self) -> list[socket.socket]:
        """What ``receive`` waits for."""
        return [self._listening, *self._clients]

    def receive(self, timeout: float) -> list[Message]:
        """See ``Inbox``."""
        ready = select.select(self.sockets(), [], [], timeout)[0]
        newest: deque[Message] = deque(maxlen=KEPT)
        refusals: list[Message] = []
        if self._listening in ready:
            self._accept()
        for connection in ready:
            client = self._clients.get(connection)
            if client is not None:
                try:
                    newest.extend(self._read(connection, client))
                except RecordingError as error:
                    self._drop(connection)
                    refusals.append((error,))
        return [*refusals, *newest]

    def close(self) -> None:
        """Close all connections and give the port back."""
        for connection in list(self._clients):
            self._drop(connection)
        self._listening.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # it is gone already
            connection, where = self._listening.accept()
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            self._opened += 1
            self._clients[connection] = _Client(str(where[0]), self._opened)
        if len(self._clients) > _CONNECTIONS:
            # A headset that slept leaves connections that never end.
            self._drop(next(iter(self._clients)))

    def _read(self, connection: socket.socket, client: _Client) -> list[Message]:
        messages: list[Message] = []
        # The order in the table is that of the last word, for the one to close.
        self._clients[connection] = self._clients.pop(connection)
        for _ in range(_AT_ONCE):
            try:
                chunk = connection.recv(_CHUNK)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                chunk = b""
            if not chunk:
                self._drop(connection)
                break
            client.buffer += chunk
            if client.new and not self._begins(client.buffer):
                raise RecordingError(
                    f"a web page or another program at {client.mark[0].decode()} connected to this "
                    f"port, closed: {brief(bytes(client.buffer[:24]))} begins no message of this "
                    "source"
                )
            messages += [(data, *client.mark) for data in self._split(client.buffer)]
            client.new = client.new and not messages
            if len(client.buffer) > MAX_BYTES:
                # No message ends: it is another protocol. What has come is refused where it is
                # read, with its first bytes.
                messages.append((bytes(client.buffer[: MAX_BYTES + 1]), *client.mark))
                self._drop(connection)
                break
        return messages

    def _drop(self, connection: socket.socket) -> None:
        self._clients.pop(connection, None)
        connection.close()


class _Client:
    """A connection: where it is from, its next message so far, and whether that is the first."""

    def __init__(self, host: str, number: int) -> None:
        self.mark = (host.encode(), str(number).encode())
        self.buffer = bytearray()
        self.new = True


class Together:
    """Several inboxes as one."""

    def __init__(self, inboxes: Sequence[Sockets]) -> None:
        self._inboxes = inboxes
        self.address = " and ".join(inbox.address for inbox in inboxes)

    def receive(self, timeout: float) -> list[Message]:
        """See ``Inbox``."""
        waited = [one for inbox in self._inboxes for one in inbox.sockets()]
        if not select.select(waited, [], [], timeout)[0]:
            return []
        return [message for inbox in self._inboxes for message in inbox.receive(0.0)]

    def close(self) -> None:
        """Close them all."""
        for inbox in self._inboxes:
            inbox.close()


def split_lines(buffer: bytearray) -> list[bytes]:
    """Whole lines, without empty ones."""
    end = buffer.rfind(b"\n") + 1
    lines = bytes(buffer[:end]).split(b"\n")
    del buffer[:end]
    return [line for line in lines if line.strip()]


def _listen(host: str, port: int, source: str) -> socket.socket:
    try:
        listening = listen(host, port)
    except OSError as error:
        raise SourceError(
            f"TCP port {port} on {host} can't be listened on ({error}); is another program using "
            f"it? Choose another: {source}:port=PORT"
        ) from error
    listening.setblocking(False)
    return listening
