"""JSON and TOML of other authors, parsed within bounds.

The parsers of the standard library accept texts that later break what reads them: brackets nested
until the stack ends, whole numbers of thousands of digits that no float holds, dotted keys that
take minutes. Every document that a user, a file or a network gives goes through here, so that a
reader has one error to expect, ``DocumentError``.
"""

from __future__ import annotations

import json
import re
import stat
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import DocumentError

MOST_BYTES: Final = 8_000_000
"""Longest text that is parsed, where the caller sets no other bound."""

MOST_LEVELS: Final = 64
"""Levels of lists and tables within each other. The documents of this package have six."""

MOST_DIGITS: Final = 20
"""Digits of a whole number; those of 64 bits have no more."""

_MOST_DOTS: Final = 1000  # in one line of TOML; the parser's time grows with their square
_BRACKETS: Final = b"[]{}"
_NO_BRACKETS: Final = bytes(byte for byte in range(256) if byte not in _BRACKETS)
_TEXTS: Final = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+"?', re.DOTALL)


def check_plain_file(path: Path) -> int:
    """The size of a plain file in bytes; links are followed.

    Opening a pipe would wait for a writer, perhaps for ever.

    Raises:
        OSError: there is no such file, or it can't be looked at.
        DocumentError: it is a folder, a pipe, a socket or a device.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
        kind = kinds.get(stat.S_IFMT(status.st_mode), "a device")
        raise DocumentError(f"it is {kind}, not a plain file")
    return status.st_size


def read_text(path: Path, *, most_bytes: int = MOST_BYTES) -> str:
    """The text of a plain file in UTF-8; a byte order mark is dropped.

    Raises:
        OSError: there is no such file, or it can't be read.
        DocumentError: it is not a plain file, longer than ``most_bytes``, or not UTF-8.
    """
    size = check_plain_file(path)
    with path.open("rb") as stream:
        data = b"" if size > most_bytes else stream.read(most_bytes + 1)
    if size > most_bytes or len(data) > most_bytes:
        raise DocumentError(f"it has {max(size, len(data))} bytes, more than {most_bytes}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DocumentError(f"it is not text in UTF-8: {error}") from error


def parse_json(text: str | bytes, *, most_bytes: int = MOST_BYTES) -> Any:
    """The value of a JSON text.

    Args:
        text: as text, or as bytes in UTF-8.
        most_bytes: largest size [bytes].

    Raises:
        DocumentError: it is no JSON, too long, nested deeper than ``MOST_LEVELS``, or has a
            whole number of more than ``MOST_DIGITS`` digits, or half a character.
    """
    try:
        data = text if isinstance(text, bytes) else text.encode()
        if len(data) > most_bytes:
            raise DocumentError(f"it has {len(data)} bytes, more than {most_bytes}")
        # From bytes, since a text that has been cut may end within a character.
        value = _DECODER.decode(data.decode("utf-8-sig"))
        if b"\\ud" in data or b"\\uD" in data:
            json.dumps(value, ensure_ascii=False).encode()  # fails at half a surrogate pair
    except DocumentError:
        raise
    except RecursionError as error:
        raise _too_deep() from error
    except ValueError as error:  # bad UTF-8 too
        raise DocumentError(str(error) if len(str(error)) < 200 else "damaged text") from error
    if _deeper(data):
        raise _too_deep()
    return value


def json_object(text: str | bytes) -> dict[str, Any] | None:
    """The fields of a message that should be a JSON object; None if it is none.

    Args:
        text: as ``parse_json``.
    """
    try:
        value = parse_json(text)
    except DocumentError:
        return None
    return value if isinstance(value, dict) else None


def read_json(path: Path, *, most_bytes: int = MOST_BYTES) -> Any:
    """The value of a JSON file.

    Raises:
        OSError: there is no such file, or it can't be read.
        DocumentError: as ``read_text`` and ``parse_json``.
    """
    return parse_json(read_text(path, most_bytes=most_bytes), most_bytes=most_bytes)


def parse_toml(text: str) -> dict[str, Any]:
    """The table of a TOML text.

    Raises:
        DocumentError: it is no TOML, or is beyond a bound as with ``parse_json``.
    """
    if any(line.count(".") > _MOST_DOTS for line in text.split("\n")):
        raise DocumentError(f"a line has more than {_MOST_DOTS} dots")
    try:
        table = tomllib.loads(text)
    except RecursionError as error:
        raise _too_deep() from error
    except ValueError as error:  # TOMLDecodeError; and a number of thousands of digits
        raise DocumentError(str(error) if len(str(error)) < 200 else "damaged text") from error
    for level, value in _values(table):
        if level > MOST_LEVELS:
            raise _too_deep()
        if isinstance(value, int) and abs(value) >= 10**MOST_DIGITS:
            raise DocumentError(f"a whole number has more than {MOST_DIGITS} digits")
    return table


def read_toml(path: Path, *, most_bytes: int) -> dict[str, Any]:
    """The table of a TOML file.

    Raises:
        OSError: there is no such file, or it can't be read.
        DocumentError: as ``read_text`` and ``parse_toml``.
    """
    return parse_toml(read_text(path, most_bytes=most_bytes))


def _whole(digits: str) -> int:
    if len(digits.lstrip("-")) > MOST_DIGITS:
        raise DocumentError(f"a whole number has {len(digits)} digits, more than {MOST_DIGITS}")
    return int(digits)


_DECODER: Final = json.JSONDecoder(parse_int=_whole)


def _deeper(data: bytes) -> bool:
    """True if the brackets of a well-formed JSON text are nested too deep."""
    brackets = data.translate(None, _NO_BRACKETS)
    if brackets.count(b"[") + brackets.count(b"{") <= MOST_LEVELS:
        return False
    # Brackets within texts may not match each other; without texts, all do.
    return _left(brackets) and _left(_TEXTS.sub(b"", data).translate(None, _NO_BRACKETS))


def _left(brackets: bytes) -> bool:
    """True if pairs are left after removing the innermost ones ``MOST_LEVELS`` times."""
    for _ in range(MOST_LEVELS):
        if not brackets:
            return False
        brackets = brackets.replace(b"[]", b"").replace(b"{}", b"")
    return bool(brackets)


def _values(table: dict[str, Any]) -> Iterator[tuple[int, Any]]:
    """(level, value) of all that a table holds; without recursion, which may end the stack."""
    left: list[tuple[int, Any]] = [(1, table)]
    while left:
        level, value = left.pop()
        yield level, value
        if level > MOST_LEVELS:
            continue
        if isinstance(value, dict):
            left += [(level + 1, child) for child in value.values()]
        elif isinstance(value, list):
            left += [(level + 1, child) for child in value]


def _too_deep() -> DocumentError:
    return DocumentError(f"it has more than {MOST_LEVELS} levels of lists and tables")
