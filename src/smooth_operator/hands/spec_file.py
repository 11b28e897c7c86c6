"""Reads spec files, which are descriptions of robot hands as small TOML files.

docs/how-to/hands.md has a complete example. Offsets are in the body's frame [m]. The points of a
finger are the counterparts of its human landmarks; the first and the tip are needed. ``HandSpec``
explains each entry.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import HandModelError, brief
from smooth_operator.hands.spec import MOST_DEGREE, Coupling, FingerSpec, HandSpec, JointMap, Point
from smooth_operator.io.entries import Entries, read_entries
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS
from smooth_operator.types import Side

FORMAT: Final = 1
"""Version of the file format."""

POINTS: Final[dict[str, tuple[str, ...]]] = {
    finger: tuple(name.split("_")[1] for name in LANDMARKS[base : base + 4])
    for finger, base in zip(FINGERS, BASES, strict=True)
}
"""Names of a finger's four points, base to tip: cmc, mcp, ip, tip of the thumb, else mcp, pip,
dip, tip."""

MOST_NAME: Final = 100
"""Longest name of a hand. It is part of file names, which may have 255 characters."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_MOST_BYTES = 1_000_000  # a spec file has 2 kB


def read_hand_spec(path: str | Path) -> HandSpec:
    """Reads a spec file.

    Args:
        path: the file; a relative ``model`` path in it starts at the file's folder.

    Raises:
        HandModelError: there is no such file, it is not TOML, or it does not describe a hand; the
            message names the entry and the expected value.
    """
    path = Path(path)
    entries = read_entries(path, "spec file", HandModelError, most_bytes=_MOST_BYTES)
    with entries.name_file():
        return _spec(entries, path.absolute().parent)


def check_hand_name(name: str) -> str:
    """Returns a hand's name if it is valid. Raises HandModelError if it has characters other than
    letters, digits, ``_`` and ``-``, or is longer than ``MOST_NAME``."""
    if len(name) > MOST_NAME:
        raise HandModelError(
            f"a hand can't be named {brief(name)}: the name has {len(name)} characters; "
            f"expected at most {MOST_NAME}"
        )
    if not _NAME.fullmatch(name):
        raise HandModelError(
            f"a hand can't be named {brief(name)}; use letters, digits, '_' and '-', "
            "starting with a letter or digit"
        )
    return name


def _spec(entries: Entries, folder: Path) -> HandSpec:
    entries.check_format(FORMAT)
    entries.only("format", *(each.name for each in fields(HandSpec)))
    side: Side = entries.choice("side", ("right", "left"))
    fingers = entries.table("fingers")
    fingers.only(*FINGERS)
    neutral = entries.table("neutral", {})
    rows = entries.table("joint_map", {})
    couplings = entries.table("couplings", {})
    more: dict[str, Any] = {}
    for name, what in (("align", "names of fingers or 'wrist'"), ("wrist_joints", "joints")):
        if name in entries.names:
            more[name] = tuple(entries.texts(name, what=what))
    return HandSpec(
        name=check_hand_name(entries.text("name", empty=False)),
        side=side,
        model=folder / entries.text("model", empty=False, lines=True),
        palm=entries.text("palm", empty=False, lines=True),
        wrist=_point(entries.table("wrist")),
        fingers=tuple(_finger(fingers.table(name), name) for name in fingers.names),
        neutral={joint: neutral.number(joint) for joint in neutral.names},
        mirror=entries.flag("mirror", False),
        gripper=entries.flag("gripper", False),
        joint_map=tuple(_row(rows.table(joint), joint) for joint in rows.names),
        torque=_torque(entries),
        couplings=tuple(_coupling(couplings.table(name), name) for name in couplings.names),
        source=entries.text("source", "", lines=True),
        **more,
    )


def _torque(entries: Entries) -> float | dict[str, float] | None:
    if "torque" not in entries.names:
        return None
    if not isinstance(entries.values["torque"], Mapping):
        return entries.number("torque")
    table = entries.table("torque")
    return {joint: table.number(joint) for joint in table.names}


def _finger(entries: Entries, name: str) -> FingerSpec:
    names = POINTS[name]
    entries.only(*names)
    for needed in (names[0], names[3]):
        if needed not in entries.names:
            raise entries.error(needed, "is missing; a finger needs a base and a tip")
    base, second, third, tip = (
        _point(entries.table(point)) if point in entries.names else None for point in names
    )
    return FingerSpec(name, (base, second, third, tip))


def _point(entries: Entries) -> Point:
    entries.only("body", "offset")
    offset = entries.numbers("offset", 3, (0.0, 0.0, 0.0), what="[x, y, z] in metres")
    if max(map(abs, offset)) > 1.0:
        raise entries.error(
            "offset", f"{list(offset)} is more than a metre; offsets must be in metres"
        )
    return Point(entries.text("body", empty=False, lines=True), offset)


def _coupling(entries: Entries, joint: str) -> Coupling:
    follows = entries.text("follows", empty=False, lines=True)
    if "coefficients" in entries.names:
        entries.only("follows", "coefficients")
        return Coupling.of(joint, follows, _coefficients(entries))
    entries.only("follows", "multiplier", "offset")
    return Coupling(
        joint, follows, entries.number("multiplier", 1.0), entries.number("offset", 0.0)
    )


def _coefficients(entries: Entries) -> tuple[float, ...]:
    values, most = entries.values["coefficients"], MOST_DEGREE + 1
    if not isinstance(values, list) or not 2 <= len(values) <= most:
        raise entries.error(
            "coefficients",
            f"expected a list of 2 to {most} numbers, constant first, not {brief(values)}",
        )
    numbers: tuple[float, ...] = entries.numbers("coefficients", len(values))
    return numbers


def _row(entries: Entries, joint: str) -> JointMap:
    entries.only("offset", "gains")
    gains = entries.table("gains", {})
    return JointMap(
        joint,
        entries.number("offset", 0.0),
        {angle: gains.number(angle) for angle in gains.names},
    )
