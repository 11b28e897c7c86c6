"""Spec files: a robot hand's description as a small TOML file that a person can read and mend.

::

    format = 1
    name = "pincer"
    side = "right"
    source = "measured in our lab"      # optional: where the figures come from, in words
    model = "pincer.xml"                # MJCF or URDF, relative to this file
    mirror = false                      # optional: the model is the other hand's
    palm = "palm"                       # body whose frame is the palm frame
    wrist = { body = "palm", offset = [0.0, 0.0, -0.03] }
    align = ["wrist", "thumb", "index"] # optional

    [fingers.thumb]                     # named after the human finger that drives it
    cmc = { body = "t1" }
    tip = { body = "t2", offset = [0.0, 0.0, 0.02] }

    [fingers.index]
    mcp = { body = "i1" }
    pip = { body = "i2" }
    dip = { body = "i3" }
    tip = { body = "i3", offset = [0.0, 0.0, 0.02] }

    [neutral]                           # optional: joint -> position [rad]
    i1 = 0.3

    [joint_map.i1]                      # optional: how a joint follows human joint angles
    offset = 0.0
    gains = { index_mcp = 1.0 }

Offsets are in the body's frame [m]. The points of a finger are the counterparts of its human
landmarks; the first and the tip are needed. What each entry means is told by
``HandSpec``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final, TypeAlias

from smooth_operator.errors import DocumentError, HandModelError, SmoothOperatorError, brief
from smooth_operator.hands.spec import FingerSpec, HandSpec, JointMap, Point
from smooth_operator.io.documents import read_toml
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS

FORMAT: Final = 1
"""Version of the format that this program reads and writes."""

POINTS: Final[dict[str, tuple[str, ...]]] = {
    finger: tuple(name.split("_")[1] for name in LANDMARKS[base : base + 4])
    for finger, base in zip(FINGERS, BASES, strict=True)
}
"""Names of a finger's four points, base to tip: cmc, mcp, ip, tip of the thumb, else mcp, pip,
dip, tip."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_MOST_BYTES = 1_000_000  # a spec file has 2 kB: what is larger is something else
_LONGEST = 80  # name in a message

_Table: TypeAlias = Mapping[str, Any]


def read_hand_spec(path: str | Path) -> HandSpec:
    """Reads a spec file.

    Args:
        path: the file; a relative ``model`` in it counts from its folder.

    Raises:
        HandModelError: there is no such file, it is no TOML, or what it says is no hand; the
            message names the entry and what is expected there.
    """
    path = Path(path)
    return _Reader(str(path)).spec(_parse(path), path.absolute().parent)


def check_hand_name(name: str) -> str:
    """The name, if it can be one.

    Raises:
        HandModelError: it holds other characters than letters, digits, ``_`` and ``-``.
    """
    if not _NAME.fullmatch(name):
        raise HandModelError(
            f"a hand can't be named {brief(name)}; use letters, digits, '_' and '-', and a "
            "letter or digit first"
        )
    return name


def _parse(path: Path) -> _Table:
    try:
        return read_toml(path, most_bytes=_MOST_BYTES)
    except FileNotFoundError:
        raise HandModelError(f"no spec file at {path}") from None
    except OSError as error:
        raise HandModelError(f"can't read the spec file {path}: {error.strerror}") from error
    except DocumentError as error:
        raise HandModelError(f"{path} is not well-formed TOML: {error}") from error


@dataclass(frozen=True)
class _Reader:
    """Checked look-ups.

    Attributes:
        file: as messages call it.
    """

    file: str

    def spec(self, table: _Table, folder: Path) -> HandSpec:
        version = self.get(table, "format", int, "")
        if version != FORMAT:
            raise self.error(
                "format",
                f"expected {FORMAT}, not {version}"
                + ("; a newer smooth-operator wrote it: update yours" if version > FORMAT else ""),
            )
        self.only(
            table,
            ("format", "name", "side", "source", "model", "mirror", "palm", "wrist", "align",
             "fingers", "neutral", "joint_map"),
            "",
        )  # fmt: skip
        side = self.get(table, "side", str, "")
        if side not in ("right", "left"):
            raise self.error("side", f"expected 'right' or 'left', not {brief(side)}")
        fingers = self.get(table, "fingers", dict, "")
        more: dict[str, Any] = {}
        if "align" in table:
            names = self.get(table, "align", list, "")
            if not all(isinstance(name, str) for name in names):
                raise self.error(
                    "align", f"expected names of fingers or 'wrist', not {brief(names)}"
                )
            more["align"] = tuple(names)
        try:
            return HandSpec(
                name=check_hand_name(self.get(table, "name", str, "")),
                side="right" if side == "right" else "left",
                model=folder / self.get(table, "model", str, ""),
                palm=self.get(table, "palm", str, ""),
                wrist=self.point(self.get(table, "wrist", dict, ""), "wrist"),
                fingers=tuple(self.finger(fingers, name) for name in fingers),
                neutral={
                    joint: self.number(value, f"neutral.{joint}")
                    for joint, value in self.get(table, "neutral", dict, "", {}).items()
                },
                mirror=self.get(table, "mirror", bool, "", False),
                joint_map=tuple(
                    self.row(rows, joint)
                    for rows in (self.get(table, "joint_map", dict, "", {}),)
                    for joint in rows
                ),
                source=self.get(table, "source", str, "", ""),
                **more,
            )
        except SmoothOperatorError as error:
            if str(error).startswith(self.file):
                raise
            raise HandModelError(f"{self.file}: {error}") from error

    def finger(self, fingers: _Table, name: str) -> FingerSpec:
        where = f"fingers.{name}"
        self.only(fingers, FINGERS, "fingers")
        table = self.get(fingers, name, dict, "fingers")
        self.only(table, POINTS[name], where)
        points = [
            self.point(self.get(table, point, dict, where), f"{where}.{point}")
            if point in table
            else None
            for point in POINTS[name]
        ]
        for needed in (POINTS[name][0], POINTS[name][3]):
            if needed not in table:
                raise self.error(f"{where}.{needed}", "is missing; a finger needs a base and a tip")
        return FingerSpec(name, (points[0], points[1], points[2], points[3]))

    def point(self, table: _Table, where: str) -> Point:
        self.only(table, ("body", "offset"), where)
        offset = self.get(table, "offset", list, where, [0.0, 0.0, 0.0])
        if len(offset) != 3:
            raise self.error(
                f"{where}.offset", f"expected [x, y, z] in metres, not {brief(offset)}"
            )
        x, y, z = (self.number(value, f"{where}.offset") for value in offset)
        if max(abs(x), abs(y), abs(z)) > 1.0:
            raise self.error(
                f"{where}.offset", f"{offset} is more than a metre: offsets are in metres"
            )
        return Point(self.get(table, "body", str, where), (x, y, z))

    def row(self, rows: _Table, joint: str) -> JointMap:
        where = f"joint_map.{joint}"
        table = self.get(rows, joint, dict, "joint_map")
        self.only(table, ("offset", "gains"), where)
        return JointMap(
            joint,
            self.number(table.get("offset", 0.0), f"{where}.offset"),
            {
                angle: self.number(gain, f"{where}.gains.{angle}")
                for angle, gain in self.get(table, "gains", dict, where, {}).items()
            },
        )

    def get(self, table: _Table, key: str, kind: type[Any], where: str, default: Any = None) -> Any:
        """An entry of a kind.

        Raises:
            HandModelError: it is missing and has no default, or is of another kind.
        """
        full = f"{where}.{key}" if where else key
        if key not in table:
            if default is None:
                raise self.error(full, f"is missing; expected {_KINDS[kind]}")
            return default
        value = table[key]
        # True is an int for Python, not for a person
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.error(full, f"expected {_KINDS[kind]}, not {brief(value)}")
        if isinstance(value, str) and not value and key != "source":
            raise self.error(full, f"expected {_KINDS[kind]}, not an empty text")
        return value

    def number(self, value: Any, where: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not _finite(value):
            raise self.error(where, f"expected a finite number, not {brief(value)}")
        return float(value)

    def only(self, table: _Table, known: Collection[str], where: str) -> None:
        for key in table:
            if key not in known:
                close = get_close_matches(key, list(known), n=1)
                hint = f" Did you mean {close[0]!r}?" if close else ""
                raise self.error(
                    _entry(where, key),
                    f"no such entry.{hint} Known here: {', '.join(known)}",
                )

    def error(self, where: str, text: str) -> HandModelError:
        return HandModelError(f"{self.file}: {where}: {text}")


_KINDS: Final[dict[type, str]] = {
    int: "a whole number",
    str: "a text",
    bool: "true or false",
    list: "a list",
    dict: "a table",
}


def _entry(where: str, key: str) -> str:
    """Name of an entry for a message, cut where it is too long."""
    name = f"{where}.{key}" if where else key
    return name if len(name) <= _LONGEST else f"{name[:_LONGEST]}..."


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number of hundreds of digits
        return False
