"""Token authentication of a page's server: which requests are answered.

A server that only this machine reaches asks for no token. That leaves one way in, other pages that
the same browser has open, which may connect to a local WebSocket; the ``Origin`` and ``Host`` of
the request keep them out. Where other machines reach the server, a page's address holds a token;
the answer is a cookie and the address without the token.
"""

from __future__ import annotations

import hmac
import http
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from smooth_operator.web.origin import names_this_machine, same_origin


@dataclass(frozen=True)
class TokenAuth:
    """Looks at every request of a server of websockets, of a page and of its WebSocket.

    Attributes:
        tokens: role -> token; None where only this machine can connect.
        paths: role -> all paths that its token opens; a role that is absent opens every path.
        shown_by: who shows the address with the token, for the message of a refusal.
    """

    tokens: Mapping[str, str] | None = field(repr=False)
    paths: Mapping[str, Collection[str]] = field(default_factory=dict)
    shown_by: str = "the terminal"

    def refusal(self, connection: Any, request: Any) -> Any:
        """A response that refuses or redirects; None to let the request pass."""
        if not same_origin(request):
            return connection.respond(
                http.HTTPStatus.FORBIDDEN, "this page may not be used from another one\n"
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
                return None  # a program, which has no cookies
            return _welcome(connection, url.path, f"{_cookie_name(role, port)}={token}")
        return connection.respond(
            http.HTTPStatus.UNAUTHORIZED,
            f"this page needs its token: open the whole address that {self.shown_by} shows\n",
        )


def same_secret(secret: str, expected: str) -> bool:
    """Whether two are equal, in a time that does not depend on where they differ."""
    return hmac.compare_digest(secret.encode(), expected.encode())


def cookie(request: Any, name: str) -> str:
    """Value of a cookie of a request; empty if there is none."""
    try:
        morsel = SimpleCookie(request.headers.get("Cookie", "")).get(name)
    except CookieError:
        return ""
    return "" if morsel is None else morsel.value


def _welcome(connection: Any, path: str, value: str) -> Any:
    """A redirect to the same page with a cookie, so that the token stays in no history."""
    response = connection.respond(http.HTTPStatus.SEE_OTHER, "")
    response.headers["Location"] = "/" + path.lstrip("/\\")  # "//name" would be another server
    response.headers["Set-Cookie"] = f"{value}; Path=/; HttpOnly; SameSite=Lax"
    response.headers["Cache-Control"] = "no-store"
    response.headers["Referrer-Policy"] = "no-referrer"
    return response


def _cookie_name(role: str, port: Any) -> str:
    return f"smooth-operator-{role}-{port}"  # browsers share cookies between ports
