"""Authentication by token: the operator's token opens the operator's page only.

A console that only this machine reaches asks for no token; pages of other sites in the same browser
are refused by their origin. Tokens stay the same, so that a tablet reconnects by itself when the
console is started again.
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
from smooth_operator.own_files import (
    OFF,
    SWITCH,
    make_private,
    read_own_file,
    user_cache,
)
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
"""Paths that the operator's token opens."""


@dataclass(frozen=True)
class ConsoleAuth(TokenAuth):
    """Authentication with one token for each role; the operator's opens ``OPERATORS`` only."""

    paths: Mapping[str, Collection[str]] = field(default_factory=lambda: {"operator": OPERATORS})
    shown_by: str = "the terminal, or the experimenter's page,"

    def links(self, host: str, port: int) -> dict[Role, str]:
        """Returns the address of each page with its token."""
        base = page_addresses(host, port, "http")[0]
        return {
            role: base + path + ("" if self.tokens is None else f"?token={self.tokens[role]}")
            for role, path in HOME.items()
        }


def auth_for(host: str, study: str) -> ConsoleAuth:
    """Returns the authentication of a console.

    Args:
        host: address on which the console listens; a loopback address needs no tokens.
        study: name of the study; its tokens are the same after a restart.
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
    """Returns a QR code as SVG with its own light background."""
    import io

    import segno

    out = io.BytesIO()
    segno.make(text, error="m", micro=False).save(
        out, kind="svg", border=3, dark="#10212e", light="#ffffff", xmldecl=False, scale=4
    )
    return out.getvalue()


def _secret() -> bytes:
    """32 random bytes of this user on this machine; new ones in each run if they can't be stored.

    They are not in the folder of the study, which may be given to others.
    """
    drawn = secrets.token_bytes(32)
    if os.environ.get(SWITCH, "").strip().lower() in OFF:
        return drawn
    file = user_cache() / "study" / "console.key"
    try:
        make_private(file.parent)
        _write_once(file, drawn)
        stored = read_own_file(file, len(drawn), secret=True)
    except (OSError, DocumentError):  # others may be able to read the file
        return drawn
    return stored if len(stored) == len(drawn) else drawn


def _write_once(file: Path, content: bytes) -> None:
    """Writes a file unless it exists; no reader sees a part of it."""
    if file.exists():
        return
    draft = file.with_name(f".{file.name}.{secrets.token_hex(4)}")
    handle = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(handle, "wb") as out:
            out.write(content)
        with contextlib.suppress(FileExistsError):
            os.link(draft, file)  # the first of two parallel writers wins
    finally:
        draft.unlink()
