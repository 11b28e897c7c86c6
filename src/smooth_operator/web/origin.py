"""Origin check of requests."""

from __future__ import annotations

import ipaddress
from typing import Any
from urllib.parse import urlsplit

from smooth_operator.web.addresses import LOCAL


def same_origin(request: Any) -> bool:
    """Whether no other page sent it.

    Programs say no origin; a browser says that of the page that wants to connect.
    """
    origin, host = request.headers.get("Origin"), request.headers.get("Host", "")
    return origin is None or urlsplit(origin).netloc.lower() == host.lower()


def names_this_machine(request: Any) -> bool:
    """Whether the request names a loopback address, and not some name that points there.

    A name that an attacker points at this machine is same-origin to their own page.
    """
    name = _name_of(request.headers.get("Host", ""))
    return (name or "") in LOCAL or is_loopback(name)


def is_loopback(host: str | None) -> bool:
    """Whether a numeric address is this machine's to itself."""
    try:
        return ipaddress.ip_address(host or "").is_loopback
    except ValueError:
        return False


def _name_of(host: str) -> str | None:
    """The name in a ``Host`` header, without its port."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None
