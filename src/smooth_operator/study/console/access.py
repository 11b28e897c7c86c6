"""Token authentication: the operator's token opens the operator's page alone.

On this machine alone no token is asked for; other pages of the same browser are kept out by their
origin. Tokens are kept, since a tablet must come back by itself when the console is started again.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import hmac
import os
import secrets
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from smooth_operator.errors import DocumentError
from smooth_operator.result_cache.own_files import make_private, read_own_file
from smooth_operator.result_cache.user_cache import OFF, SWITCH, user_cache
from smooth_operator.study.console.commands import Role
from smooth_operator.web.addresses import is_local, page_addresses
from smooth_operator.web.auth import TokenAuth

HOME: Final[Mapping[Role, str]] = {"experimenter": "/", "operator": "/operator"}
"""Path of each page."""
LINK: Final[Mapping[Role, str]] = {"experimenter": "/link", "operator": "/operator/link"}
"""Path of each page's WebSocket."""
OPERATORS: Final = (
    "/operator", "/operator/link", "/operator.js", "/tlx.js", "/form.js",
    "/link.js", "/dom.js", "/console.css", "/icon.svg",
)  # fmt: skip
"""All that the operator's token opens."""


@dataclass(frozen=True)
class ConsoleAuth(TokenAuth):
    """Asks for the token of a page's role; the operator's opens the operator's page alone."""

    paths: Mapping[str, Collection[str]] = field(default_factory=lambda: {"operator": OPERATORS})
    shown_by: str = "the terminal, or the experimenter's page,"

    def links(self, host: str, port: int) -> dict[Role, str]:
        """Address of each page, with what opens it."""
        base = page_addresses(host, port, "http")[0]
        return {
            role: base + path + ("" if self.tokens is None else f"?token={self.tokens[role]}")
            for role, path in HOME.items()
        }


def auth_for(host: str, study: str) -> ConsoleAuth:
    """The authentication of a console that listens on ``host``.

    Args:
        host: where it listens; tokens are asked for unless only this machine reaches it.
        study: whose tokens; the same after a restart.
    """
    if is_local(host):
        return ConsoleAuth(None)
    secret = _secret()
    tokens: dict[str, str] = {}
    for role in HOME:
        digest = hmac.new(secret, f"{role}\n{study}".encode(), hashlib.sha256).digest()
        tokens[role] = base64.urlsafe_b64encode(digest[:18]).decode()
    return ConsoleAuth(tokens)


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
        make_private(file.parent)
        _keep(file, drawn)
        stored = read_own_file(file, len(drawn), secret=True)
    except (OSError, DocumentError):  # others may know it
        return drawn
    return stored if len(stored) == len(drawn) else drawn


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
            os.link(draft, file)  # the first of two that do this in parallel wins
    finally:
        draft.unlink()
