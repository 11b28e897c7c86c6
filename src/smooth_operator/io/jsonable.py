"""Converts a resolved configuration to JSON that any parser can read."""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import os
from collections.abc import Mapping, Set
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError


def to_json(value: Any, *, indent: int | None = None) -> str:
    """Converts dataclasses, enums, paths, NumPy values and plain containers to strict JSON.

    Non-finite numbers, which JSON can't represent, become the strings ``"nan"``, ``"inf"`` and
    ``"-inf"``, which ``float`` reads back. Enums become their names, tuples and arrays lists.

    Args:
        indent: spaces per level; None for one line.

    Returns:
        The JSON text.

    Raises:
        ConfigError: a value has no JSON form (a function, an open file).
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
    """Converts a row of numbers for JSON messages; numbers that are not finite become null."""
    row: list[float | None] = array.tolist()
    if np.isfinite(array).all():
        return row
    return [None if x is None or not math.isfinite(x) else x for x in row]
