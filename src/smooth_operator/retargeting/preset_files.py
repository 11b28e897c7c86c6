"""Reads and changes settings of a method by name, such as ``objective.pose_weight``, and reads
preset files.

A preset file is a preset of a method with some of its numbers changed, as a small TOML file::

    format = 1
    method = "sbr"
    base = "realtime"

    [settings]
    "objective.pose_weight" = 0.031

    [made]                       # optional: how the values were found
    by = "a search with Optuna"

The file can be used in place of the name of a preset: ``--method sbr --preset mine.toml``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar, cast

from smooth_operator.errors import ConfigError, UnknownNameError, brief
from smooth_operator.io.entries import read_entries
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.presets import PRESETS, preset_config
from smooth_operator.retargeting.registry import DEFAULT_METHOD

C = TypeVar("C")

MOST_WHOLE: Final = 1 << 20
"""Largest number of samples, cycles, rounds and similar that can be set by name."""
MOST_SEED: Final = (1 << 32) - 1


def numeric_settings(config: object) -> dict[str, float | int]:
    """All numbers in a configuration by path, which is the names of the fields joined by dots.

    Args:
        config: a dataclass, with dataclasses in its fields. Dataclasses in a tuple are named by
            their index: ``objective.terms.0.weight`` is a setting of the first added term.

    Returns:
        mapping from path to value, in the order of the fields, without booleans.
    """
    return dict(_numbers(config, ""))


def with_settings(config: C, values: Mapping[str, float | int]) -> C:
    """Returns a configuration with changed values.

    Args:
        values: mapping from path to value; values of integer fields are rounded.

    Raises:
        UnknownNameError: there is no such setting.
        ConfigError: a value is invalid, alone or in combination with others.
    """
    settings = numeric_settings(config)
    for path in values:
        if path not in settings:
            raise UnknownNameError("setting", path, settings)
    whole = {path for path, value in settings.items() if isinstance(value, int)}
    for path in whole & values.keys():
        most = MOST_SEED if path.endswith("seed") else MOST_WHOLE
        if not abs(values[path]) <= most:  # NaN too
            raise ConfigError(f"setting {path!r} can be at most {most}, not {values[path]:g}")
    rounded = {path: round(v) if path in whole else float(v) for path, v in values.items()}
    return cast(C, _replaced(config, rounded))


def _numbers(config: object, prefix: str) -> Iterator[tuple[str, float | int]]:
    for name, value in _parts(config).items():
        if isinstance(value, float | int) and not isinstance(value, bool):
            yield f"{prefix}{name}", value
        else:
            yield from _numbers(value, f"{prefix}{name}.")


def _parts(config: Any) -> dict[str, Any]:
    """Maps fields of a dataclass to values, and indices of a tuple to its dataclasses."""
    if isinstance(config, tuple):
        return {str(i): one for i, one in enumerate(config) if _is_settings(one)}
    if not _is_settings(config):
        return {}
    return {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}


def _is_settings(value: object) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def _replaced(config: Any, values: Mapping[str, float | int]) -> Any:
    changes: dict[str, Any] = {}
    inner: dict[str, dict[str, float | int]] = {}
    for path, value in values.items():
        name, dot, rest = path.partition(".")
        if dot:
            inner.setdefault(name, {})[rest] = value
        else:
            changes[name] = value
    parts = _parts(config)
    for name, below in inner.items():
        changes[name] = _replaced(parts[name], below)
    if isinstance(config, tuple):
        return tuple(changes.get(str(i), one) for i, one in enumerate(config))
    return dataclasses.replace(config, **changes)


FORMAT: Final = 1

_MOST_BYTES = 1_000_000


@dataclass(frozen=True)
class PresetFile:
    """Content of a preset file.

    Attributes:
        method: name of the method.
        base: name of the preset that it changes.
        settings: path of a setting -> its value.
        made: origin of the values; text, numbers, and lists and tables of them.
    """

    method: str
    base: str
    settings: Mapping[str, float | int]
    made: Mapping[str, Any] = field(default_factory=dict)


def read_preset_file(path: Path) -> PresetFile:
    """Reads a preset file; ConfigError if the file does not exist or is not a preset file."""
    entries = read_entries(path, "preset file", most_bytes=_MOST_BYTES)
    entries.check_format(FORMAT)
    entries.only("format", "method", "base", "settings", "made")
    settings = entries.table("settings", {})
    for name in settings.names:
        settings.number(name)
    return PresetFile(
        entries.text("method", empty=False),
        entries.text("base", empty=False),
        settings.values,
        entries.table("made", {}).values,
    )


SUFFIX: Final = ".toml"


def method_config(method: str = DEFAULT_METHOD, preset: str | None = None) -> MethodConfig:
    """Configuration of a method, given by the name of a preset or by a preset file.

    Args:
        method: name of the method, or ``package.module:attribute``: a configuration, its class, or
            presets by name.
        preset: name of a preset, such as ``published``; path of a preset file (``.toml``); for
            geort also path of a trained model. None gives the method's default preset.

    Raises:
        UnknownNameError: there is no such method, preset or setting.
        ConfigError: the preset file is invalid or for another method, or the method of a plugin
            can't be loaded.
    """
    if not isinstance(preset, str) or not preset.endswith(SUFFIX) or preset in PRESETS[method]:
        return preset_config(method, preset)
    file = read_preset_file(Path(preset))
    if file.method != method:
        raise ConfigError(
            f"{preset} is a preset of method {brief(file.method)}, not of {method!r}: also "
            "choose that method"
        )
    if file.base.endswith(SUFFIX):
        raise ConfigError(
            f"{preset}: its base must be the name of a preset, not {brief(file.base)}"
        )
    return with_settings(preset_config(method, file.base), file.settings)
