"""Opening and closing a viser server: what every page here does."""

from __future__ import annotations

import atexit
import contextlib
import errno
import http
import json
import os
import re
import secrets
import socket
import threading
from collections.abc import Callable, Coroutine, Iterator
from importlib import resources
from typing import Any, Final, Self, TypeVar
from weakref import WeakKeyDictionary

import rich
import viser
from viser import _messages
from viser.infra import _infra

from smooth_operator.errors import ConfigError
from smooth_operator.terminal import print_note
from smooth_operator.web.addresses import is_local, lan_addresses
from smooth_operator.web.auth import TokenAuth
from smooth_operator.web.browser import open_page
from smooth_operator.web.files import shielded
from smooth_operator.web.listening import quiet_options

_TOKENS: Final[WeakKeyDictionary[viser.ViserServer, str | None]] = WeakKeyDictionary()


ALIVE_PATH: Final = "/alive"
"""Path that answers 204 while the clicks of a page arrive where they act, else 503."""


def open_server(
    host: str, port: int, alive: Callable[[], bool] = lambda: True
) -> viser.ViserServer:
    """A server on the first free port, without a word on standard output.

    Where other machines can reach it, it wants the token that is in ``page_url``.

    Args:
        port: first port to try; 0 for any free one.
        alive: answer to ``ALIVE_PATH``; from the server's thread.

    Raises:
        ConfigError: if the address is not one of this machine's, no port is free, or this release
            of viser can't be made to ask for the token.
    """
    port, auth = free_port(host, port), auth_for(host)
    with _quiet_viser(), authenticated(auth, alive) as started:
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if auth.tokens is not None and not started:
        close_server(server)
        raise ConfigError(
            f"viser {viser.__version__} can't be made to ask for a token, so the page is not "
            f"served to other machines on {host!r}; use --host 127.0.0.1, or install viser 1.1"
        )
    _TOKENS[server] = None if auth.tokens is None else auth.tokens["page"]
    run_script(server, read_script(__package__, "page.js"))
    return server


def close_server(server: viser.ViserServer) -> None:
    """Closes the port."""
    with _quiet_viser():
        server.stop()


def run_script(server: viser.ViserServer, source: str) -> None:
    """Runs a script in every browser that opens the page, now or later.

    viser does so for its plots and offers nothing of the kind to others; sent again to a browser
    that has lost the connection, so a script has to look whether it has run.

    Args:
        server: result of ``open_server``.
    """
    interface: Any = server.gui
    interface._websock_interface.queue_message(_messages.RunJavascriptMessage(source=source))


def read_script(package: str, name: str) -> str:
    """A script among the files of a package."""
    return resources.files(package).joinpath(name).read_text("utf-8")


_ICON: Final = (
    "data:image/svg+xml,<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 16 16'>"
    "<g stroke-width='2.4' stroke-linecap='round'>"
    "<path stroke='%23d55e00' d='M2.2 9.5 5 12'/><path stroke='%2356b4e9' d='M5 4v5'/>"
    "<path stroke='%23009e73' d='M8 2.4V9'/><path stroke='%23cc79a7' d='M11 3.2V9'/>"
    "<path stroke='%230072b2' d='M13.8 6v4'/></g>"
    "<path fill='%23888' d='M4 9h10.5v3l-2 3H7z'/></svg>"
)
"""Five fingers in their colours."""


def name_panel(gui: viser.GuiApi, name: str) -> None:
    """Gives a page its dark theme, and its panel a name."""
    gui.set_panel_label(name)
    gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)


def name_tab(server: viser.ViserServer, title: str) -> None:
    """Gives a page its own title and icon in the browser's tab.

    Args:
        server: result of ``open_server``.
    """
    script = (
        f"document.title = {json.dumps(title)};"
        f"document.querySelector('link[rel~=icon]')?.setAttribute('href', {json.dumps(_ICON)});"
    )
    run_script(server, script)


def page_url(host: str, server: viser.ViserServer) -> str:
    """Address of a page, its token included.

    Args:
        host: that it listens on; for all addresses of this machine, the one that leads to its
            network is named, which works here, too.
        server: result of ``open_server``.
    """
    port, token = int(server.get_port()), _TOKENS.get(server)
    if host in ("0.0.0.0", "::"):
        host = next(iter(lan_addresses()), "localhost")
    base = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
    return base if token is None else f"{base}/?token={token}"


@contextlib.contextmanager
def _quiet_viser() -> Iterator[None]:
    # viser announces itself on standard output through rich's global console, which is ours
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


_SIGNS: Final = re.compile(r"^(?:i(?=mport)|e(?=xport))|[!-/:-@\[-`{-~]")


def plain(text: str) -> str:
    """Any text as Markdown that shows it letter by letter, in one line.

    viser compiles Markdown as MDX, which holds HTML, and JavaScript in braces or after ``import``
    and ``export`` at the beginning of a line. What people write into a file (a name, a source, a
    note) is none of that, so every sign that could mean something goes in as its number.
    """
    return _SIGNS.sub(lambda sign: f"&#{ord(sign[0])};", " ".join(text.split()))


def add_hotkeys(gui: viser.GuiApi, *hotkeys: tuple[str, Any, Callable[[], None]]) -> None:
    """Add commands: (name, key as viser calls it, action)."""

    def add(name: str, key: Any, action: Callable[[], None]) -> None:
        gui.add_command(name, hotkey=key).on_trigger(from_person(lambda _: action()))

    for hotkey in hotkeys:
        add(*hotkey)


def from_person(action: Callable[[Any], None]) -> Callable[[Any], Coroutine[Any, Any, None]]:
    """Wrap an action as a callback that answers people only.

    Handles also call back when the program itself writes a value; such events have no client.
    Coroutines run in order on the server's event loop, plain functions in a pool without order.
    """

    async def callback(event: Any) -> None:
        if event.client is not None:
            action(event)

    return callback


_POLICY: Final = (
    "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; "
    "connect-src 'self' data: blob: ws: wss:; frame-src 'none'; object-src 'none'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""viser's page is one file with its script in it, and makes WebAssembly and workers from that. It
loads nothing from elsewhere, and no page frames it."""
_PATCHING = threading.Lock()


def auth_for(host: str) -> TokenAuth:
    """Asks for a token unless only this machine reaches ``host``."""
    return TokenAuth(None if is_local(host) else {"page": secrets.token_urlsafe(24)})


@contextlib.contextmanager
def authenticated(auth: TokenAuth, alive: Callable[[], bool]) -> Iterator[list[str]]:
    """Servers of viser that are started in this block refuse what ``auth`` refuses.

    viser has no option for this. So the function that it starts its server with is wrapped, for
    viser alone, while it starts.

    Yields:
        an entry for each server that was started so; look at it after the start.
    """
    with _PATCHING:
        started: list[str] = []
        viser: Any = _infra
        plain = viser.websockets
        server = plain.asyncio.server
        asking = _Module(server, serve=_asking(auth, alive, started, server.serve))
        viser.websockets = _Module(plain, asyncio=_Module(plain.asyncio, server=asking))
        try:
            yield started
        finally:
            viser.websockets = plain


class _Module:
    """A module with some names replaced."""

    def __init__(self, module: Any, **replaced: Any) -> None:
        self._module = module
        self.__dict__.update(replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)


def _asking(
    auth: TokenAuth, alive: Callable[[], bool], started: list[str], serve: Callable[..., Any]
) -> Callable[..., Any]:
    def serve_and_ask(*args: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            refusal = auth.refusal(connection, request) or _not_a_client(connection, request)
            if refusal is None and request.path == ALIVE_PATH:
                status = (
                    http.HTTPStatus.NO_CONTENT if alive() else http.HTTPStatus.SERVICE_UNAVAILABLE
                )
                return connection.respond(status, "")
            return refusal or process_request(connection, request)

        started.append("viser")
        options |= quiet_options("smooth_operator.page")
        return serve(*args, process_request=shielded(answer, _POLICY), **options)

    return serve_and_ask


def _not_a_client(connection: Any, request: Any) -> Any:
    """Refuses a WebSocket that is not of a page of viser, which would print a line for it."""
    protocols = request.headers.get_all("Sec-WebSocket-Protocol")
    if "Upgrade" not in request.headers or any("viser-v" in each for each in protocols):
        return None
    return connection.respond(http.HTTPStatus.BAD_REQUEST, "no client of this page\n")


class PageServer:
    """Serves a page. Use as a context manager, or call ``start`` and ``stop``.

    Args:
        host: address to listen on. The default is reachable from this machine only; any other
            wants the token that is in ``url``.
        port: first port to try; the next free one is taken, see ``url``. 0: any free one.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080) -> None:
        self._host, self._wanted_port = host, port
        self._server: viser.ViserServer | None = None
        self._ended = threading.Event()
        self._error: BaseException | None = None

    @property
    def title(self) -> str:
        """Title of the browser's tab. Each page has its own."""
        raise NotImplementedError

    def _build(self, server: viser.ViserServer) -> None:
        """Puts everything on the page; browsers see it at one time. Each page has its own."""
        raise NotImplementedError

    def _begin(self, server: viser.ViserServer) -> None:
        """Called when the page is built."""

    def _end(self) -> None:
        """Called before the port is closed; also where the page was never started."""

    def start(self) -> Self:
        """Opens the port and shows the page; returns itself. Starting twice does nothing.

        Raises:
            ConfigError: if the address is not one of this machine's, or no port is free.
        """
        if self._server is not None:
            return self
        self._server = open_server(self._host, self._wanted_port)
        atexit.register(self.stop)
        name_tab(self._server, f"{self.title} – smooth-operator")
        with self._server.atomic():
            self._build(self._server)
        self._begin(self._server)
        return self

    def stop(self) -> None:
        """Closes the port; safe to call twice."""
        atexit.unregister(self.stop)
        self._end()
        server, self._server = self._server, None
        if server is not None:
            close_server(server)
        self._ended.set()

    def wait(self) -> None:
        """Blocks until ``stop``, or until the page fails, and then raises what went wrong."""
        while not self._ended.wait(0.2):  # bounded: Windows can't interrupt an endless wait
            pass
        if self._error is not None:
            raise self._error

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def port(self) -> int:
        """The port that the page is served on.

        Raises:
            ConfigError: the page is not being served.
        """
        return int(self._serving().get_port())

    @property
    def url(self) -> str:
        """Address of the page, its token included.

        Raises:
            ConfigError: the page is not being served.
        """
        return page_url(self._host, self._serving())

    def _serving(self) -> viser.ViserServer:
        if self._server is None:
            raise ConfigError("the page is not being served; call start() first")
        return self._server


_Page = TypeVar("_Page", bound=PageServer)


def serve_page(page: _Page, doing: str, *, open_browser: bool, block: bool) -> _Page:
    """Prints the address of a page that was started, opens it, and serves it.

    Args:
        doing: text before the address in the printed line.
        open_browser: open the page, where there is a desktop to open it on.
        block: return only after Ctrl-C; otherwise immediately, and the caller stops the page.

    Returns:
        The page: stopped if ``block``, running otherwise.
    """
    # standard error: standard output may be a result that a program reads
    port = page._wanted_port
    note = "" if port in (0, page.port) else f" (port {port} was taken)"
    print_note(f"{doing} {page.url}{note}{'; Ctrl-C ends' if block else ''}")
    if open_browser:
        open_page(page.url)
    if block:
        until_interrupted(page)
    return page


def until_interrupted(page: PageServer) -> None:
    """Serves a page that was started until Ctrl-C, and stops it."""
    try:
        page.wait()
    except KeyboardInterrupt:
        pass
    finally:
        page.stop()


_TRIES = 100


def free_port(host: str, port: int) -> int:
    """The first free port from ``port`` on.

    viser looks for a free port itself, but takes every failure for "taken": with an address that
    is not this machine's it would try for ever. So the address is tried out first.

    Args:
        host: name or address to listen on.
        port: first candidate, 1..65535; 0 lets the system choose.

    Raises:
        ConfigError: if the address is not one of this machine's, or no port is free.
    """
    if not 0 <= port <= 65535:
        raise ConfigError(f"port must be in 0..65535, not {port}")
    try:
        infos = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as error:
        raise ConfigError(f"can't resolve host {host!r}: {error}; try 127.0.0.1") from None
    addresses = {(family, address[0]) for family, _, _, _, address in infos}
    candidates = range(port, min(port + _TRIES, 65536)) if port else [0]
    for candidate in candidates:
        try:
            bound = [_bind(family, str(address), candidate) for family, address in addresses]
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                continue
            raise ConfigError(
                f"can't listen on {host!r}: {error.strerror}; use 127.0.0.1 for this machine "
                "only, or 0.0.0.0 for the whole network"
            ) from None
        return candidate or bound[0]
    raise ConfigError(f"no free port in {port}..{candidates[-1]} on {host}; name another port")


def _bind(family: socket.AddressFamily, address: str, port: int) -> int:
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if os.name == "posix":  # as the server itself will: a port just left is free
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((address, port))
        return int(probe.getsockname()[1])
