"""``operator.json``: an ``OperatorProfile`` as a file."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Final, cast

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import ConfigError, DocumentError, brief
from smooth_operator.extras import UPGRADE
from smooth_operator.formats.jsonable import to_json
from smooth_operator.human.operator import Component, FingerProfile, OperatorProfile
from smooth_operator.io.documents import read_json
from smooth_operator.io.entries import Entries
from smooth_operator.types import as_side

FORMAT: Final = "smooth-operator operator"
VERSION: Final = 1

_MOST_BYTES: Final = 1_000_000  # it has 3 kB
_EXPECTED: Final = "expected the OPERATOR.json of `smooth-operator calibrate`"


def write_operator(path: Path, operator: OperatorProfile) -> None:
    """Write a profile atomically.

    Raises:
        OutputError: the file can't be written.
    """
    content = {"format": FORMAT, "version": VERSION, **_fields(operator)}
    content["fingers"] = {
        finger.name: {k: v for k, v in _fields(finger).items() if k != "name"}
        for finger in operator.fingers
    }
    with atomic_write(path) as file:
        file.write(to_json(content, indent=2).encode() + b"\n")


def read_operator(path: Path) -> OperatorProfile:
    """Read a profile that ``write_operator`` wrote.

    Raises:
        ConfigError: there is no such file, it is no profile or of another version, or a field is
            missing, unknown or outside the range of a hand.
    """
    try:
        content = read_json(Path(path), most_bytes=_MOST_BYTES)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; {_EXPECTED}") from None
    except OSError as error:
        raise ConfigError(f"{path}: can't be read: {error.strerror or error}") from error
    except DocumentError as error:
        raise ConfigError(f"{path}: damaged, or no JSON ({error}); {_EXPECTED}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ConfigError(f"{path}: it describes no operator; {_EXPECTED}")
    version = content.get("version")
    if version != VERSION:
        raise ConfigError(
            f"{path}: version {brief(version)} of the format, but this program reads {VERSION}; "
            f"calibrate again, or upgrade: {UPGRADE}"
        )
    entries = Entries(str(path), content)
    with entries.name_file():
        return _profile(entries)


def _profile(entries: Entries) -> OperatorProfile:
    entries.only("format", "version", *_names(OperatorProfile))
    fingers = entries.table("fingers")
    return OperatorProfile(
        hand=entries.text("hand", lines=True),
        side=as_side(entries.text("side", lines=True)),
        scale=entries.number("scale"),
        palm_width=entries.number("palm_width"),
        palm_length=entries.number("palm_length"),
        fingers=tuple(_finger(fingers.table(name), name) for name in fingers.names),
        palm_rotation=entries.numbers("palm_rotation", 4),
        project=entries.number_or_none("project"),
        escape=entries.number_or_none("escape"),
        apply=cast("tuple[Component, ...]", tuple(entries.texts("apply"))),  # the profile checks
        source=entries.text("source", lines=True),
    )


def _finger(entries: Entries, name: str) -> FingerProfile:
    entries.only(*(field for field in _names(FingerProfile) if field != "name"))
    return FingerProfile(
        name=name,
        robot=entries.text("robot", lines=True),
        bones=entries.numbers("bones", 3),
        pinch_gap=entries.number_or_none("pinch_gap"),
        pinch_gap_after=entries.number_or_none("pinch_gap_after"),
        **{
            key: entries.number(key)
            for key in ("reach", "robot_reach", "scale", "tip_along", "tip_pad")
        },
    )


def _names(kind: Any) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(kind))


def _fields(value: Any) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
