"""The page and its WebSocket on one HTTPS port, in an asyncio loop of the source's thread."""

from __future__ import annotations

import asyncio
import http
import logging
import socket
import ssl
from collections.abc import Callable
from importlib import resources
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from smooth_operator.errors import MissingExtraError, SourceError
from smooth_operator.sources.webxr.certificate import Certificate
from smooth_operator.sources.webxr.link import Link
from smooth_operator.sources.webxr.packet import MAX_BYTES

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

SOCKET_PATH: Final = "/link"
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_HEADERS: Final = {
    "Cache-Control": "no-store",
    # Nothing from elsewhere; wss: since older Safaris don't count it as 'self'.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self'; connect-src 'self' wss:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_MOST_CONNECTIONS: Final = 32
_LOOK_EVERY: Final = 0.05  # [s]

# Browsers try, give up, and come with plain HTTP; none of that is the operator's concern.
_LOGGER: Final = logging.getLogger("smooth_operator.webxr")
_LOGGER.addHandler(logging.NullHandler())


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens.

    Raises:
        SourceError: the address is not one of this machine's, or the port is taken.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        return socket.create_server(
            (str(address[0]), port),
            family=family,
            dualstack_ipv6=host == "::" and socket.has_dualstack_ipv6(),
        )
    except OSError as error:
        raise SourceError(
            f"can't listen on {host!r} port {port}: {error.strerror or error}; name another port "
            "(port=...), or host=127.0.0.1 for this machine, host=0.0.0.0 for its networks"
        ) from error


def page_files() -> dict[str, tuple[bytes, str]]:
    """Path -> (content, type) of all that belongs to the page."""
    folder = resources.files(__package__) / "page"
    found = {
        f"/{file.name}": (file.read_bytes(), _TYPES[f".{file.name.rsplit('.')[-1]}"])
        for file in folder.iterdir()
        if f".{file.name.rsplit('.')[-1]}" in _TYPES
    }
    return found | {"/": found["/index.html"]}


async def serve(
    listening: socket.socket,
    certificate: Certificate,
    context: ssl.SSLContext,
    link: Link,
    watch: Callable[[], bool],
) -> None:
    """Serve the page and the link until it is time to go.

    Args:
        listening: the socket.
        certificate: its public part is offered for download.
        context: with the certificate loaded.
        link: what is said over the WebSocket.
        watch: called 20 times a second; False ends the serving.

    Raises:
        MissingExtraError: websockets is not installed.
    """
    websockets = _websockets()
    site = page_files() | {"/certificate.crt": (certificate.public, "application/x-x509-ca-cert")}
    crowd: set[ServerConnection] = set()

    def answer(connection: ServerConnection, request: Request) -> Response | None:
        path = urlsplit(request.path).path
        if path == SOCKET_PATH:
            if not _same_origin(request):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "not from this page\n")
            if len(crowd) >= _MOST_CONNECTIONS:
                return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, "too many\n")
            return None
        if path not in site:
            return connection.respond(http.HTTPStatus.NOT_FOUND, "no such page\n")
        body, kind = site[path]
        response = connection.respond(http.HTTPStatus.OK, "")
        response.body = body
        for name, value in {"Content-Type": kind, "Content-Length": str(len(body))}.items():
            del response.headers[name]
            response.headers[name] = value
        response.headers.update(_HEADERS)
        return response

    async def talk(connection: ServerConnection) -> None:
        crowd.add(connection)
        try:
            await link.serve(connection)
        finally:
            crowd.discard(connection)

    async with websockets(
        talk,
        sock=listening,
        ssl=context,
        process_request=answer,
        server_header=None,
        compression=None,  # it would cost more time than the bytes that it saves
        max_size=MAX_BYTES + 64,
        ssl_handshake_timeout=10.0,
        open_timeout=5.0,
        close_timeout=1.0,
        ping_interval=2.0,
        ping_timeout=5.0,
        logger=_LOGGER,
    ):
        while watch():
            await asyncio.sleep(_LOOK_EVERY)


def _same_origin(request: Request) -> bool:
    """Programs say no origin; a browser says that of the page that wants to connect."""
    origin = request.headers.get("Origin")
    return origin is None or urlsplit(origin).netloc == request.headers.get("Host")


def _websockets() -> type:
    try:
        from websockets.asyncio.server import serve as found
    except ImportError as error:
        raise MissingExtraError("a headset's browser as source", "webxr") from error
    return found


def secure_context(certificate: Certificate) -> ssl.SSLContext:
    """For a server with this certificate."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.load_cert_chain(certificate.file)
    return context
