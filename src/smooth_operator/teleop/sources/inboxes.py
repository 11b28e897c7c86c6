"""Inboxes: sockets on which sources receive messages by UDP, TCP, ZeroMQ or gRPC.

A web page can send any data, after an HTTP header, to any port of its user's computer. Therefore an
inbox closes a TCP connection whose first bytes do not belong to the protocol.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, TypeAlias

from smooth_operator.errors import MissingExtraError, RecordingError, SourceError, brief
from smooth_operator.teleop.sources.payload import MAX_BYTES
from smooth_operator.web.listening import listen

Message: TypeAlias = tuple[Any, ...]
"""A received message in one or several parts, each of them bytes or an object of the library. For a
connection that the inbox closed because it spoke another protocol, a single error instead."""

NEWEST: Final = 8
"""Number of messages to read, the newest ones, if many arrive together. It is enough for the newest
frame of each of two hands, even with broken messages between them."""

_AT_ONCE: Final = 10_000
"""Largest number of messages in one call of ``receive``, so that a flood can't stop a source from
ending."""


class Inbox(ABC):
    """An open socket on which messages arrive. A constructor raises SourceError for an address that
    it can't use, and MissingExtraError if its library is not installed.

    Attributes:
        address: address on which it listens or to which it is connected, with the actual port if
            port 0 was requested.
        problem: reason why no message can arrive; empty without a problem.
    """

    address: str
    problem = ""

    def sockets(self) -> list[socket.socket]:
        """Sockets on which ``receive`` waits, if ``select`` can wait for them."""
        return []

    @abstractmethod
    def receive(self, timeout: float) -> list[Message]:
        """Waits up to ``timeout`` [s], and returns the newest messages in order; SourceError if the
        socket has failed."""

    @abstractmethod
    def close(self) -> None:
        """Closes the socket."""


class UdpInbox(Inbox):
    """A bound UDP socket. Each message is returned with the address of its sender.

    Args:
        host: address to listen on.
        port: port to listen on; 0 for any free one.
        choose: text for error messages that says how to choose another port.
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
                f"can't listen on UDP port {port} on {host} ({error}); is another program "
                f"using it? Choose another: {choose}"
            ) from error
        self._socket.setblocking(False)
        name, bound = self._socket.getsockname()[:2]
        self.address = f"udp://{name}:{bound}"

    def sockets(self) -> list[socket.socket]:
        """The socket."""
        return [self._socket]

    def receive(self, timeout: float) -> list[Message]:
        """Returns the newest messages; see ``Inbox``."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return []
        newest: deque[Message] = deque(maxlen=NEWEST)
        for _ in range(_AT_ONCE):
            try:
                # One byte more than the limit, so that a message that was cut off is refused.
                data, where = self._socket.recvfrom(MAX_BYTES + 1)
                newest.append((data, str(where[0]).encode()))
            except (BlockingIOError, InterruptedError):
                break
            except ConnectionError:  # Windows reports that an earlier peer is gone
                continue
            except OSError as error:
                raise SourceError(f"{self.address} can't be read: {error}") from error
        return list(newest)

    def close(self) -> None:
        """Closes the socket, which frees the port."""
        self._socket.close()


Split: TypeAlias = Callable[[bytearray], Sequence[bytes]]
"""Function that removes complete messages from the front of a buffer and returns them."""
Begins: TypeAlias = Callable[[bytearray], bool]
"""Function that returns True if the data received so far can be the start of a first message."""

_CONNECTIONS: Final = 8
"""Largest number of connections. When another one arrives, an old connection without a message is
closed, or else the one that has been silent for the longest time."""
_CHUNK: Final = 65_536
_READS: Final = 64  # reads of one connection in one go, so that a flood can't delay the others
_NEWEST_PARTS: Final = 16
"""Number of messages to read, the newest ones, if many arrive together: a few frames per hand."""


class TcpInbox(Inbox):
    """A listening TCP socket and the connections to it.

    A message consists of its bytes, the address of its sender, and the number of the connection.
    For a connection that was closed because it spoke another protocol, the message is the error.

    Args:
        host: address to listen on.
        port: port to listen on; 0 for any free one.
        split: splits received data into messages.
        begins: recognises the protocol by the first bytes of a connection.
        source: name of the source, for messages.
    """

    def __init__(self, host: str, port: int, split: Split, begins: Begins, source: str) -> None:
        self._split, self._begins = split, begins
        self._clients: dict[socket.socket, _Client] = {}
        self._opened = 0
        try:
            self._listening = listening = listen(host, port)
        except OSError as error:
            raise SourceError(
                f"can't listen on TCP port {port} on {host} ({error}); is another program "
                f"using it? Choose another: {source}:port=PORT"
            ) from error
        listening.setblocking(False)
        name, bound = listening.getsockname()[:2]
        self.address = f"tcp://{name}:{bound}"

    def sockets(self) -> list[socket.socket]:
        """The listening socket and the connections."""
        return [self._listening, *self._clients]

    def receive(self, timeout: float) -> list[Message]:
        """Returns the newest messages; see ``Inbox``."""
        ready = select.select(self.sockets(), [], [], timeout)[0]
        newest: deque[Message] = deque(maxlen=_NEWEST_PARTS)
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
        """Closes all connections and the port."""
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
            # A headset that slept leaves connections that never end. In a flood, those without a
            # message are closed first, except the one that has just come.
            *earlier, _ = self._clients
            silent = (one for one in earlier if self._clients[one].new)
            self._drop(next(silent, earlier[0]))

    def _read(self, connection: socket.socket, client: _Client) -> list[Message]:
        messages: list[Message] = []
        # The table has the order of the last messages, for the choice of the one to close.
        self._clients[connection] = self._clients.pop(connection)
        for _ in range(_READS):
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
                    f"a web page or another program at {client.mark[0].decode()} connected to "
                    "this port, and its connection was closed: "
                    f"{brief(bytes(client.buffer[:24]))} is not how a message of this source "
                    "starts"
                )
            messages += [(data, *client.mark) for data in self._split(client.buffer)]
            client.new = client.new and not messages
            if len(client.buffer) > MAX_BYTES:
                # No message ends, so it is another protocol. The reader refuses this data and
                # reports its first bytes.
                messages.append((bytes(client.buffer[: MAX_BYTES + 1]), *client.mark))
                self._drop(connection)
                break
        return messages

    def _drop(self, connection: socket.socket) -> None:
        self._clients.pop(connection, None)
        connection.close()


class _Client:
    """A TCP connection and the data of its next message."""

    def __init__(self, host: str, number: int) -> None:
        self.mark = (host.encode(), str(number).encode())
        self.buffer = bytearray()
        self.new = True


class Together(Inbox):
    """Several inboxes with sockets, used as if they were one."""

    def __init__(self, inboxes: Sequence[Inbox]) -> None:
        self._inboxes = inboxes
        self.address = " and ".join(inbox.address for inbox in inboxes)

    def receive(self, timeout: float) -> list[Message]:
        """Returns the newest messages; see ``Inbox``."""
        waited = [one for inbox in self._inboxes for one in inbox.sockets()]
        if not select.select(waited, [], [], timeout)[0]:
            return []
        return [message for inbox in self._inboxes for message in inbox.receive(0.0)]

    def close(self) -> None:
        """Closes all inboxes."""
        for inbox in self._inboxes:
            inbox.close()


def split_lines(buffer: bytearray) -> list[bytes]:
    """Removes complete lines from the front of a buffer. Returns those that are not empty."""
    end = buffer.rfind(b"\n") + 1
    lines = bytes(buffer[:end]).split(b"\n")
    del buffer[:end]
    return [line for line in lines if line.strip()]


Pattern: TypeAlias = Literal["sub", "pull"]
"""Kind of ZeroMQ socket: ``sub`` for publishers (PUB), ``pull`` for senders that push (PUSH)."""

# Length of the queue. With a shorter one, messages would get old in the buffers of the network.
_QUEUE: Final = 256
_LARGEST: Final = 1 << 17  # longest message; the sender of a longer one is disconnected [bytes]
_RECONNECT_MS: Final = (50, 500)  # first and longest wait for a missing publisher


class ZmqInbox(Inbox):
    """An open ZeroMQ socket with its own context. A publisher may start later, or restart.

    Args:
        feature: what needs pyzmq, for the error message if it is missing.
        address: address such as ``tcp://127.0.0.1:5557``; ``tcp://127.0.0.1:*`` binds any free
            port.
        bind: True to listen at the address, False to connect to it.
        pattern: kind of socket.
        topic: first bytes of the messages, for ``sub``.
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
        try:
            import zmq
        except ImportError as error:
            raise MissingExtraError(feature, "zmq") from error
        self._zmq: Any = zmq
        self._context = zmq.Context()
        self._socket: Any = self._context.socket(zmq.SUB if pattern == "sub" else zmq.PULL)
        try:
            self._socket.setsockopt(zmq.LINGER, 0)
            self._socket.setsockopt(zmq.RCVHWM, _QUEUE)
            self._socket.setsockopt(zmq.MAXMSGSIZE, _LARGEST)
            self._socket.setsockopt(zmq.RECONNECT_IVL, _RECONNECT_MS[0])
            self._socket.setsockopt(zmq.RECONNECT_IVL_MAX, _RECONNECT_MS[1])
            # Without it, the socket would wait forever after a failure of the publisher's machine.
            self._socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
            if pattern == "sub":
                self._socket.setsockopt_string(zmq.SUBSCRIBE, topic)
            (self._socket.bind if bind else self._socket.connect)(address)
        except zmq.ZMQError as error:
            self.close()
            raise SourceError(
                f"ZeroMQ can't {'listen on' if bind else 'connect to'} {address!r} ({error}); an "
                "address looks like tcp://127.0.0.1:5557"
            ) from error
        endpoint: Any = self._socket.getsockopt(zmq.LAST_ENDPOINT)
        bound = endpoint.rstrip(b"\0").decode()
        self.address = bound if bind and bound else address

    def receive(self, timeout: float) -> list[Message]:
        """Returns the newest messages; see ``Inbox``."""
        zmq = self._zmq
        newest: deque[Message] = deque(maxlen=NEWEST)
        try:
            if not self._socket.poll(round(timeout * 1e3), zmq.POLLIN):
                return []
            for _ in range(_AT_ONCE):
                newest.append(tuple(self._socket.recv_multipart(zmq.NOBLOCK)))
        except zmq.Again:
            pass
        except zmq.ZMQError as error:
            raise SourceError(f"{self.address} can't be read: {error}") from error
        return list(newest)

    def close(self) -> None:
        """Closes the socket without waiting."""
        self._socket.close(linger=0)
        self._context.term()


_RETRY_S: Final = (0.2, 2.0)  # first and longest wait before another try
_SILENT_S: Final = 3.0  # silence after which the inbox starts the stream again: the headset slept
_WORDS: Final = 200


class GrpcInbox(Inbox):
    """A stream of encoded messages from a gRPC method that takes an empty request.

    A message consists of its bytes and the number of the connection.

    Args:
        feature: what needs grpcio, for the error message if it is missing.
        extra: the extra that installs grpcio.
        address: HOST:PORT of the server, which may start later.
        method: path of the method: ``/package.Service/Method``.
        longest: size of the largest accepted message [bytes].
    """

    def __init__(self, feature: str, extra: str, address: str, method: str, longest: int) -> None:
        try:
            import grpc
        except ImportError as error:
            raise MissingExtraError(feature, extra) from error
        self._grpc = grpc
        self.address = address
        self.problem = ""
        self._method = method
        self._longest = longest
        self._newest: deque[Message] = deque(maxlen=NEWEST)
        self._arrived = threading.Condition()
        self._closing = threading.Event()
        self._last = time.monotonic()
        self._call: Any = None
        self._thread = threading.Thread(target=self._run, name=f"gRPC {address}", daemon=True)
        self._thread.start()

    def receive(self, timeout: float) -> list[Message]:
        """Returns the newest messages; see ``Inbox``."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._newest, timeout)
            messages = list(self._newest)
            self._newest.clear()
        call = self._call
        if not messages and call is not None and time.monotonic() - self._last > _SILENT_S:
            call.cancel()
        return messages

    def close(self) -> None:
        """Ends the stream and waits for its thread, for 5 s at most."""
        self._closing.set()
        call = self._call
        if call is not None:
            call.cancel()
        self._thread.join(5.0)

    def _run(self) -> None:
        connection, wait = 0, _RETRY_S[0]
        while not self._closing.is_set():
            connection += 1
            if self._listen(str(connection).encode()):
                wait = _RETRY_S[0]
            self._closing.wait(wait)
            wait = min(2.0 * wait, _RETRY_S[1])

    def _listen(self, connection: bytes) -> bool:
        """Receives one stream until it ends; True if a message arrived."""
        grpc, heard = self._grpc, False
        options = [
            ("grpc.max_receive_message_length", self._longest),
            ("grpc.enable_retries", 0),
            # Without this, channels of one process share a connection that broke.
            ("grpc.use_local_subchannel_pool", 1),
        ]
        try:
            with grpc.insecure_channel(self.address, options=options) as channel:
                self._last = time.monotonic()
                self._call = call = channel.unary_stream(self._method)(b"")
                if self._closing.is_set():  # close() came before there was a call to cancel
                    call.cancel()
                for data in call:
                    heard, self._last = True, time.monotonic()
                    with self._arrived:
                        self.problem = ""
                        self._newest.append((data, connection))
                        self._arrived.notify_all()
            self.problem = f"{self.address} ended the stream; reconnecting"
        except grpc.RpcError as error:
            self.problem = self._words(error)
        finally:
            self._call = None
        return heard

    def _words(self, error: Any) -> str:
        code = error.code().name if callable(getattr(error, "code", None)) else "error"
        if code == "CANCELLED":
            return f"{self.address} does not send anything; reconnecting"
        if code == "UNIMPLEMENTED":
            return (
                f"{self.address} is a gRPC server without hand tracking; check the address and port"
            )
        if code == "RESOURCE_EXHAUSTED":
            return f"{self.address} sends messages longer than {self._longest} bytes"
        text = " ".join(str(error.details() or "").split())[:_WORDS]
        return (
            f"can't connect to {self.address} ({code}: {text}); check that the app is running, "
            "that it shows this address, and that the headset is on this network. Trying to "
            "connect again"
        )
