"""Preset files: a preset of a method with some of its numbers changed, as a small TOML file.

::

    format = 1
    method = "sbr"
    base = "realtime"

    [settings]
    "objective.pose_weight" = 0.031

    [made]                       # optional: how it was found, for a person
    by = "smooth-operator tune"

The file stands wherever the name of a preset does: ``--method sbr --preset mine.toml``.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import ConfigError
from smooth_operator.io.atomic import atomic_write
from smooth_operator.io.entries import read_entries

FORMAT: Final = 1
SUFFIX: Final = ".toml"

_MOST_BYTES = 1_000_000
_BARE = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class PresetFile:
    """What a preset file says.

    Attributes:
        method: name of the method.
        base: name of the preset that it changes.
        settings: path of a setting -> its value.
        made: how it was found; text, numbers, and lists and tables of them.
    """

    method: str
    base: str
    settings: Mapping[str, float | int]
    made: Mapping[str, Any] = field(default_factory=dict)


def read_preset_file(path: Path) -> PresetFile:
    """Reads a preset file.

    Raises:
        ConfigError: there is none, or it is something else; the message says what is expected.
    """
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


def write_preset_file(path: Path, preset: PresetFile) -> None:
    """Writes a preset file, whole or not at all.

    Raises:
        OutputError: it can't be written.
        ConfigError: ``made`` holds what TOML can't.
    """
    lines = [
        f"format = {FORMAT}",
        f"method = {_value(preset.method)}",
        f"base = {_value(preset.base)}",
        "",
        "[settings]",
        *(f"{_key(name)} = {_value(value)}" for name, value in preset.settings.items()),
    ]
    if preset.made:
        lines += ["", "[made]"]
        lines += [f"{_key(name)} = {_value(value)}" for name, value in preset.made.items()]
    with atomic_write(path) as file:
        file.write("\n".join([*lines, ""]).encode())


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else _value(name)


def _value(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)  # a TOML string, escapes and all
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float) and math.isfinite(value):
        return repr(value)  # with a point or an exponent, and so a float again
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    raise ConfigError(f"a preset file can't hold {value!r}")
