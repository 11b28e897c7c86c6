"""Finds host names and addresses of this machine, for pages and certificates."""

from __future__ import annotations

import contextlib
import ipaddress
import re
import socket
from typing import Final

LOCAL: Final = ("localhost", "127.0.0.1", "::1")
"""Names of this machine for itself."""

# Addresses for documentation (RFC 5737, RFC 3849). To connect a UDP socket sends nothing, but the
# system selects the interface of the default route.
_ELSEWHERE: Final = ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1"))


def is_local(host: str) -> bool:
    """True if only this machine can reach a server that listens on ``host``."""
    if host == "localhost":
        return True
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False


def is_zmq_address(text: str) -> bool:
    """True for a ZeroMQ address; a TCP address must have a port: ``tcp://127.0.0.1:5556``."""
    return re.fullmatch(r"(?!tcp:)\w+://.+|tcp://.+:[\d*!]+", text) is not None


def lan_addresses(host: str = "0.0.0.0") -> tuple[str, ...]:
    """Addresses of this machine in its networks; the one of the default route comes first.

    Args:
        host: ``0.0.0.0`` for IPv4, ``::`` for IPv4 and IPv6, whose addresses may change each day.
    """
    families = _ELSEWHERE if host == "::" else _ELSEWHERE[:1]
    addresses: list[str] = []
    for family, elsewhere in families:
        with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((elsewhere, 9))
            addresses.append(str(probe.getsockname()[0]))
        with contextlib.suppress(OSError):
            own = socket.getaddrinfo(socket.gethostname(), None, family)
            addresses += [str(entry[4][0]) for entry in own]
    return tuple(dict.fromkeys(address for address in addresses if _reachable(address)))


def names_of(host: str) -> tuple[str, ...]:
    """Host names for the certificate of a server that listens on ``host``."""
    if is_local(host):
        return LOCAL
    if host not in ("0.0.0.0", "::"):
        return (*LOCAL, host)
    name = socket.gethostname().split(".")[0].lower()
    own = (f"{name}.local",) if name and name != "localhost" else ()
    return (*LOCAL, *lan_addresses(host), *own)


def page_addresses(host: str, port: int, scheme: str = "https") -> tuple[str, ...]:
    """Addresses under which the page can be opened, best one first."""
    if is_local(host):
        names: tuple[str, ...] = ("localhost",)
    elif host in ("0.0.0.0", "::"):
        names = lan_addresses(host) or ("localhost",)
    else:
        names = (host,)
    return tuple(
        f"{scheme}://[{n}]:{port}" if ":" in n else f"{scheme}://{n}:{port}" for n in names
    )


def _reachable(address: str) -> bool:
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:  # IPv6 with a zone, which no browser takes
        return False
    return not (parsed.is_loopback or parsed.is_link_local or parsed.is_unspecified)
