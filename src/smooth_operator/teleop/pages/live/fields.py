"""Fields of a configuration that the page can change, with their ranges."""

from __future__ import annotations

import dataclasses
import inspect
import re
import types
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from smooth_operator.errors import ConfigError

Kind = Literal["number", "whole", "switch", "choice", "optional", "numbers", "path", "shown"]
"""``number``, ``whole``, ``switch`` and ``choice`` speak for themselves; ``optional`` is a number
or None; ``numbers`` and ``path`` are typed in; ``shown`` can't be changed here."""

_STEPS: Final = 100  # of a slider, about
_AROUND_NOTHING: Final = {"m": 0.05, "rad": 0.5}
"""Unit -> upper end of the slider of a field whose default is 0."""


@dataclass(frozen=True)
class ConfigField:
    """A field of a configuration, or of a part of it.

    Attributes:
        path: names from the top, with dots: ``objective.targets.project``.
        kind: see ``Kind``.
        value: as JSON has it; of an ``optional`` None or a number.
        low, high, step: of numbers; the range is around the default, and what the configuration
            refuses by itself is left out.
        choices: of a ``choice``.
        doc: what it is, from the docstring of its class.
    """

    path: str
    kind: Kind
    value: Any
    low: float = 0.0
    high: float = 0.0
    step: float = 0.0
    choices: tuple[str, ...] = ()
    doc: str = ""


def config_fields(config: Any, default: Any | None = None) -> list[ConfigField]:
    """All fields of a configuration, those of its parts included.

    Args:
        config: a dataclass, nested as one likes.
        default: the same kind of configuration, whose values set the ranges; itself if left out.
    """
    default = config if default is None else default
    return [
        _field(path, hint, value, _get(default, path), default, doc)
        for path, hint, value, doc in _leaves(config, "")
    ]


def changed(config: Any, path: str, value: Any) -> Any:
    """The configuration with one field changed.

    Args:
        config: a dataclass.
        path: as ``ConfigField.path``.
        value: as JSON has it; text for ``numbers`` and ``path``.

    Raises:
        ConfigError: there is no such field, or it can't have that value.
    """
    name, _, rest = path.partition(".")
    known = {f.name for f in dataclasses.fields(config)}
    if name not in known:
        raise ConfigError(f"there is no setting {name!r}; there are {', '.join(sorted(known))}")
    if rest:
        value = changed(getattr(config, name), rest, value)
    else:
        value = _read(name, get_type_hints(type(config))[name], value)
    return dataclasses.replace(config, **{name: value})


def field_docs(kind: type) -> dict[str, str]:
    """Field -> what its class's docstring says of it under ``Attributes:``."""
    # Python 3.13 removes a docstring's indentation itself
    text = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:")[2]
    docs: dict[str, str] = {}
    for entry in re.split(r"\n {4}(?=\w)", text.split("\n\n")[0]):
        names, sign, words = entry.strip().partition(":")
        if sign:
            docs |= dict.fromkeys((n.strip() for n in names.split(",")), " ".join(words.split()))
    return docs


def _leaves(config: Any, prefix: str) -> list[tuple[str, Any, Any, str]]:
    hints, docs = get_type_hints(type(config)), field_docs(type(config))
    leaves = []
    for field in dataclasses.fields(config):
        if not field.init:
            continue
        value, path = getattr(config, field.name), prefix + field.name
        # A union with None is one value: an operator comes from a calibration, not from sliders.
        if dataclasses.is_dataclass(value) and type(None) not in get_args(hints[field.name]):
            leaves += _leaves(value, f"{path}.")
        else:
            leaves.append((path, hints[field.name], value, docs.get(field.name, "")))
    return leaves


def _field(path: str, hint: Any, value: Any, usual: Any, default: Any, doc: str) -> ConfigField:
    kind = _kind(hint)
    if kind in ("number", "whole", "optional"):
        unit = re.search(r"\[(m|rad)\]", doc)
        low, high, step = _range(path, kind, usual, default, unit.group(1) if unit else "")
        return ConfigField(path, kind, value, low, high, step, doc=doc)
    if kind == "choice":
        return ConfigField(path, kind, value, choices=tuple(map(str, _choices(hint))), doc=doc)
    if kind == "numbers":
        return ConfigField(path, kind, ", ".join(f"{v:g}" for v in value), doc=doc)
    if kind == "switch":
        return ConfigField(path, kind, value, doc=doc)
    if kind == "path":
        return ConfigField(path, kind, "" if value is None else str(value), doc=doc)
    return ConfigField(path, "shown", _words(value), doc=doc)


def _kind(hint: Any) -> Kind:
    options = _options(hint)
    real = [option for option in options if option is not type(None)]
    if len(real) != 1:
        return "shown"
    (one,) = real
    kinds: Mapping[Any, Kind] = {float: "number", int: "whole", bool: "switch", Path: "path"}
    if type(None) in options:
        return "optional" if one is float else "path" if one is Path else "shown"
    if get_origin(one) is Literal:
        return "choice"
    if get_origin(one) is tuple and {*get_args(one)} <= {float, ...}:
        return "numbers"
    return kinds.get(one, "shown")


def _range(
    path: str, kind: Kind, usual: Any, default: Any, unit: str
) -> tuple[float, float, float]:
    """(low, high, step) of a slider."""
    if kind == "whole":
        top = max(4 * abs(int(usual)), 8)
        high = next((h for h in (top, 2 * abs(usual)) if _possible(default, path, h)), usual)
        lows = (-top if usual < 0 else 0, 1, usual // 4, usual // 2)
        low = next((x for x in lows if _possible(default, path, x)), usual)
        return float(low), float(high), 1.0
    if path.endswith("yaw"):  # a direction: all the way round
        return -3.2, 3.2, 0.05
    base = 1.0 if usual is None else abs(float(usual))
    nothing = _AROUND_NOTHING.get(unit, 1.0)
    # a share goes up to 1, whatever its default
    tops = {4 * base, 2 * base, 1.5 * base, base, *([1.0] if base < 1.0 < 4 * base else [])}
    highs = map(_neat, sorted(tops, reverse=True) if base else [nothing])
    high = next((top for top in highs if _possible(default, path, top)), base)
    step = float(10.0 ** np.floor(np.log10(high / _STEPS) + 0.4))
    low = -high if usual is not None and usual < 0 else 0.0
    if not _possible(default, path, low):
        low = step
    return low, max(high, low + step), step


def _possible(config: Any, path: str, value: float) -> bool:
    try:
        changed(config, path, value)
    except ConfigError:
        return False
    return True


def _neat(value: float) -> float:
    return float(f"{value:.3g}")


def _read(name: str, hint: Any, value: Any) -> Any:
    """A value from JSON as the field's type has it."""
    kind = _kind(hint)
    try:
        if kind == "switch" and isinstance(value, bool):
            return value
        if kind == "whole" and not isinstance(value, bool) and float(value) == int(value):
            return int(value)
        if kind == "number" or (kind == "optional" and value is not None):
            return _finite(value)
        if kind == "optional":
            return None
        if kind == "choice":
            return next(choice for choice in _choices(hint) if str(choice) == value)
        if kind == "numbers":
            return tuple(_finite(part) for part in str(value).split(",") if part.strip())
        if kind == "path":
            return Path(value) if value else None
    except (TypeError, ValueError, StopIteration):
        pass
    raise ConfigError(f"{name} can't be {value!r}")


def _finite(value: Any) -> float:
    if isinstance(value, bool) or not np.isfinite(number := float(value)):
        raise ValueError(value)
    return number


def _options(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)


def _choices(hint: Any) -> tuple[Any, ...]:
    return get_args(next(o for o in _options(hint) if o is not type(None)))


def _get(config: Any, path: str) -> Any:
    for name in path.split("."):
        config = getattr(config, name)
    return config


def _words(value: Any) -> str:
    """What a field that can't be changed says: an operator's source, or numbers with names."""
    if value is None or value == ():
        return "none"
    if source := getattr(value, "source", None):
        return f"calibrated on {source}"
    if isinstance(value, tuple) and all(isinstance(v, tuple) and len(v) == 2 for v in value):
        return ", ".join(f"{name} {number:.3g}" for name, number in value)
    return str(value)[:80]
