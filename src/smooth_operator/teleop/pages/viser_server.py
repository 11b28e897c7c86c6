"""Opening and closing a viser server: what every page here does."""

from __future__ import annotations

import atexit
import errno
import html
import os
import re
import secrets
import socket
import threading
from collections.abc import Callable, Coroutine
from importlib import resources
from typing import Any, Final, Self, TypeVar

import viser

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.pages.front import GuardedServer
from smooth_operator.terminal import print_note
from smooth_operator.web.addresses import is_local, lan_addresses
from smooth_operator.web.auth import TokenAuth
from smooth_operator.web.browser import open_page


def open_server(host: str, port: int, alive: Callable[[], bool] = lambda: True) -> GuardedServer:
    """A server on the first free port.

    Where other machines can reach it, it wants the token that is in ``page_url``.

    Args:
        port: first port to try; 0 for any free one.
        alive: answer to ``ALIVE_PATH``; from the server's thread.

    Raises:
        ConfigError: if the address is not one of this machine's, or no port is free.
    """
    server = GuardedServer(host, free_port(host, port), auth_for(host), alive)
    run_script(server, read_script(__package__, "page.js"))
    return server


def close_server(server: viser.ViserServer) -> None:
    """Closes the port."""
    server.stop()


def run_script(server: GuardedServer, source: str) -> None:
    """Runs a script in every browser that opens the page from now on.

    Args:
        server: result of ``open_server``.
    """
    server.front.scripts.append(source)


def read_script(package: str, name: str) -> str:
    """A script among the files of a package."""
    return resources.files(package).joinpath(name).read_text("utf-8")


def name_panel(gui: viser.GuiApi, name: str) -> None:
    """Gives a page its dark theme, and its panel a name."""
    gui.set_panel_label(name)
    gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)


def name_tab(server: GuardedServer, title: str) -> None:
    """Gives a page its own title in the browser's tab, now or at any time later.

    Args:
        server: result of ``open_server``.
    """
    text = f'<i hidden data-title="{html.escape(title)}"></i>'
    if server.tab is None:
        server.tab = server.gui.add_html(text)
    else:
        server.tab.content = text


def page_url(host: str, server: GuardedServer) -> str:
    """Address of a page, its token included.

    Args:
        host: that it listens on; for all addresses of this machine, the one that leads to its
            network is named, which works here, too.
        server: result of ``open_server``.
    """
    if host in ("0.0.0.0", "::"):
        host = next(iter(lan_addresses()), "localhost")
    port, token = server.get_port(), server.front.token
    base = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
    return base if token is None else f"{base}/?token={token}"


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


def auth_for(host: str) -> TokenAuth:
    """Asks for a token unless only this machine reaches ``host``."""
    return TokenAuth(None if is_local(host) else {"page": secrets.token_urlsafe(24)})


class PageServer:
    """Serves a page. Use as a context manager, or call ``start`` and ``stop``.

    Args:
        host: address to listen on. The default is reachable from this machine only; any other
            wants the token that is in ``url``.
        port: first port to try; the next free one is taken, see ``url``. 0: any free one.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080) -> None:
        self._host, self._wanted_port = host, port
        self._server: GuardedServer | None = None
        self._ended = threading.Event()
        self._error: BaseException | None = None

    @property
    def title(self) -> str:
        """Title of the browser's tab. Each page has its own."""
        raise NotImplementedError

    def _build(self, server: GuardedServer) -> None:
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

    def _serving(self) -> GuardedServer:
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
