"""Checks requests to a page's server: form, origin, host and token.

A server that only this machine can reach needs no token; the checks of ``Origin`` and ``Host``
refuse other pages of the same browser. On a network, the address of the page has a token; the
response sets a cookie and redirects to the address without the token.
"""

from __future__ import annotations

import contextlib
import hmac
import http
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from itertools import chain
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from smooth_operator.web.addresses import is_local


@dataclass(frozen=True)
class TokenAuth:
    """Checks the token of every request to a server, for both pages and WebSockets.

    Attributes:
        tokens: role -> token; None if only this machine can connect.
        paths: role -> paths that its token opens; a role without an entry opens every path.
        shown_by: place that shows the address with the token, for the message of a refusal.
    """

    tokens: Mapping[str, str] | None = field(repr=False)
    paths: Mapping[str, Collection[str]] = field(default_factory=dict)
    shown_by: str = "the terminal"

    def refusal(self, connection: Any, request: Any) -> Any:
        """Returns a response that refuses or redirects the request, or None if it is accepted."""
        if not same_origin(request):
            return connection.respond(
                http.HTTPStatus.FORBIDDEN, "requests from another site are refused\n"
            )
        if self.tokens is None:
            if names_this_machine(request):
                return None
            return connection.respond(
                http.HTTPStatus.FORBIDDEN, "open this page as http://localhost\n"
            )
        url = urlsplit(request.path)
        allowed = {
            role: token
            for role, token in self.tokens.items()
            if role not in self.paths or url.path in self.paths[role]
        }
        port = connection.local_address[1]
        if any(
            same_secret(cookie(request, _cookie_name(role, port)), token)
            for role, token in allowed.items()
        ):
            return None
        value = parse_qs(url.query).get("token", [""])[0]
        for role, token in allowed.items():
            if not same_secret(value, token):
                continue
            if request.headers.get("Upgrade", "").lower() == "websocket":
                return None  # a program without cookies
            return _welcome(connection, url.path, f"{_cookie_name(role, port)}={token}")
        return connection.respond(
            http.HTTPStatus.UNAUTHORIZED,
            f"this page needs its token: open the complete address that {self.shown_by} shows\n",
        )


def same_secret(secret: str, expected: str) -> bool:
    """True if two secrets are equal. The comparison takes equally long wherever they differ."""
    return hmac.compare_digest(secret.encode(), expected.encode())


def cookie(request: Any, name: str) -> str:
    """Value of a cookie in a request; empty if the request does not have that cookie."""
    try:
        morsel = SimpleCookie(request.headers.get("Cookie", "")).get(name)
    except CookieError:
        return ""
    return "" if morsel is None else morsel.value


def _welcome(connection: Any, path: str, value: str) -> Any:
    """A redirect to the same page with a cookie, so that the token stays out of the browser's
    history.
    """
    response = connection.respond(http.HTTPStatus.SEE_OTHER, "")
    response.headers["Location"] = "/" + path.lstrip("/\\")  # "//name" would be another server
    response.headers["Set-Cookie"] = f"{value}; Path=/; HttpOnly; SameSite=Lax"
    response.headers["Cache-Control"] = "no-store"
    response.headers["Referrer-Policy"] = "no-referrer"
    return response


def _cookie_name(role: str, port: Any) -> str:
    return f"smooth-operator-{role}-{port}"  # browsers share cookies between ports


_ONCE: Final = ("Origin", "Cookie", "Upgrade", "Accept-Encoding")
"""Headers that the servers here read, besides ``Host``; none of them may occur twice."""


def well_formed(request: Any) -> bool:
    """True if a request has exactly one host, a valid path, and no repeated header that this
    program reads."""
    values = [request.headers.get_all(name) for name in ("Host", *_ONCE)]
    try:
        urlsplit(request.path)
    except ValueError:
        return False
    texts = [request.path, *chain.from_iterable(values)]
    return len(values[0]) == 1 and max(map(len, values)) == 1 and all(map(str.isascii, texts))


def same_origin(request: Any) -> bool:
    """True unless a page of another origin sent the request. Programs send no origin."""
    origins, hosts = (request.headers.get_all(name) for name in ("Origin", "Host"))
    if len(hosts) != 1 or len(origins) > 1:
        return False
    try:
        return not origins or urlsplit(origins[0]).netloc.lower() == hosts[0].lower()
    except ValueError:  # such as http://[
        return False


def names_this_machine(request: Any) -> bool:
    """True if the request's host is a loopback address or ``localhost``.

    If an attacker's host name led to this machine, the request would have the origin of the
    attacker's page.
    """
    with contextlib.suppress(ValueError):
        name = urlsplit(f"//{''.join(request.headers.get_all('Host'))}").hostname or ""
        return is_local(name)
    return False
