"""Opening and closing a viser server: what every page here does."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, Final
from weakref import WeakKeyDictionary

import rich
import viser
from viser import _messages

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.pages.ports import free_port
from smooth_operator.teleop.pages.viser_auth import auth_for, authenticated
from smooth_operator.web.addresses import lan_addresses

_TOKENS: Final[WeakKeyDictionary[viser.ViserServer, str | None]] = WeakKeyDictionary()


def open_server(host: str, port: int) -> viser.ViserServer:
    """A server on the first free port, without a word on standard output.

    Where other machines can reach it, it wants the token that is in ``page_url``.

    Args:
        host: address to listen on.
        port: first port to try; 0 for any free one.

    Raises:
        ConfigError: if the address is not one of this machine's, no port is free, or this release
            of viser can't be made to ask for the token.
    """
    port, auth = free_port(host, port), auth_for(host)
    with _quiet_viser(), authenticated(auth) as patched:
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if auth.tokens is not None and not patched.applied:
        close_server(server)
        raise ConfigError(
            f"viser {viser.__version__} can't be made to ask for a token, so the page is not "
            f"served to other machines on {host!r}; use --host 127.0.0.1, or install viser 1.1"
        )
    _TOKENS[server] = None if auth.tokens is None else auth.tokens["page"]
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
        server: of ``open_server``.
        source: JavaScript.
    """
    interface: Any = server.gui
    interface._websock_interface.queue_message(_messages.RunJavascriptMessage(source=source))


def page_url(host: str, server: viser.ViserServer) -> str:
    """Address of a page, its token included.

    Args:
        host: that it listens on; for all addresses of this machine, the one that leads to its
            network is named, which works here, too.
        server: of ``open_server``.
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
