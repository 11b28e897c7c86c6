"""Opening and closing a viser server, and a browser to look at it: what every page here does."""

from __future__ import annotations

import contextlib
import os
import sys
import webbrowser
from collections.abc import Iterator

import rich
import viser

from smooth_operator.ui.ports import free_port


def open_server(host: str, port: int) -> viser.ViserServer:
    """A server on the first free port, without a word on standard output.

    Args:
        host: address to listen on.
        port: first port to try; 0 for any free one.

    Raises:
        ConfigError: if the address is not one of this machine's, or no port is free.
    """
    port = free_port(host, port)
    with _quiet_viser():
        return viser.ViserServer(host=host, port=port, verbose=False)


def close_server(server: viser.ViserServer) -> None:
    """Closes the port."""
    with _quiet_viser():
        server.stop()


def page_url(host: str, port: int) -> str:
    """Address of a page for a browser on this machine."""
    host = "localhost" if host in ("0.0.0.0", "::") else host
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def open_page(url: str) -> None:
    """Opens a page in the browser, where there is a desktop to open it on."""
    if has_desktop():
        webbrowser.open(url)


def has_desktop() -> bool:
    """Whether a browser would open a window."""
    # without a display, webbrowser starts a text browser that takes over the terminal
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@contextlib.contextmanager
def _quiet_viser() -> Iterator[None]:
    # viser announces itself on standard output through rich's global console, which is ours
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
