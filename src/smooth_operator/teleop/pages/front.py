"""Server in front of viser's server: it checks each request, adds scripts to the page and relays
the rest.

viser can neither check requests nor add scripts. So viser listens on a loopback address that
nothing else knows, and a server of this package relays requests to it.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import http.client
import secrets
import socket
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Final

import msgspec
import rich
import viser
from websockets.asyncio.client import connect
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from smooth_operator.web.auth import TokenAuth
from smooth_operator.web.files import file_response, shielded
from smooth_operator.web.listening import quiet_options

ALIVE_PATH: Final = "/alive"
"""Path that answers 204 while clicks on the page reach the program that acts on them, else 503."""

_POLICY: Final = (
    "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; "
    "connect-src 'self' data: blob: ws: wss:; frame-src 'none'; object-src 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy. viser's page is one file that contains its script, WebAssembly and
workers; it loads nothing from elsewhere, and no other page may embed it in a frame."""
_LARGEST: Final = 50 << 20  # size of the largest message [bytes], as in viser


def hidden_address() -> str:
    """A random loopback address, because a malicious page in a local browser can try the usual
    one."""
    if sys.platform == "darwin":  # which has only the usual one
        return "127.0.0.1"
    return ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])


class GuardedServer(viser.ViserServer):
    """A viser server on a port that requires a token or a browser on this machine.

    Args:
        host: address to listen on.
        port: a free port.
        auth: checks each request.
        alive: returns the answer to ``ALIVE_PATH``; called on a thread of the server.

    Attributes:
        front: the server that listens on the port.
        tab: element with the title of the browser's tab; None before it is created.
    """

    def __init__(
        self, host: str, port: int, auth: TokenAuth, alive: Callable[[], bool] = lambda: True
    ) -> None:
        hidden = hidden_address()
        with rich.get_console().capture():  # viser prints its address; captures this thread only
            super().__init__(host=hidden, port=0, verbose=False)
        self.tab: viser.GuiHtmlHandle | None = None
        self.front = Front((host, port), (hidden, super().get_port()), auth, alive)

    def get_port(self) -> int:
        """The port of the page."""
        return self.front.port

    def stop(self) -> None:
        """Closes the port. Viser then prints a line from its own thread."""
        self.front.stop()
        super().stop()


class Front:
    """Server that answers or refuses a request, or relays it to the viser server ``behind`` it
    (host, port).

    Attributes:
        token: token of the page; None if only this machine can connect.
        scripts: scripts that run in each browser that opens the page.
    """

    def __init__(
        self,
        place: tuple[str, int],
        behind: tuple[str, int],
        auth: TokenAuth,
        alive: Callable[[], bool],
    ) -> None:
        self._host, self.port = place
        self.token = None if auth.tokens is None else auth.tokens["page"]
        self.scripts: list[str] = []
        self._behind, self._auth, self._alive = behind, auth, alive
        end: Future[Callable[[], object]] = Future()
        self._thread = threading.Thread(target=self._serve, args=(end,), name="front", daemon=True)
        self._thread.start()
        self._end = end.result()

    def stop(self) -> None:
        """Closes the port."""
        with contextlib.suppress(RuntimeError):  # closed already
            self._end()
        self._thread.join()

    def _serve(self, end: Future[Callable[[], object]]) -> None:
        try:
            asyncio.run(self._listen(end))
        except BaseException as error:
            if end.done():
                raise
            end.set_exception(error)

    async def _listen(self, end: Future[Callable[[], object]]) -> None:
        loop, ended = asyncio.get_running_loop(), asyncio.Event()
        async with serve(
            self._relay,
            self._host,
            self.port,
            process_request=shielded(self._answer, _POLICY),
            select_subprotocol=lambda _, offered: next(iter(offered), None),
            compression=None,
            max_size=_LARGEST,
            **quiet_options("smooth_operator.page"),
        ):
            end.set_result(lambda: loop.call_soon_threadsafe(ended.set))
            await ended.wait()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        refusal = self._auth.refusal(connection, request) or _not_a_client(connection, request)
        if refusal is not None:
            answer: Response = refusal
            return answer
        if request.path == ALIVE_PATH:
            alive = self._alive()
            return connection.respond(
                http.HTTPStatus.NO_CONTENT if alive else http.HTTPStatus.SERVICE_UNAVAILABLE, ""
            )
        return None if "Upgrade" in request.headers else self._page(connection, request.path)

    def _page(self, connection: ServerConnection, path: str) -> Response:
        """A file of viser's page; the scripts are added at the beginning of the page itself."""
        viser_port = http.client.HTTPConnection(*self._behind, timeout=10.0)
        with contextlib.closing(viser_port):
            viser_port.request("GET", path)
            reply = viser_port.getresponse()
            kind, body = reply.headers.get_content_type(), reply.read()
        if kind == "text/html":
            scripts = (f"<script>{each}</script>" for each in self.scripts)
            body = body.replace(b"<head>", "".join(["<head>", *scripts]).encode(), 1)
        return file_response(connection, http.HTTPStatus(reply.status), body, kind)

    async def _relay(self, client: ServerConnection) -> None:
        """Relays messages in both directions until one end closes."""
        protocol = client.subprotocol
        async with connect(
            f"ws://{self._behind[0]}:{self._behind[1]}/",
            sock=socket.create_connection(self._behind),  # without a proxy
            subprotocols=None if protocol is None else [protocol],
            compression=None,
            max_size=None,
        ) as page:
            ways = [
                asyncio.create_task(_pass_on(client, page, _is_message)),
                asyncio.create_task(_pass_on(page, client, lambda _: True)),
            ]
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            for way in ways:
                way.cancel()


async def _pass_on(source: Any, target: Any, passes: Callable[[str | bytes], bool]) -> None:
    with contextlib.suppress(ConnectionClosed):
        async for message in source:
            if not passes(message):
                return
            await target.send(message)


def _is_message(message: str | bytes) -> bool:
    """True if viser can read a message. For any other message it would print a traceback."""
    with contextlib.suppress(msgspec.DecodeError, TypeError):
        return isinstance(message, bytes) and "type" in msgspec.msgpack.decode(message)
    return False


def _not_a_client(connection: Any, request: Any) -> Any:
    """Refuses a WebSocket that was not opened by a viser page; viser would print a line for it."""
    protocols = request.headers.get_all("Sec-WebSocket-Protocol")
    if "Upgrade" not in request.headers or any("viser-v" in each for each in protocols):
        return None
    return connection.respond(http.HTTPStatus.BAD_REQUEST, "no client of this page\n")
