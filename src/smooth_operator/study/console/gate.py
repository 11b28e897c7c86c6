"""Who may open which page: two tokens, of which the operator's opens the operator's page alone.

On this machine alone no token is asked for; other pages of the same browser are kept out by their
origin. Tokens are kept, since a tablet must come back by itself when the console is started again.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import hmac
import http
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import parse_qs, urlsplit

from smooth_operator.io.user_cache import OFF, SWITCH, user_cache
from smooth_operator.study.console.commands import Role
from smooth_operator.web.addresses import is_local, page_addresses
from smooth_operator.web.origin import cookie, names_this_machine, same_origin, same_secret

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

HOME: Final[Mapping[Role, str]] = {"experimenter": "/", "operator": "/operator"}
"""Where each page is."""
LINK: Final[Mapping[Role, str]] = {"experimenter": "/link", "operator": "/operator/link"}
"""Where its WebSocket is."""
OPERATORS: Final = (
    "/operator", "/operator/link", "/operator.js", "/scales.js", "/pairs.js", "/link.js", "/dom.js",
    "/console.css", "/icon.svg",
)  # fmt: skip
"""All that the operator's token opens."""


@dataclass(frozen=True)
class Gate:
    """Looks at every request.

    Attributes:
        tokens: role -> token; None where only this machine can connect.
    """

    tokens: Mapping[Role, str] | None = field(repr=False)

    def refusal(self, connection: ServerConnection, request: Request) -> Response | None:
        """A response that refuses or redirects; None to let the request pass."""
        if not same_origin(request):
            return connection.respond(
                http.HTTPStatus.FORBIDDEN, "this page may not be used from another one\n"
            )
        url = urlsplit(request.path)
        if self.tokens is None:
            if names_this_machine(request):
                return None
            return connection.respond(
                http.HTTPStatus.FORBIDDEN, "open this page as http://localhost\n"
            )
        port = connection.local_address[1]
        roles: tuple[Role, ...] = ("experimenter", "operator")
        allowed = roles if url.path in OPERATORS else roles[:1]
        if any(same_secret(cookie(request, _cookie(r, port)), self.tokens[r]) for r in allowed):
            return None
        given = parse_qs(url.query).get("token", [""])[0]
        for role in allowed:
            if same_secret(given, self.tokens[role]):
                return self._welcome(connection, role, url.path, port)
        return connection.respond(
            http.HTTPStatus.UNAUTHORIZED,
            "this page needs its token: open the whole address that the terminal, or the "
            "experimenter's page, shows\n",
        )

    def _welcome(
        self, connection: ServerConnection, role: Role, path: str, port: int
    ) -> Response | None:
        assert self.tokens is not None
        if path in LINK.values():
            return None  # a program, which has no cookies
        response = connection.respond(http.HTTPStatus.SEE_OTHER, "")
        response.headers["Location"] = path  # so that the token stays in no history
        response.headers["Set-Cookie"] = (
            f"{_cookie(role, port)}={self.tokens[role]}; Path=/; HttpOnly; SameSite=Lax"
        )
        response.headers["Cache-Control"] = "no-store"
        response.headers["Referrer-Policy"] = "no-referrer"
        return response

    def links(self, host: str, port: int) -> dict[Role, str]:
        """Address of each page, with what opens it."""
        base = page_addresses(host, port, "http")[0]
        return {
            role: base + path + ("" if self.tokens is None else f"?token={self.tokens[role]}")
            for role, path in HOME.items()
        }


def gate_for(host: str, study: str) -> Gate:
    """The gate of a console that listens on ``host``.

    Args:
        host: where it listens; tokens are asked for unless only this machine reaches it.
        study: whose tokens; the same after a restart.
    """
    if is_local(host):
        return Gate(None)
    secret = _secret()
    tokens: dict[Role, str] = {}
    for role in HOME:
        digest = hmac.new(secret, f"{role}\n{study}".encode(), hashlib.sha256).digest()
        tokens[role] = base64.urlsafe_b64encode(digest[:18]).decode()
    return Gate(tokens)


def qr_code(text: str) -> bytes:
    """A QR code as SVG, to be shown on any background."""
    import io

    import segno

    out = io.BytesIO()
    segno.make(text, error="m", micro=False).save(
        out, kind="svg", border=3, dark="#10212e", light="#ffffff", xmldecl=False, scale=4
    )
    return out.getvalue()


def _secret() -> bytes:
    """32 bytes of this user on this machine, drawn once; of this run alone if they can't be kept.

    Not in the folder of the study, which may be given away.
    """
    drawn = secrets.token_bytes(32)
    if os.environ.get(SWITCH, "").strip().lower() in OFF:
        return drawn
    file = user_cache() / "study" / "console.key"
    try:
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        _keep(file, drawn)
        if os.name == "posix" and (
            file.stat().st_mode & 0o077 or file.stat().st_uid != os.getuid()
        ):
            return drawn  # others may know it
        kept = file.read_bytes()
    except OSError:
        return drawn
    return kept if len(kept) == len(drawn) else drawn


def _keep(file: Path, content: bytes) -> None:
    """Writes a file whole, unless it is there."""
    if file.exists():
        return
    draft = file.with_name(f".{file.name}.{secrets.token_hex(4)}")
    handle = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(handle, "wb") as out:
            out.write(content)
        with contextlib.suppress(FileExistsError):
            os.link(draft, file)  # the first of two that do this at once wins
    finally:
        draft.unlink()


def _cookie(role: Role, port: Any) -> str:
    return f"smooth-operator-{role}-{port}"  # cookies know no ports
