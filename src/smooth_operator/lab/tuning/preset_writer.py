"""Writing of preset files (``smooth_operator.formats.preset_file``)."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import ConfigError
from smooth_operator.formats.preset_file import FORMAT, PresetFile

_BARE = re.compile(r"[A-Za-z0-9_-]+")


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
