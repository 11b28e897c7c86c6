"""Serves a page's files from a package, with security headers."""

from __future__ import annotations

import http
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import PurePath
from typing import TYPE_CHECKING, Final

from smooth_operator.web.auth import well_formed

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_BARE: Final = "default-src 'none'; frame-ancestors 'none'"
"""Policy of a response that is not a page: it loads nothing, and no page frames it."""


def page_files(package: str) -> dict[str, tuple[bytes, str]]:
    """Maps the path of each file of a page to its content and type."""
    return {
        f"/{file.name}": (file.read_bytes(), _TYPES[suffix])
        for file in (resources.files(package) / "page").iterdir()
        if (suffix := PurePath(file.name).suffix) in _TYPES
    }


def file_response(
    connection: ServerConnection, status: http.HTTPStatus, body: bytes, kind: str
) -> Response:
    """Makes a response that contains a file of a given media type."""
    response = connection.respond(status, "")
    response.body = body
    for name, value in {"Content-Type": kind, "Content-Length": str(len(body))}.items():
        del response.headers[name]
        response.headers[name] = value
    return response


def answer_with(
    connection: ServerConnection,
    body: bytes,
    kind: str,
    *,
    links: str = "wss:",
    more: Mapping[str, str] | None = None,
) -> Response:
    """Makes a response that contains a file and a policy against loading anything from other
    servers.

    Args:
        links: schemes of WebSockets, which older Safaris don't count as ``'self'``.
    """
    response = file_response(connection, http.HTTPStatus.OK, body, kind)
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        f"connect-src 'self' {links}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    response.headers.update({**_HEADERS, "Content-Security-Policy": policy, **(more or {})})
    return response


def shielded(
    answer: Callable[[ServerConnection, Request], Response | None], policy: str = _BARE
) -> Callable[[ServerConnection, Request], Response | None]:
    """Wraps a server's request handler, to refuse malformed requests and add headers against
    framing.

    In a frame, a page of another origin could cover our page with its own picture, so that the
    operator clicks our buttons.

    Args:
        answer: response to a request; None to open a WebSocket.
        policy: Content-Security-Policy of responses without one.
    """

    def shield(connection: ServerConnection, request: Request) -> Response | None:
        if well_formed(request):
            response = answer(connection, request)
        else:
            response = connection.respond(http.HTTPStatus.BAD_REQUEST, "malformed request\n")
        if response is not None:
            for name, value in {**_HEADERS, "Content-Security-Policy": policy}.items():
                if name not in response.headers:
                    response.headers[name] = value
        return response

    return shield
