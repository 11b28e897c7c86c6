"""Values as text: strict JSON of configurations, TOML of settings files, CSV of tables."""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence, Set
from numbers import Integral, Real
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, DocumentError


def to_json(value: Any, *, indent: int | None = None) -> str:
    """Write dataclasses, enums, paths, NumPy values and plain containers as strict JSON.

    Non-finite numbers, which JSON has no word for, become the strings ``"nan"``, ``"inf"`` and
    ``"-inf"``, which ``float`` reads back. Enums become their names, tuples and arrays lists.

    Args:
        indent: spaces per level; None for one line.

    Returns:
        The JSON text.

    Raises:
        ConfigError: for a value that has no such form (a function, an open file).
    """
    return json.dumps(_plain(value, "configuration"), indent=indent, allow_nan=False)


def _plain(value: Any, where: str) -> Any:
    if isinstance(value, enum.Enum):  # before int: an IntEnum is one, and its name says more
        return value.name
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {f.name: _plain(getattr(value, f.name), f"{where}.{f.name}") for f in fields}
    if isinstance(value, Mapping):
        return {_key(k): _plain(v, f"{where}.{k}") for k, v in value.items()}
    if isinstance(value, Set):
        return sorted((_plain(v, where) for v in value), key=repr)
    if isinstance(value, (list, tuple)):
        return [_plain(v, f"{where}[{i}]") for i, v in enumerate(value)]
    if isinstance(value, np.generic):
        return _plain(value.item(), where)
    if isinstance(value, os.PathLike):
        return str(os.fspath(value))
    if hasattr(value, "__array__"):  # NumPy's and JAX's
        array = np.asarray(value)
        if not array.dtype.hasobject:
            return _plain(array.tolist(), where)
    raise ConfigError(
        f"{where} is a {type(value).__name__}, which can't be written as JSON; expected numbers, "
        "strings, lists, mappings, arrays, enums, paths or dataclasses of these"
    )


def _key(key: Any) -> str:
    return key.name if isinstance(key, enum.Enum) else str(key)


def numbers(array: Float[np.ndarray, " k"]) -> list[float | None]:
    """A row of numbers as messages in JSON have them, in which one that is not finite is null."""
    row: list[float | None] = array.tolist()
    if np.isfinite(array).all():
        return row
    return [None if x is None or not math.isfinite(x) else x for x in row]


_BARE_KEY: Final = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES: Final = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r"}


def toml_key(name: str) -> str:
    """A key, in quotation marks where TOML needs them.

    Raises:
        DocumentError: it holds half of a surrogate pair.
    """
    return name if _BARE_KEY.fullmatch(name) else toml_value(name)


def toml_value(value: Any) -> str:
    """A value on one line; tables are inline.

    Args:
        value: a text, truth value, finite number, list, tuple or mapping.

    Raises:
        DocumentError: it holds something else, a number that is not finite, or half of a
            surrogate pair.
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


_FORMULA: Final = re.compile(r"'*[=+\-@\t\r\n＝＋－＠]")
"""Beginnings that a spreadsheet takes for a formula, whatever quotes stand around the cell."""
_QUOTED: Final = re.compile(r'[",\r\n]')
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|-?inf")


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """A table, with a header.

    Text that a spreadsheet would calculate (``=HYPERLINK(...)``, ``-1+cmd|...``) gets an apostrophe
    before it, which ``plain_cell`` takes away again. Numbers stay as they are.

    Args:
        rows: values by column; other keys are left out, and missing ones empty.
    """
    lines = [columns, *([row.get(name) for name in columns] for row in rows)]
    return "".join(f"{','.join(map(_cell, line))}\n" for line in lines)


def plain_cell(text: str) -> str:
    """A cell that was read, as it was before ``csv_text`` wrote it."""
    return text[1:] if text.startswith("'") and _runs(text[1:]) else text


def _cell(value: Any) -> str:
    text = "" if value is None else str(value)
    if isinstance(value, str) and _runs(text):
        text = f"'{text}"
    # Python's own writer leaves a carriage return bare, which ends the row for a reader.
    return '"{}"'.format(text.replace('"', '""')) if _QUOTED.search(text) else text


def _runs(text: str) -> bool:
    return _FORMULA.match(text) is not None and _NUMBER.fullmatch(text) is None
