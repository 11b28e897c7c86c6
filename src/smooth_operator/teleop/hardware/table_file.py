"""Table files of real hands: reading, writing, search among the built-in ones and the user's."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.formats.toml_writer import toml_value
from smooth_operator.hands.registry import user_hands_folder
from smooth_operator.io.entries import Entries, read_entries
from smooth_operator.teleop.hardware.actuator_map import Actuator, ActuatorMap
from smooth_operator.teleop.hardware.device import (
    DeviceLostError,
    HandDevice,
    Setting,
    WrongAnswerError,
)
from smooth_operator.types import Side

FORMAT: Final = 1
"""Version of the tables."""

_MOST_BYTES: Final = 1_000_000
_SIDES: Final[tuple[Side, Side]] = ("right", "left")
_RESTS: Final = ("hold", "relax")

UNITS: Final[Mapping[str, float]] = {
    "rad": 1.0,
    "deg": 180.0 / math.pi,
    "step": 4096.0 / (2 * math.pi),
}
"""Units of commands that are angles -> how many make a radian. ``step``: 4096 to a turn."""

_TOP: Final = (
    "format", "driver", "hand", "side", "unit", "source", "limit", "rate", "on_silence", "on_stop",
    "on_end", "hot", "settings", "actuators",
)  # fmt: skip
_EACH: Final = (
    "name", "id", "joint", "joints", "points", "zero", "sign", "ends", "limit", "settings",
)  # fmt: skip


def user_tables_folder() -> Path:
    """Folder of the user's tables, ``NAME_SIDE.toml``; it need not exist."""
    return user_hands_folder() / "hardware"


def built_in_tables() -> Path:
    """Folder of the tables that come with the program."""
    return Path(str(files("smooth_operator.teleop.hardware"))) / "tables"


def find_table(request: str, driver: str, side: Side) -> Path:
    """Path of the table that a driver uses.

    Args:
        request: a path, ending in ``.toml``; or a name; or empty for the driver's name. A user's
            table of that name goes before the built-in one.

    Raises:
        ConfigError: there is none.
    """
    if request.endswith(".toml"):
        return Path(request).expanduser()
    name = f"{request or driver}_{side}.toml"
    for folder in (user_tables_folder(), built_in_tables()):
        if (folder / name).is_file():
            return folder / name
    have = ", ".join(path.name.removesuffix(".toml") for path in list_tables())
    raise ConfigError(
        f"there is no table {name}: give one as table=FILE.toml, put it into "
        f"{user_tables_folder()}, or write it with smooth-operator hardware check. There are: "
        f"{have or 'none'}"
    )


def list_tables() -> list[Path]:
    """All tables that can be named, the user's first; a built-in one that it replaces is left
    out."""
    tables: dict[str, Path] = {}
    for folder in (user_tables_folder(), built_in_tables()):
        if folder.is_dir():
            for path in sorted(folder.glob("*_*.toml")):
                tables.setdefault(path.name, path)
    return list(tables.values())


def read_table(path: Path) -> ActuatorMap:
    """The table in a file.

    Raises:
        ConfigError: it can't be read, an entry is wrong, or a map is not monotonic; the message
            names file and entry.
    """
    hint = "; smooth-operator hardware check writes one"
    top = read_entries(path, "table of a hand", most_bytes=_MOST_BYTES, hint=hint)
    top.only(*_TOP)
    top.check_format(FORMAT)
    unit = top.text("unit")
    with top.name_file():
        return ActuatorMap(
            driver=top.text("driver", empty=False),
            hand=top.text("hand", empty=False),
            side=top.choice("side", _SIDES),
            unit=unit,
            actuators=tuple(_actuator(each, unit) for each in top.tables("actuators")),
            limit=top.number("limit") if "limit" in top.values else None,
            rate=top.number("rate", 100.0),
            on_silence=top.choice("on_silence", _RESTS, "hold"),
            on_stop=top.choice("on_stop", _RESTS, "hold"),
            on_end=top.choice("on_end", _RESTS, "relax"),
            hot=top.number("hot", 65.0),
            settings=dict(top.table("settings", {}).values),
            source=top.text("source", "", lines=True),
            file=str(path),
        )


def _actuator(each: Entries, unit: str) -> Actuator:
    each.only(*_EACH)
    name = each.text("name", empty=False)
    points = _points(each, unit)
    commands = sorted(command for _, command in points)
    ends = (commands[0], commands[-1]) if commands else (0.0, 0.0)
    if "ends" in each.values:
        ends = each.numbers("ends", 2, what="two commands, the least and the greatest")
    return Actuator(
        name=name,
        joints=_joints(each),
        points=points,
        ends=ends,
        id=each.whole("id") if "id" in each.values else None,
        limit=each.number("limit") if "limit" in each.values else None,
        settings=dict(each.table("settings", {}).values),
    )


def _joints(each: Entries) -> dict[str, float]:
    if ("joint" in each.values) == ("joints" in each.values):
        raise each.error("joint", "give either joint, or joints with their weights")
    if "joint" in each.values:
        return {each.text("joint", empty=False): 1.0}
    table = each.table("joints")
    return {name: table.number(name) for name in table.names}


def _points(each: Entries, unit: str) -> tuple[tuple[float, float], ...]:
    """The points as they stand, or from ``zero``, ``sign`` and ``ends`` of an angle."""
    if ("points" in each.values) == ("zero" in each.values):
        raise each.error("points", "give either points, or zero with sign and ends")
    if "points" in each.values:
        rows = each.values["points"]
        if not isinstance(rows, list) or not all(map(_is_pair, rows)):
            raise each.error("points", "expected a list of pairs [rad, command]")
        return tuple((float(angle), float(command)) for angle, command in rows)
    if unit not in UNITS:
        raise each.error("zero", f"needs unit {' or '.join(UNITS)}, not {unit!r}; give points")
    zero, sign = each.number("zero"), each.whole("sign", 1)
    if sign not in (1, -1):
        raise each.error("sign", f"expected 1 or -1, not {sign}")
    low, high = each.numbers("ends", 2, what="two commands, the least and the greatest")
    pairs = [(sign * (command - zero) / UNITS[unit], command) for command in (low, high)]
    return tuple(sorted(pairs))


def _is_pair(row: Any) -> bool:
    numbers = isinstance(row, list) and len(row) == 2
    return numbers and all(isinstance(v, int | float) and abs(v) < 1e300 for v in row)


def write_table(table: ActuatorMap, path: Path, comment: str = "") -> None:
    """Writes a table that ``read_table`` reads back; whole or not at all.

    Raises:
        OutputError: the file can't be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(path.parent, error) from error
    text = "\n".join(_lines(table, comment)) + "\n"
    with atomic_write(path) as file:
        file.write(text.encode())


def _lines(table: ActuatorMap, comment: str) -> Iterator[str]:
    yield from (f"# {line}".rstrip() for line in comment.splitlines())
    yield f"format = {FORMAT}"
    for name in ("driver", "hand", "side", "unit", "source"):
        if value := getattr(table, name):
            yield f"{name} = {toml_value(value)}"
    if table.limit is not None:
        yield f"limit = {toml_value(table.limit)}"
    for name in ("rate", "on_silence", "on_stop", "on_end", "hot"):
        yield f"{name} = {toml_value(getattr(table, name))}"
    if table.settings:
        yield f"settings = {toml_value(table.settings)}"
    for actuator in table.actuators:
        yield "\n[[actuators]]"
        yield f"name = {toml_value(actuator.name)}"
        if actuator.id is not None:
            yield f"id = {actuator.id}"
        if list(actuator.joints.values()) == [1.0]:
            yield f"joint = {toml_value(next(iter(actuator.joints)))}"
        else:
            yield f"joints = {toml_value(actuator.joints)}"
        yield f"points = {toml_value(actuator.points)} # [rad, {table.unit}]"
        yield f"ends = {toml_value(actuator.ends)}"
        if actuator.limit is not None:
            yield f"limit = {toml_value(actuator.limit)}"
        if actuator.settings:
            yield f"settings = {toml_value(actuator.settings)}"


_EVERY_S: Final = 1.0
"""Time between two readings of a hand's settings [s]."""

_TRIES: Final = 3
"""Readings without any confirmed setting after which there are no more: the hand can't tell, and
waiting for its answer costs time on the bus."""

_TOLERANCE: Final = 0.01
"""Relative difference of two values that counts as rounding."""


class SettingsWatch:
    """Reads a hand's volatile settings periodically, and compares them with the written values.

    No driver has been tried on a physical hand. Therefore a difference counts as a loss only for a
    setting that the hand has once returned as written; otherwise it is a warning.

    Args:
        device: the hand.
        names: the actuators' names, for messages.

    Attributes:
        warnings: settings that the hand did not accept as written, a few words each.
    """

    def __init__(self, device: HandDevice, names: Sequence[str]) -> None:
        self.warnings: tuple[str, ...] = ()
        self._device, self._names = device, names
        self._confirmed: set[str] = set()
        self._readings = 0
        self._last = -np.inf

    def look(self) -> None:
        """Read the settings, if they are due.

        Raises:
            DeviceLostError: the hand has lost a confirmed setting, by two readings.
            WrongAnswerError: the hand does not answer.
        """
        now = time.perf_counter()
        useful = self._confirmed or self._readings < _TRIES
        if now - self._last < _EVERY_S or not useful:
            return
        self._last = now
        self._readings += 1
        try:
            different = self._different(self._device.settings())
            if not self._confirmed.isdisjoint(different):  # one wrong reading restarts no hand
                different = self._different(self._device.settings())
        except SinkError as error:
            if self._confirmed:
                raise
            self.warnings = ("its limits can't be read back",)
            raise WrongAnswerError(str(error)) from error  # a hand that is gone fails again
        if lost := [text for name, text in different.items() if name in self._confirmed]:
            raise DeviceLostError(f"the hand restarted: {', '.join(lost)}")
        self.warnings = tuple(different.values())

    def _different(self, settings: Sequence[Setting]) -> dict[str, str]:
        """Name of each setting that differs -> how; the others are confirmed."""
        different: dict[str, str] = {}
        for setting in settings:
            pairs = zip(setting.measured, setting.expected, strict=True)
            wrong = [k for k, (a, b) in enumerate(pairs) if abs(a - b) > _TOLERANCE * abs(b)]
            if not wrong:
                self._confirmed.add(setting.name)
                continue
            first, every = wrong[0], len(setting.measured) == len(self._names)
            where = self._names[first] if every else f"no. {first + 1}"
            different[setting.name] = (
                f"{setting.name} of {where} is {setting.measured[first]:g}, not "
                f"{setting.expected[first]:g}"
            )
        return different
