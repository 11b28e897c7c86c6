"""A viser page and its server: start, stop, wait. Base class of the pages of this package."""

from __future__ import annotations

import atexit
import threading
from typing import Self, TypeVar

import viser

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.pages.viser_server import close_server, open_server, page_url
from smooth_operator.terminal import print_note
from smooth_operator.web.browser import open_page


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
        page: that was started.
        doing: what the printed line says before the address.
        open_browser: open the page, where there is a desktop to open it on.
        block: return only after Ctrl-C; otherwise immediately, and the caller stops the page.

    Returns:
        The page: stopped if ``block``, running otherwise.
    """
    # standard error: standard output may be a result that a program reads
    wanted = page._wanted_port
    taken = "" if wanted in (0, page.port) else f" (port {wanted} was taken)"
    print_note(f"{doing} {page.url}{taken}{'; Ctrl-C ends' if block else ''}")
    if open_browser:
        open_page(page.url)
    if block:
        try:
            page.wait()
        except KeyboardInterrupt:
            pass
        finally:
            page.stop()
    return page
