"""Base of the pages that use viser: server, port, scripts, hotkeys, and an end with Ctrl-C."""

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
    """Opens a viser server on the first free port.

    If other machines can reach it, it asks for the token that ``page_url`` contains.

    Args:
        port: first port to try; 0 for any free one.
        alive: returns the answer to ``ALIVE_PATH``; called on the server's thread.

    Raises:
        ConfigError: the address is not one of this machine's, or no port is free.
    """
    auth = TokenAuth(None if is_local(host) else {"page": secrets.token_urlsafe(24)})
    server = GuardedServer(host, free_port(host, port), auth, alive)
    server.front.scripts.append(read_script(__package__, "page.js"))
    return server


def read_script(package: str, name: str) -> str:
    """Reads a text file of a package."""
    return resources.files(package).joinpath(name).read_text("utf-8")


def name_panel(gui: viser.GuiApi, name: str) -> None:
    """Gives a page the dark theme, and its control panel a name."""
    gui.set_panel_label(name)
    gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)


def name_tab(server: GuardedServer, title: str) -> None:
    """Sets the title of the browser tab, at any time."""
    text = f'<i hidden data-title="{html.escape(title)}"></i>'
    if server.tab is None:
        server.tab = server.gui.add_html(text)
    else:
        server.tab.content = text


def page_url(host: str, server: GuardedServer) -> str:
    """Address of a page, including its token.

    Args:
        host: address on which it listens; for ``0.0.0.0`` and ``::`` the result contains this
            machine's address on its network.
    """
    if host in ("0.0.0.0", "::"):
        host = next(iter(lan_addresses()), "localhost")
    port, token = server.get_port(), server.front.token
    base = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
    return base if token is None else f"{base}/?token={token}"


_SIGNS: Final = re.compile(r"^(?:i(?=mport)|e(?=xport))|[!-/:-@\[-`{-~]")


def plain(text: str) -> str:
    """Escapes a text as Markdown that shows it literally, on one line.

    viser compiles Markdown as MDX, which can contain HTML and JavaScript. A text from a file must
    run neither, so each character with a special meaning is replaced by its numeric entity.
    """
    return _SIGNS.sub(lambda sign: f"&#{ord(sign[0])};", " ".join(text.split()))


def add_hotkeys(gui: viser.GuiApi, *hotkeys: tuple[str, str, Callable[[], None]]) -> None:
    """Adds hotkeys, each given as (name, key, action); the key is a letter, a digit or a name such
    as ``space``."""
    for name, key, action in hotkeys:
        viser_key: Any = key.upper() if len(key) == 1 else key
        gui.add_command(name, hotkey=viser_key).on_trigger(from_person(lambda _, do=action: do()))


def from_person(action: Callable[..., None]) -> Callable[[Any], Coroutine[Any, Any, None]]:
    """Wraps an action as a callback that runs only for events from a user's browser.

    viser also calls back when the program writes a value; such events have no client. The result is
    a coroutine, since viser runs coroutines in order, but plain functions in a thread pool without
    order.
    """

    async def callback(event: Any) -> None:
        if event.client is not None:
            action(event)

    return callback


class PageServer:
    """Serves a browser page. Use it as a context manager, or call ``start`` and ``stop``.

    Args:
        host: address to listen on. By default only this machine can reach the page; with another
            address, the token in ``url`` is required.
        port: first port to try; 0 for any free one.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080) -> None:
        self._host, self._wanted_port = host, port
        self._server: GuardedServer | None = None
        self._ended = threading.Event()
        self._error: BaseException | None = None

    @property
    def title(self) -> str:
        """Title of the browser tab."""
        raise NotImplementedError

    def _build(self, server: GuardedServer) -> None:
        """Adds all elements to the page, in one update of the browsers."""
        raise NotImplementedError

    def _begin(self, server: viser.ViserServer) -> None:
        """Called when the page has been built."""

    def _end(self) -> None:
        """Called before the port is closed, even if the page was never started."""

    def start(self) -> Self:
        """Opens the port and shows the page; a second call does nothing. ConfigError if the address
        is not one of this machine's, or no port is free."""
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
            server.stop()
        self._ended.set()

    def wait(self) -> None:
        """Blocks until ``stop`` is called. If the page fails, raises its error."""
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
        """Port of the page; raises ConfigError before ``start``."""
        return int(self._serving().get_port())

    @property
    def url(self) -> str:
        """Address of the page, including its token; raises ConfigError before ``start``."""
        return page_url(self._host, self._serving())

    def _serving(self) -> GuardedServer:
        if self._server is None:
            raise ConfigError("the page is not being served; call start() first")
        return self._server


_Page = TypeVar("_Page", bound=PageServer)


def serve_page(page: _Page, doing: str, *, open_browser: bool, block: bool) -> _Page:
    """Prints the address of a started page, opens it in a browser, and serves it.

    Args:
        doing: text before the address in the printed line.
        open_browser: open the page if there is a desktop.
        block: wait for Ctrl-C and stop the page; otherwise the caller stops it.

    Returns:
        The page.
    """
    # on standard error, since another program may read standard output
    port = page._wanted_port
    note = "" if port in (0, page.port) else f" (port {port} was taken)"
    print_note(f"{doing} {page.url}{note}{'; press Ctrl-C to stop' if block else ''}")
    if open_browser:
        open_page(page.url)
    if block:
        until_interrupted(page)
    return page


def until_interrupted(page: PageServer) -> None:
    """Serves a started page until Ctrl-C, then stops it."""
    try:
        page.wait()
    except KeyboardInterrupt:
        pass
    finally:
        page.stop()


_TRIES = 100


def free_port(host: str, port: int) -> int:
    """Finds the first free port, starting at ``port``; 0 lets the system choose. ConfigError if the
    address is not one of this machine's, or no port is free."""
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
    raise ConfigError(f"no free port in {port}..{candidates[-1]} on {host}; choose another port")


def _bind(family: socket.AddressFamily, address: str, port: int) -> int:
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if os.name == "posix":  # as the server does: a port that was just closed is free
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((address, port))
        return int(probe.getsockname()[1])
