"""Hands and settings as JSON and back: what a helper process is given to compile.

Only numbers, texts, paths, arrays, containers of them and the dataclasses and enums of this package
are written, and only those classes are made when it is read. ``to_json`` of ``formats`` is for
people: it drops the classes.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from smooth_operator.errors import ConfigError
from smooth_operator.result_cache.code import HOME

_SEQUENCES: dict[str, Any] = {
    "tuple": tuple,
    "list": list,
    "set": set,
    "frozenset": frozenset,
}


def as_plain(value: Any) -> Any:
    """A value as JSON's own kinds.

    Raises:
        ConfigError: it holds something else, such as a function or a class of the user's.
    """
    if isinstance(value, enum.Enum):  # before int: an IntEnum is one
        return {"enum": _name(type(value)), "member": value.name}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.generic):
        return {"array": value.item(), "dtype": value.dtype.str}
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return {"array": value.tolist(), "dtype": value.dtype.str}
    if isinstance(value, PurePath):
        return {"path": str(value)}
    if isinstance(value, Mapping):
        return {"pairs": [[as_plain(key), as_plain(each)] for key, each in value.items()]}
    kind = type(value)
    if kind.__name__ in _SEQUENCES and kind is _SEQUENCES[kind.__name__]:
        return {"items": [as_plain(each) for each in value], "kind": kind.__name__}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [field.name for field in dataclasses.fields(value) if field.init]
        return {"of": _name(kind), "fields": {f: as_plain(getattr(value, f)) for f in fields}}
    raise ConfigError(f"a {kind.__qualname__} can't be given to another process as data")


def from_plain(said: Any) -> Any:
    """The value that ``as_plain`` was given.

    Raises:
        ConfigError: it names a class that is not this package's.
    """
    if not isinstance(said, dict):
        return said
    if "enum" in said:
        return _class(said["enum"])[said["member"]]
    if "array" in said:
        array = np.array(said["array"], said["dtype"])
        return array if array.ndim else array[()]
    if "path" in said:
        return Path(said["path"])
    if "pairs" in said:
        return {from_plain(key): from_plain(each) for key, each in said["pairs"]}
    if "items" in said:
        return _SEQUENCES[said["kind"]](from_plain(each) for each in said["items"])
    return _class(said["of"])(**{name: from_plain(v) for name, v in said["fields"].items()})


def _name(kind: type) -> str:
    if kind.__module__.partition(".")[0] != HOME.name:
        raise ConfigError(f"{kind.__qualname__} of {kind.__module__} is not of this package")
    return f"{kind.__module__}:{kind.__qualname__}"


def _class(name: str) -> Any:
    module, _, path = name.partition(":")
    if module.partition(".")[0] != HOME.name:
        raise ConfigError(f"{module} is not of this package")
    found: Any = import_module(module)
    for part in path.split("."):
        found = getattr(found, part)
    if not isinstance(found, type) or not (
        dataclasses.is_dataclass(found) or issubclass(found, enum.Enum)
    ):
        raise ConfigError(f"{name} is neither a dataclass nor an enum")
    return found
