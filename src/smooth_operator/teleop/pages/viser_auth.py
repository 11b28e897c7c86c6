"""Token authentication for viser's server, which has none.

viser listens, serves its files and speaks over a WebSocket; here it answers only requests that
``smooth_operator.web.auth`` lets pass.
"""

from __future__ import annotations

import contextlib
import http
import secrets
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from viser.infra import _infra

from smooth_operator.web.addresses import is_local
from smooth_operator.web.auth import TokenAuth
from smooth_operator.web.files import shielded
from smooth_operator.web.quiet import quiet_options

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


@dataclass
class Patched:
    """Whether a server of viser was started that authenticates.

    Attributes:
        applied: False if this release of viser starts its server by other means.
    """

    applied: bool = False


@contextlib.contextmanager
def authenticated(auth: TokenAuth) -> Iterator[Patched]:
    """Servers of viser that are started in this block refuse what ``auth`` refuses.

    viser has no option for this. So the function that it starts its server with is wrapped, for
    viser alone, while it starts.

    Yields:
        Whether that worked; look at it after the start.
    """
    with _PATCHING:
        patched = Patched()
        viser: Any = _infra
        plain = viser.websockets
        server = plain.asyncio.server
        asking = _Module(server, serve=_asking(auth, patched, server.serve))
        viser.websockets = _Module(plain, asyncio=_Module(plain.asyncio, server=asking))
        try:
            yield patched
        finally:
            viser.websockets = plain


class _Module:
    """A module with some names replaced."""

    def __init__(self, module: Any, **replaced: Any) -> None:
        self._module = module
        self.__dict__.update(replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)


def _asking(auth: TokenAuth, patched: Patched, serve: Callable[..., Any]) -> Callable[..., Any]:
    def serve_and_ask(*args: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            refusal = auth.refusal(connection, request) or _not_a_client(connection, request)
            return refusal or process_request(connection, request)

        patched.applied = True
        options |= quiet_options("smooth_operator.page")
        return serve(*args, process_request=shielded(answer, _POLICY), **options)

    return serve_and_ask


def _not_a_client(connection: Any, request: Any) -> Any:
    """Refuses a WebSocket that is not of a page of viser, which would print a line for it."""
    protocols = request.headers.get_all("Sec-WebSocket-Protocol")
    if "Upgrade" not in request.headers or any("viser-v" in each for each in protocols):
        return None
    return connection.respond(http.HTTPStatus.BAD_REQUEST, "no client of this page\n")
