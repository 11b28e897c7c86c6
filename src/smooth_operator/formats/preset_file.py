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

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from smooth_operator.io.entries import read_entries

FORMAT: Final = 1
SUFFIX: Final = ".toml"

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
