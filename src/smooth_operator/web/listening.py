"""Listening socket of a server."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any, Final

_REFUSED_IN_A_ROW: Final = 100
"""Connections that one call of accept may refuse, so that a flood leaves time for the others."""


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens.

    Args:
        host: an address of this machine; ``0.0.0.0`` or ``::`` for all.
        port: 0 for any free one.

    Raises:
        OSError: the address is not one of this machine's, or the port is taken.
    """
    family, _, _, _, address = socket.getaddrinfo(
        host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )[0]
    return socket.create_server(
        (str(address[0]), port),
        family=family,
        dualstack_ipv6=host == "::" and socket.has_dualstack_ipv6(),
    )


class LimitedListener(socket.socket):
    """A listening socket that accepts so many connections and no more.

    Those beyond the limits are closed before anything is read or allocated for them, TLS included.
    What counts is what is open at a time; it makes no difference what a connection is used for.
    A connection waits until the server calls ``served``; of those of one address that wait, the
    oldest makes room for the newest, so that connections left half-open don't lock an address out.

    Args:
        listening: a socket that listens; it is taken over.
        most: connections at a time.
        most_of_one: the same from one address, so that it can't take the place of all others.
        most_waiting: of these, how many may wait.
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
        """The next connection for which there is room.

        Raises:
            BlockingIOError: there is none now.
        """
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
        """A whole request has come on the connection from an address (host, port, ...)."""
        with self._change:
            self._waiting.pop(address, None)

    def _wait(self, connection: socket.socket, address: Any) -> None:
        with self._change:
            waiting = [each for each in self._waiting if each[0] == address[0]]
            if len(waiting) >= self._most_waiting:
                with contextlib.suppress(OSError):  # the server, which owns it, sees its end
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
