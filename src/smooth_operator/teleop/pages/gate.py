"""Who may open a page and steer by it: a token for other machines, this machine's own pages here.

viser listens, serves its files and speaks over a WebSocket, and asks nobody for anything. On this
machine alone that leaves one way in, other web pages that the same browser has open: they may
connect to a local WebSocket, and only the ``Origin`` tells them apart. Where other machines can
reach the page, whoever opens it must know the token.
"""

from __future__ import annotations

import contextlib
import http
import secrets
import threading
from collections.abc import Callable, Iterator
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from viser.infra import _infra

from smooth_operator.web.files import shielded
from smooth_operator.web.origin import (
    cookie,
    is_loopback,
    names_this_machine,
    same_origin,
    same_secret,
)

_COOKIE: Final = "smooth-operator-page"
_POLICY: Final = (
    "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; "
    "connect-src 'self' data: blob: ws: wss:; frame-src 'none'; object-src 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""viser's page is one file with its script in it, and makes WebAssembly and workers from that. It
loads nothing from elsewhere, and no page frames it."""
_PATCHING = threading.Lock()


class Gate:
    """Looks at the first request of every connection, of the page and of its WebSocket.

    With a token, the page's address holds it once; the answer is a cookie and the address without
    it. A program may give the token in the WebSocket's address.

    Args:
        token: what to ask for; None where only this machine can connect.
    """

    def __init__(self, token: str | None) -> None:
        self.token = token
        self.guarding = False

    def __call__(self, connection: Any, request: Any) -> Any:
        """A response that refuses or redirects; None to let the request pass."""
        if not same_origin(request):
            return connection.respond(
                http.HTTPStatus.FORBIDDEN, "this page may not be used from another one\n"
            )
        if self.token is None:
            if names_this_machine(request):
                return None
            return connection.respond(
                http.HTTPStatus.FORBIDDEN, "open this page as http://localhost\n"
            )
        name = f"{_COOKIE}-{connection.local_address[1]}"  # cookies know no ports
        if self._knows(cookie(request, name)):
            return None
        url = urlsplit(request.path)
        if not self._knows(parse_qs(url.query).get("token", [""])[0]):
            return connection.respond(
                http.HTTPStatus.UNAUTHORIZED,
                "this page needs its token: open the whole address that the terminal shows\n",
            )
        if request.headers.get("Upgrade", "").lower() == "websocket":
            return None
        response = connection.respond(http.HTTPStatus.SEE_OTHER, "")
        response.headers["Location"] = "/"  # so that the token stays in no history
        response.headers["Set-Cookie"] = f"{name}={self.token}; Path=/; HttpOnly; SameSite=Lax"
        response.headers["Cache-Control"] = "no-store"
        response.headers["Referrer-Policy"] = "no-referrer"
        return response

    def _knows(self, given: str) -> bool:
        assert self.token is not None
        return same_secret(given, self.token)


def gate_for(host: str) -> Gate:
    """The gate for a page that listens on ``host``: a token unless only this machine reaches it."""
    local = host == "localhost" or is_loopback(host)
    return Gate(None if local else secrets.token_urlsafe(24))


@contextlib.contextmanager
def guarded(gate: Gate) -> Iterator[None]:
    """Servers of viser that are started within ask the gate first; see ``Gate.guarding``.

    viser has no place for such a question, so the function that it starts its server by is
    wrapped, for viser alone, while it starts.
    """
    with _PATCHING:
        viser: Any = _infra
        plain = viser.websockets
        server = plain.asyncio.server
        asking = _Module(server, serve=_asking(gate, server.serve))
        viser.websockets = _Module(plain, asyncio=_Module(plain.asyncio, server=asking))
        try:
            yield
        finally:
            viser.websockets = plain


class _Module:
    """A module with some names replaced."""

    def __init__(self, module: Any, **replaced: Any) -> None:
        self._module = module
        self.__dict__.update(replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)


def _asking(gate: Gate, serve: Callable[..., Any]) -> Callable[..., Any]:
    def guarded_serve(*args: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        gate.guarding = True
        return serve(
            *args,
            process_request=shielded(lambda c, r: gate(c, r) or process_request(c, r), _POLICY),
            **options,
        )

    return guarded_serve
