"""Writes keys and values as TOML, for files that users may edit."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from numbers import Integral, Real
from typing import Any, Final

from smooth_operator.errors import DocumentError

_BARE_KEY: Final = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES: Final = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r"}


def toml_key(name: str) -> str:
    """Formats a key, with quotation marks if TOML needs them; DocumentError if the key contains
    half of a surrogate pair."""
    return name if _BARE_KEY.fullmatch(name) else toml_value(name)


def toml_value(value: Any) -> str:
    """Formats a value on one line; tables are inline.

    Args:
        value: a string, boolean, finite number, list, tuple or mapping.

    Raises:
        DocumentError: the value has another type, or contains a number that is not finite or half
            of a surrogate pair.
    """
    if isinstance(value, str):
        return f'"{"".join(_ESCAPES.get(c) or _character(c) for c in value)}"'
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):  # NumPy's too
        if not math.isfinite(value):
            raise DocumentError(f"a settings file can't hold the number {value}")
        return repr(float(value))  # shortest text that reads back as the same number
    if isinstance(value, Mapping):
        items = ", ".join(f"{toml_key(str(k))} = {toml_value(v)}" for k, v in value.items())
        return f"{{ {items} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    raise DocumentError(f"a settings file can't hold {value!r}")


def _character(character: str) -> str:
    if 0xD800 <= ord(character) <= 0xDFFF:  # in file names whose bytes are not UTF-8
        raise DocumentError(f"a settings file can't hold the character {character!r}")
    return character if character.isprintable() else f"\\U{ord(character):08X}"
