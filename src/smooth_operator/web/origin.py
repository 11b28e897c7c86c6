"""Where a request comes from, as far as it tells."""

from __future__ import annotations

import hmac
import ipaddress
from http.cookies import CookieError, SimpleCookie
from typing import Any, Final
from urllib.parse import urlsplit

_LOCAL_NAMES: Final = ("localhost", "127.0.0.1", "::1")


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
    return (name or "") in _LOCAL_NAMES or is_loopback(name)


def is_loopback(host: str | None) -> bool:
    """Whether a numeric address is this machine's to itself."""
    try:
        return ipaddress.ip_address(host or "").is_loopback
    except ValueError:
        return False


def cookie(request: Any, name: str) -> str:
    """Value of a cookie; empty if there is none."""
    try:
        found = SimpleCookie(request.headers.get("Cookie", "")).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


def same_secret(given: str, known: str) -> bool:
    """Whether two are the same, in a time that does not tell how much of them is."""
    return hmac.compare_digest(given.encode(), known.encode())


def _name_of(host: str) -> str | None:
    """The name in a ``Host`` header, without its port."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None
