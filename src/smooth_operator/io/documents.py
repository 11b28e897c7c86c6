"""Parses untrusted JSON within the limits of ``plain_files``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import DocumentError
from smooth_operator.io.plain_files import MOST_BYTES, MOST_DIGITS, MOST_LEVELS, read_text, too_deep


def parse_json(text: str | bytes, *, most_bytes: int = MOST_BYTES) -> Any:
    """Parses a JSON text.

    Args:
        text: string, or bytes in UTF-8.
        most_bytes: largest size [bytes].

    Raises:
        DocumentError: the text is not JSON, is too long, is nested deeper than ``MOST_LEVELS``, has
            a whole number of more than ``MOST_DIGITS`` digits, or has an incomplete character.
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
        raise too_deep() from error
    except ValueError as error:  # bad UTF-8 too
        raise DocumentError(str(error) if len(str(error)) < 200 else "damaged text") from error
    if data.count(b"[") + data.count(b"{") > MOST_LEVELS and _deeper(value):
        raise too_deep()
    return value


def json_object(text: str | bytes) -> dict[str, Any] | None:
    """Parses a message that should be a JSON object; None if it is something else.

    Args:
        text: as for ``parse_json``.
    """
    try:
        value = parse_json(text)
    except DocumentError:
        return None
    return value if isinstance(value, dict) else None


def read_json(path: Path, *, most_bytes: int = MOST_BYTES) -> Any:
    """Reads a JSON file.

    Raises:
        OSError: there is no such file, or it can't be read.
        DocumentError: as ``read_text`` and ``parse_json``.
    """
    return parse_json(read_text(path, most_bytes=most_bytes), most_bytes=most_bytes)


def _whole(digits: str) -> int:
    if len(digits.lstrip("-")) > MOST_DIGITS:
        raise DocumentError(f"a whole number has {len(digits)} digits, more than {MOST_DIGITS}")
    return int(digits)


_DECODER: Final = json.JSONDecoder(parse_int=_whole)


def _deeper(value: Any) -> bool:
    """True if lists and tables are nested too deep; without recursion, which could exhaust the
    stack."""
    level = [value]
    for _ in range(MOST_LEVELS):
        holders = [each for each in level if isinstance(each, list | dict)]
        level = [
            child
            for each in holders
            for child in (each.values() if isinstance(each, dict) else each)
        ]
    return any(isinstance(each, list | dict) for each in level)
