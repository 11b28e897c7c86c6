"""The page and its WebSocket on one HTTPS port, in an asyncio loop of the source's thread."""

from __future__ import annotations

import asyncio
import http
import json
import ssl
from collections.abc import Callable
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from smooth_operator.errors import MissingExtraError, SourceError
from smooth_operator.landmarks import FINGER_COLORS
from smooth_operator.teleop.sources.webxr.certificate import Certificate
from smooth_operator.teleop.sources.webxr.link import MAX_BYTES, Link
from smooth_operator.web.files import answer_with, page_files, shielded
from smooth_operator.web.listening import LimitedListener
from smooth_operator.web.listening import listen as web_listen
from smooth_operator.web.origin import same_origin
from smooth_operator.web.quiet import quiet_options

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

SOCKET_PATH: Final = "/link"
MOST_CONNECTIONS: Final = 64
MOST_OF_ONE_ADDRESS: Final = 24
MOST_WAITING: Final = 12
"""A page takes seven at most, and a connection whose TLS is not yet agreed on 0.3 MB."""
_HANDSHAKE_S: Final = 5.0
"""How long each of TLS, the request and the greeting may take [s]."""
_LOOK_EVERY: Final = 0.05  # [s]


def listen(host: str, port: int) -> LimitedListener:
    """A socket that listens.

    Raises:
        SourceError: the address is not one of this machine's, or the port is taken.
    """
    try:
        return LimitedListener(
            web_listen(host, port), MOST_CONNECTIONS, MOST_OF_ONE_ADDRESS, MOST_WAITING
        )
    except OSError as error:
        raise SourceError(
            f"can't listen on {host!r} port {port}: {error.strerror or error}; name another port "
            "(port=...), or host=127.0.0.1 for this machine, host=0.0.0.0 for its networks"
        ) from error


async def serve(
    listening: LimitedListener,
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
    site = page_files("smooth_operator.web") | page_files(__package__)
    site["/"] = site["/index.html"]
    site["/colors.js"] = (_colors().encode(), "text/javascript; charset=utf-8")
    site["/certificate.crt"] = (certificate.public, "application/x-x509-ca-cert")

    def answer(connection: ServerConnection, request: Request) -> Response | None:
        listening.served(connection.remote_address)
        path = urlsplit(request.path).path
        if path == SOCKET_PATH:
            if not same_origin(request):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "not from this page\n")
            return None
        if path not in site:
            return connection.respond(http.HTTPStatus.NOT_FOUND, "no such page\n")
        return answer_with(connection, *site[path])

    async with websockets(
        link.serve,
        sock=listening,
        ssl=context,
        process_request=shielded(answer),
        compression=None,  # it would cost more time than the bytes that it saves
        max_size=MAX_BYTES + 64,
        ssl_handshake_timeout=_HANDSHAKE_S,
        open_timeout=_HANDSHAKE_S,
        close_timeout=1.0,
        ping_interval=2.0,
        ping_timeout=5.0,
        **quiet_options("smooth_operator.webxr"),  # browsers try, give up, come with plain HTTP
    ):
        while watch():
            await asyncio.sleep(_LOOK_EVERY)


def _colors() -> str:
    """The module ``colors.js``: a colour (red, green, blue) [0..255] for each finger."""
    colors = [list(bytes.fromhex(code.removeprefix("#"))) for code in FINGER_COLORS]
    return f"export const FINGER_COLORS = {json.dumps(colors)};\n"


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
