"""Finding a port to listen on before a server takes it."""

from __future__ import annotations

import errno
import os
import socket

from smooth_operator.errors import ConfigError

_TRIES = 100


def free_port(host: str, port: int) -> int:
    """The first free port from ``port`` on.

    viser looks for a free port itself, but takes every failure for "taken": with an address that
    is not this machine's it would try for ever. So the address is tried out first.

    Args:
        host: name or address to listen on.
        port: first candidate, 1..65535; 0 lets the system choose.

    Raises:
        ConfigError: if the address is not one of this machine's, or no port is free.
    """
    if not 0 <= port <= 65535:
        raise ConfigError(f"port must be in 0..65535, not {port}")
    try:
        infos = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as error:
        raise ConfigError(f"can't resolve host {host!r}: {error}; try 127.0.0.1") from None
    addresses = {(family, address[0]) for family, _, _, _, address in infos}
    candidates = range(port, min(port + _TRIES, 65536)) if port else [0]
    for candidate in candidates:
        try:
            bound = [_bind(family, str(address), candidate) for family, address in addresses]
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                continue
            raise ConfigError(
                f"can't listen on {host!r}: {error.strerror}; use 127.0.0.1 for this machine "
                "only, or 0.0.0.0 for the whole network"
            ) from None
        return candidate or bound[0]
    raise ConfigError(f"no free port in {port}..{candidates[-1]} on {host}; name another port")


def _bind(family: socket.AddressFamily, address: str, port: int) -> int:
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if os.name == "posix":  # as the server itself will: a port just left is free
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((address, port))
        return int(probe.getsockname()[1])
