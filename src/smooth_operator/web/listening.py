"""A socket for a server."""

from __future__ import annotations

import socket


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
