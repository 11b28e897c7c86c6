"""Opens a server's listening socket with limits, and sets options of WebSocket servers."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any, Final

_REFUSED_IN_A_ROW: Final = 100
"""Number of connections that one call of accept may refuse, so that a flood leaves time for other
work.
"""


def listen(host: str, port: int) -> socket.socket:
    """Opens a listening socket; port 0 chooses any free port. OSError if the address does not
    belong to this machine, or the port is in use."""
    family, _, _, _, address = socket.getaddrinfo(
        host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )[0]
    return socket.create_server(
        (str(address[0]), port),
        family=family,
        dualstack_ipv6=host == "::" and socket.has_dualstack_ipv6(),
    )


class LimitedListener(socket.socket):
    """A listening socket that limits the number of open connections.

    It closes connections above the limits before TLS. A connection waits until the server calls
    ``served``. If too many connections of an address wait, the oldest is closed, so that half-open
    ones don't lock the address out.

    Args:
        listening: a listening socket, which this object replaces.
        most: largest number of open connections.
        most_of_one: largest number of open connections from one address.
        most_waiting: largest number of waiting connections from one address.
    """

    def __init__(
        self, listening: socket.socket, most: int, most_of_one: int, most_waiting: int
    ) -> None:
        timeout = listening.gettimeout()
        super().__init__(
            listening.family, listening.type, listening.proto, fileno=listening.detach()
        )
        self.settimeout(timeout)
        self._most, self._most_of_one, self._most_waiting = most, most_of_one, most_waiting
        self._open: Counter[str] = Counter()
        self._waiting: dict[Any, socket.socket] = {}  # by their addresses, the oldest first
        self._change = threading.Lock()

    def accept(self) -> tuple[socket.socket, Any]:
        """Returns the next connection within the limits; BlockingIOError if there is none now."""
        for _ in range(_REFUSED_IN_A_ROW):
            connection, address = super().accept()
            host = str(address[0])
            with self._change:
                room = self._open.total() < self._most and self._open[host] < self._most_of_one
                if room:
                    self._open[host] += 1
            if room:
                counted = _Counted(connection, partial(self._leave, address))
                self._wait(counted, address)
                return counted, address
            connection.close()
        raise BlockingIOError

    def served(self, address: Any) -> None:
        """Marks the connection from an address (host, port, ...) as served, because its request has
        arrived."""
        with self._change:
            self._waiting.pop(address, None)

    def _wait(self, connection: socket.socket, address: Any) -> None:
        with self._change:
            waiting = [each for each in self._waiting if each[0] == address[0]]
            if len(waiting) >= self._most_waiting:
                with contextlib.suppress(OSError):  # the server closes it at its end of file
                    self._waiting.pop(waiting[0]).shutdown(socket.SHUT_RDWR)
            self._waiting[address] = connection

    def _leave(self, address: Any) -> None:
        host = str(address[0])
        with self._change:
            self._waiting.pop(address, None)
            self._open[host] -= 1
            if not self._open[host]:
                del self._open[host]


class _Counted(socket.socket):
    """A connection that calls back when it is closed."""

    def __init__(self, connection: socket.socket, closed: Callable[[], None]) -> None:
        super().__init__(
            connection.family, connection.type, connection.proto, fileno=connection.detach()
        )
        self._when_closed: Callable[[], None] | None = closed

    def close(self) -> None:
        super().close()
        closed, self._when_closed = self._when_closed, None
        if closed is not None:
            closed()


def quiet_options(name: str) -> dict[str, Any]:
    """Options for ``websockets.asyncio.server.serve`` that prevent output about bad requests.

    Errors of a client go to the logger ``name`` with a traceback. The library's own logger has no
    handler, so Python would print them in the operator's terminal.
    """
    from websockets.asyncio.server import ServerConnection

    class Connection(ServerConnection):
        """A connection that joins its pending writes.

        asyncio prints a line for each write to a lost connection, such as the answers to the pings
        of a client that is gone.
        """

        def send_data(self) -> None:
            data = self.protocol.data_to_send()
            if answers := b"".join(data):
                self.transport.write(answers)
            if b"" not in data:  # marks the end
                return
            if self.transport.can_write_eof():
                with contextlib.suppress(OSError, RuntimeError):
                    self.transport.write_eof()
            else:  # TLS
                self.transport.close()

    logger = logging.getLogger(name)
    if not any(isinstance(each, logging.NullHandler) for each in logger.handlers):
        logger.addHandler(logging.NullHandler())
    return {"logger": logger, "create_connection": Connection, "server_header": None}
