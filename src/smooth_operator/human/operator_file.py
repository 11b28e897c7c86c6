"""``operator.json``: an ``OperatorProfile`` as a file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import (
    UPGRADE,
    ConfigError,
    DocumentError,
    SmoothOperatorError,
    brief,
    listed,
)
from smooth_operator.human.operator import FingerProfile, OperatorProfile
from smooth_operator.io.atomic import atomic_write
from smooth_operator.io.documents import read_json
from smooth_operator.io.jsonable import to_json
from smooth_operator.types import as_side

FORMAT: Final = "smooth-operator operator"
VERSION: Final = 1

_MOST_BYTES: Final = 1_000_000  # it has 3 kB
_EXPECTED: Final = "expected the OPERATOR.json of `smooth-operator calibrate`"


def write_operator(path: Path, operator: OperatorProfile) -> None:
    """Writes a profile, whole or not at all.

    Raises:
        OutputError: it can't be written.
    """
    content = {"format": FORMAT, "version": VERSION, **_fields(operator)}
    content["fingers"] = {
        finger.name: {k: v for k, v in _fields(finger).items() if k != "name"}
        for finger in operator.fingers
    }
    with atomic_write(path) as file:
        file.write(to_json(content, indent=2).encode() + b"\n")


def read_operator(path: Path) -> OperatorProfile:
    """Reads what ``write_operator`` wrote.

    Raises:
        ConfigError: no such file, no such content, a field that is missing, unknown or outside what
            a hand can be, or a newer version's file.
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
    try:
        return _profile({k: v for k, v in content.items() if k not in ("format", "version")})
    except SmoothOperatorError as error:
        raise ConfigError(f"{path}: {error}") from error


def _profile(content: Mapping[str, Any]) -> OperatorProfile:
    _check_names(OperatorProfile, content, "the file")
    fingers = content["fingers"]
    if not isinstance(fingers, Mapping):
        raise ConfigError("fingers must be an object with a part for each finger")
    return OperatorProfile(
        hand=_text(content, "hand"),
        side=as_side(_text(content, "side")),
        scale=_number(content, "scale"),
        palm_width=_number(content, "palm_width"),
        palm_length=_number(content, "palm_length"),
        fingers=tuple(_finger(name, fingers[name]) for name in fingers),
        palm_rotation=_numbers(content, "palm_rotation", 4),
        project=_number_or_none(content, "project"),
        escape=_number_or_none(content, "escape"),
        apply=_texts(content, "apply"),
        source=_text(content, "source"),
    )


def _finger(name: str, content: Any) -> FingerProfile:
    where = f"finger {name!r}"
    if not isinstance(content, Mapping):
        raise ConfigError(f"{where} must be an object")
    content = {**content, "name": name}
    _check_names(FingerProfile, content, where)
    return FingerProfile(
        name=name,
        robot=_text(content, "robot"),
        bones=_numbers(content, "bones", 3),
        pinch_gap=_number_or_none(content, "pinch_gap"),
        pinch_gap_after=_number_or_none(content, "pinch_gap_after"),
        **{
            key: _number(content, key)
            for key in ("reach", "robot_reach", "scale", "tip_along", "tip_pad")
        },
    )


def _check_names(kind: Any, content: Mapping[str, Any], where: str) -> None:
    names = [field.name for field in dataclasses.fields(kind)]
    missing = [name for name in names if name not in content]
    unknown = [name for name in content if name not in names]
    if missing or unknown:
        raise ConfigError(
            f"{where} "
            + " and ".join(
                f"{what} {listed(map(repr, words))}"
                for what, words in (("lacks", missing), ("has the unknown", unknown))
                if words
            )
            + f"; expected {', '.join(names)}"
        )


def _fields(value: Any) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}


def _text(content: Mapping[str, Any], name: str) -> str:
    value = content[name]
    if not isinstance(value, str):
        raise ConfigError(f"{name} must be text, not {brief(value)}")
    return value


def _texts(content: Mapping[str, Any], name: str) -> Any:
    value = content[name]
    if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
        raise ConfigError(f"{name} must be a list of words, not {brief(value)}")
    return tuple(value)  # the profile knows which words there are


def _number(content: Mapping[str, Any], name: str) -> float:
    return _as_number(content[name], name)


def _number_or_none(content: Mapping[str, Any], name: str) -> float | None:
    return None if content[name] is None else _number(content, name)


def _numbers(content: Mapping[str, Any], name: str, count: int) -> Any:
    value = content[name]
    if not isinstance(value, list) or len(value) != count:
        raise ConfigError(f"{name} must be {count} numbers, not {brief(value)}")
    return tuple(_as_number(each, name) for each in value)


def _as_number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"{name} must be a finite number, not {brief(value)}")
    return float(value)
