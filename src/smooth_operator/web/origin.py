"""Checks of a request: its form, its origin, the name by which it calls this machine."""

from __future__ import annotations

import ipaddress
from itertools import chain
from typing import Any, Final
from urllib.parse import urlsplit

from smooth_operator.web.addresses import LOCAL

_ONCE: Final = ("Origin", "Cookie", "Upgrade", "Accept-Encoding")
"""Headers that servers here read, besides ``Host``; twice they may say two things."""


def well_formed(request: Any) -> bool:
    """Whether a request names its host once, no header that is read twice, and a path that is one.

    What browsers and programs send is; what is not would end in an exception where it is read.
    """
    values = [request.headers.get_all(name) for name in ("Host", *_ONCE)]
    try:
        urlsplit(request.path)
    except ValueError:
        return False
    texts = [request.path, *chain.from_iterable(values)]
    return len(values[0]) == 1 and max(map(len, values)) == 1 and all(map(str.isascii, texts))


def same_origin(request: Any) -> bool:
    """Whether no other page sent it.

    Programs say no origin; a browser says that of the page that wants to connect.
    """
    origins, hosts = (request.headers.get_all(name) for name in ("Origin", "Host"))
    if len(hosts) != 1 or len(origins) > 1:
        return False
    try:
        return not origins or urlsplit(origins[0]).netloc.lower() == hosts[0].lower()
    except ValueError:  # such as http://[
        return False


def names_this_machine(request: Any) -> bool:
    """Whether the request names a loopback address, and not some name that points there.

    A name that an attacker points at this machine is same-origin to their own page.
    """
    name = _name_of("".join(request.headers.get_all("Host")))
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
