"""Maps between joints of a hand's model and commands of its real actuators, and their files.

Each actuator follows a drive angle [rad] by a monotonic piecewise-linear curve. The drive angle is
a weighted sum of model joints, or that of a crank whose rod moves two of them. The curve and its
ends come from a table, measured on the real hand or by the maker; the limits of our model are not
used.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.formats.toml_writer import toml_value
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import user_hands_folder
from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.io.entries import Entries, read_entries
from smooth_operator.settings import check_range
from smooth_operator.types import Side
from smooth_operator_devices.hands.contact import ContactMap, ContactScale, Measured

Rest: TypeAlias = Literal["hold", "relax"]
"""Behaviour of a hand without a command: hold its position under power, or relax."""

_KNOWN: Final = 1e-6
"""Tolerance of the share of a joint that the actuators determine."""
_EXACT: Final = 1e-9  # remainder of a drive angle at which the steps end [rad]
_NEWTON_STEPS: Final = 8  # from the neutral pose to joint positions; for polynomials


@dataclass(frozen=True)
class Actuator:
    """One actuator of a real hand.

    Attributes:
        name: the maker's or the user's name for it.
        joints: model joint -> weight: the drive angle is the weighted sum of their positions [rad].
            One joint with weight 1 in most hands; ``{"a": 0.5, "b": 0.5}`` where one motor moves
            two joints of the model together; ``{"a": 1.0, "b": -1.0}`` for one of a differential.
        points: (drive angle [rad], command) in rising order of the angle, two or more; commands
            rise strictly or fall strictly. Between points, the map is linear; beyond, it continues
            with the slope of the last piece, up to ``ends``.
        ends: lowest and highest command.
        id: number on the bus; None if it has none.
        limit: limit of current [mA], or of force, in the driver's unit; None for the table's.
        settings: further settings for the driver.
        crank: coefficients c for a crank with a rod that moves both ``joints``, a and b: the sine
            of the drive angle is the sum of c[i][j] a^i b^j. Empty without a crank.

    Raises:
        ConfigError: the points are not monotonic, the ends are not in order, or a crank does not
            have two joints.
    """

    name: str
    joints: Mapping[str, float]
    points: tuple[tuple[float, float], ...]
    ends: tuple[float, float]
    id: int | None = None
    limit: float | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    crank: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if self.crank and not (list(self.joints.values()) == [1.0, 1.0] and all(self.crank)):
            raise ConfigError(
                f"actuator {self.name!r}: a crank needs two joints without weights, "
                'joints = ["a", "b"], and rows of coefficients'
            )
        if not self.joints or not all(np.isfinite(list(self.joints.values()))):
            raise ConfigError(f"actuator {self.name!r} needs a joint, with a finite weight")
        if not any(self.joints.values()):
            raise ConfigError(f"actuator {self.name!r}: a weight of its joints must not be zero")
        if len(self.points) < 2 or not np.isfinite(self.points).all():
            raise ConfigError(
                f"actuator {self.name!r} needs two or more points [rad, command] of finite numbers"
            )
        angles, commands = np.array(self.points, float).T
        for what, values in (("drive angles", angles), ("commands", commands)):
            steps = np.diff(values)
            wrong = steps >= 0 if what == "commands" and steps[0] < 0 else steps <= 0
            if wrong.any():
                k = int(np.argmax(wrong))
                raise ConfigError(
                    f"the map of actuator {self.name!r} is not monotonic: its {what} go from "
                    f"{values[k]:g} to {values[k + 1]:g}; list the points by increasing "
                    "drive angle, with commands that always increase or always decrease"
                )
        low, high = self.ends
        if not (np.isfinite(self.ends).all() and low < high):
            raise ConfigError(
                f"actuator {self.name!r}: ends must be the minimum command, then the "
                f"maximum, not [{low:g}, {high:g}]"
            )

    def command(self, angle: float) -> float:
        """Command for a drive angle [rad]; not limited to the ends."""
        angles, commands, _, _ = self._curve
        return _linear(angle, angles, commands)

    def angle(self, command: float) -> float:
        """Drive angle [rad] of a command; also beyond the ends. NaN for NaN."""
        _, _, commands, angles = self._curve
        return _linear(command, commands, angles)

    @cached_property
    def _curve(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Angles and commands by rising angle, and commands and angles by rising command."""
        angles, commands = np.array(self.points, float).T
        order = 1 if commands[-1] > commands[0] else -1
        return angles, commands, commands[::order].copy(), angles[::order].copy()


@dataclass(frozen=True)
class ActuatorMap:
    """The table of a real hand: its actuators, limits and settings.

    Attributes:
        driver: name of the driver that speaks its protocol.
        hand: name of the robot hand whose joints the table maps.
        side: side of the hand.
        unit: unit of the commands, for people: ``deg``, ``0-1000``.
        actuators: actuators in the order of a driver's commands and readings.
        limit: limit of current [mA], or of force, in the driver's unit, for actuators without their
            own; None to leave that of the device unchanged.
        rate: cycles per second on the bus [Hz].
        on_silence: rest after a time without commands.
        on_stop: rest in an emergency stop.
        on_end: rest at the end of a run.
        hot: temperature [degrees Celsius] from which on an actuator is reported.
        settings: further settings for the driver, such as gains.
        contact: scale of the contact that feedback sends; None for currents and their limits.
        source: source of the figures.
        file: name of the table in messages.

    Raises:
        ConfigError: there is no actuator, two share a name or an id, or a setting is out of range.
    """

    driver: str
    hand: str
    side: Side
    unit: str
    actuators: tuple[Actuator, ...]
    limit: float | None = None
    rate: float = 100.0
    on_silence: Rest = "hold"
    on_stop: Rest = "hold"
    on_end: Rest = "relax"
    hot: float = 65.0
    settings: Mapping[str, Any] = field(default_factory=dict)
    contact: ContactScale | None = None
    source: str = ""
    file: str = "the table"

    def __post_init__(self) -> None:
        if not self.actuators:
            raise ConfigError(f"{self.file} has no actuator")
        for what in ("name", "id"):
            values = [getattr(actuator, what) for actuator in self.actuators]
            for k, value in enumerate(values):
                if value is not None and value in values[:k]:
                    raise ConfigError(f"{self.file}: two actuators have the {what} {value!r}")
        for limit in (self.limit, *(a.limit for a in self.actuators)):
            if limit is not None and not 0.0 < limit < np.inf:
                raise ConfigError(
                    f"{self.file}: limit must be over 0 and finite, not {limit:g}; omit it "
                    "to use the limit of the device"
                )
        for settings in (self.settings, *(a.settings for a in self.actuators)):
            for name, value in settings.items():
                if isinstance(value, float) and not np.isfinite(value):
                    raise ConfigError(f"{self.file}: {name} must be finite, not {value:g}")
        check_range(f"{self.file}: rate", self.rate, 1.0, 1000.0, "Hz")

    @property
    def names(self) -> tuple[str, ...]:
        """(a,) names of the actuators."""
        return tuple(actuator.name for actuator in self.actuators)

    @property
    def limits(self) -> Float[np.ndarray, " a"]:
        """(a,) limit of current or force of each; NaN to leave that of the device unchanged."""
        default = np.nan if self.limit is None else self.limit
        return np.array([default if a.limit is None else a.limit for a in self.actuators], float)

    def check_count(self, count: int, hand: str) -> None:
        """Check the number of actuators.

        Args:
            count: number of actuators of the hand.
            hand: name of the hand with its article, for the message.

        Raises:
            ConfigError: the table has another number.
        """
        if len(self.actuators) != count:
            raise ConfigError(
                f"{self.file}: {hand} has {count} actuators, not {len(self.actuators)}"
            )


class BoundMap:
    """An actuator map as arrays, for the joints of one loaded hand.

    The table may have the hand's wrist joints. If the hand is loaded without them, their actuators
    keep them in the neutral position.

    Args:
        actuators: the table, of a actuators.
        hand: the hand, of n joints, with or without its wrist joints.

    Attributes:
        table: the table.
        names: (n,) names of the model's joints.
        ends: (a, 2) lowest and highest command.
        contact: map from readings to the contact of the hand's fingers.

    Raises:
        ConfigError: the table is that of another hand, with other joints.
        UnknownNameError: the hand has no such joint.
    """

    def __init__(self, actuators: ActuatorMap, hand: Hand) -> None:
        self.table, self.names = actuators, hand.joint_names
        joints = [actuator.joints for actuator in actuators.actuators]
        self.contact = ContactMap(actuators.contact, actuators.limits, joints, hand)
        hand = with_wrist_joints(hand)
        count, names = len(actuators.actuators), hand.joint_names
        self.ends = np.array([actuator.ends for actuator in actuators.actuators], float)
        self._weights = np.zeros((count, len(names)))
        for row, actuator in zip(self._weights, actuators.actuators, strict=True):
            for joint, weight in actuator.joints.items():
                if joint not in names and actuators.hand != hand.name:
                    raise ConfigError(
                        f"{Path(actuators.file).name} is the table of the hand "
                        f"{actuators.hand!r}, but the run uses the hand {hand.name!r}: "
                        f"choose --hand {actuators.hand}, or another table with table=FILE"
                    )
                if joint not in names:
                    raise UnknownNameError(
                        f"joint of hand {hand.name!r} in {actuators.file}:",
                        joint,
                        names,
                        f"The table is for {actuators.hand!r}: choose it with --hand, or another "
                        "table with table=FILE.",
                    )
                row[names.index(joint)] += weight
        self._cranks = _Cranks(actuators.actuators, names)
        self._weights = self._slopes(np.zeros(len(names)))
        # q = p(C qa + o) of the model's own couplings, and drive angles x = W q: solved for qa,
        # with the least norm where one actuator moves several joints.
        self._hand, self._transmission = hand, hand.transmission
        self._curved = bool(hand.transmission.curves) or len(self._cranks.rows) > 0
        self._gears, self._offset = hand.transmission.matrix, hand.transmission.offset
        reduced = self._weights @ self._gears
        self._inverse = np.linalg.pinv(reduced)
        touched = (self._weights @ self._gears != 0).any(axis=0)
        self._determined: Bool[np.ndarray, " w"] = (np.abs(self._gears) @ ~touched < _KNOWN) & (
            np.abs(self._gears).sum(axis=1) > 0
        )

    @property
    def determined(self) -> Bool[np.ndarray, " n"]:
        """(n,) True for a joint that the actuators determine, directly or by a coupling."""
        return self._determined[: len(self.names)]

    def angles(self, positions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " a"]:
        """(a,) drive angles [rad] of joint positions [rad]."""
        left_out = len(self._determined) - len(positions)
        wrist = self._hand.neutral[len(self._hand.neutral) - left_out :]
        values = self._values(np.concatenate([positions, wrist]))
        turned = self._cranks.rows
        values[turned] = np.arcsin(np.clip(values[turned], -1.0, 1.0))
        return values

    def _values(self, positions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " a"]:
        """(a,) drive angles [rad], and their sines for cranks."""
        values: np.ndarray = self._weights @ positions
        values[self._cranks.rows] = self._cranks.sines(positions)
        return values

    def _slopes(self, positions: Float[np.ndarray, " n"]) -> Float[np.ndarray, "a n"]:
        """(a, n) derivatives of ``_values``."""
        slopes = self._weights.copy()
        slopes[self._cranks.rows[:, None], self._cranks.joints] = self._cranks.slopes(positions)
        return slopes

    def commands(self, angles: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
        """(a,) commands for drive angles [rad], not limited to the ends."""
        pairs = zip(self.table.actuators, angles, strict=True)
        return np.array([actuator.command(angle) for actuator, angle in pairs])

    def clip(self, commands: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
        """Clips commands to the ends."""
        clipped: np.ndarray = np.clip(commands, self.ends[:, 0], self.ends[:, 1])
        return clipped

    def drive_angles(self, commands: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
        """(a,) drive angles [rad] of commands or measured positions; NaN for NaN."""
        pairs = zip(self.table.actuators, commands, strict=True)
        return np.array([actuator.angle(value) for actuator, value in pairs])

    def joints(self, commands: Float[np.ndarray, " a"]) -> Float[np.ndarray, " n"]:
        """(n,) joint positions [rad] of measured positions.

        NaN for a joint that no actuator moves, or whose actuator's position is NaN.
        """
        angles = self._wanted(commands)
        if self._curved:
            q = self._actuated(angles)
            return self._known(self._transmission.positions(q), ~np.isfinite(angles))
        offset = self._offset[: len(self.names)]
        result: np.ndarray = self._spread(angles - self._weights @ self._offset) + offset
        return result

    def joint_velocities(
        self, commands: Float[np.ndarray, " a"], rates: Float[np.ndarray, " a"]
    ) -> Float[np.ndarray, " n"]:
        """(n,) joint velocities [rad/s] from measured positions and velocities of actuators."""
        step = 1e-3
        ahead = self._wanted(commands + step * rates)
        angles = self._wanted(commands)
        speeds = (ahead - angles) / step
        if self._curved:
            q = self._actuated(angles)
            slopes = self._transmission.slopes(q)
            driven = self._slopes(self._transmission.positions(q)) @ slopes
            lost = ~np.isfinite(speeds)
            found = np.linalg.pinv(driven) @ np.where(lost, 0.0, speeds)
            return self._known(slopes @ found, lost)
        return self._spread(speeds)

    def _wanted(self, commands: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
        """``_values`` of measured positions."""
        values = self.drive_angles(commands)
        turned = self._cranks.rows
        values[turned] = np.sin(values[turned])
        return values

    def _actuated(self, values: Float[np.ndarray, " a"]) -> Float[np.ndarray, " m"]:
        """Positions of the actuated joints [rad] at ``_values``, by Newton's steps."""
        q = self._hand.neutral
        for _ in range(_NEWTON_STEPS):
            positions = self._transmission.positions(q)
            left = values - self._values(positions)
            if not (np.abs(left) > _EXACT).any():  # NaN for a motor without a position
                break
            jacobian = self._slopes(positions) @ self._transmission.slopes(q)
            q = q + np.linalg.pinv(jacobian) @ np.where(np.isfinite(left), left, 0.0)
        return q

    def _spread(self, angles: Float[np.ndarray, " a"]) -> Float[np.ndarray, " n"]:
        missing = ~np.isfinite(angles)
        return self._known(self._gears @ (self._inverse @ np.where(missing, 0.0, angles)), missing)

    def _known(
        self, joints: Float[np.ndarray, " n"], missing: Bool[np.ndarray, " a"]
    ) -> Float[np.ndarray, " n"]:
        """Values of joints, NaN for those that no actuator determines, or only missing ones."""
        unknown = ~self._determined
        if missing.any():
            lost = (np.abs(self._inverse[:, missing]) > _KNOWN).any(axis=1)
            unknown = unknown | ((np.abs(self._gears) @ lost) > 0)
        joints[unknown] = np.nan
        return joints[: len(self.names)]


class _Cranks:
    """The polynomials of all actuators with a crank.

    Attributes:
        rows: (k,) places of these actuators among all.
        joints: (k, 2) places of their joints among those of the model.
    """

    def __init__(self, actuators: Sequence[Actuator], names: Sequence[str]) -> None:
        self.rows = np.array([k for k, one in enumerate(actuators) if one.crank], int)
        cranks = [actuators[row] for row in self.rows]
        joints = [[names.index(joint) for joint in crank.joints] for crank in cranks]
        self.joints = np.array(joints, int).reshape(-1, 2)
        size = max((max(len(c.crank), *map(len, c.crank)) for c in cranks), default=1)
        self._coefficients = np.zeros((len(cranks), size, size))
        for rows, crank in zip(self._coefficients, cranks, strict=True):
            for row, given in zip(rows, crank.crank, strict=False):
                row[: len(given)] = given
        self._degrees = np.arange(size)

    def sines(self, positions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
        """Sines of the drive angles."""
        a, b = positions[self.joints].T[..., None] ** self._degrees
        return self._sums(a, b)

    def slopes(self, positions: Float[np.ndarray, " n"]) -> Float[np.ndarray, "k 2"]:
        """Derivatives of the sines by both joints."""
        places = positions[self.joints].T[..., None]
        a, b = places**self._degrees
        by_a, by_b = self._degrees * places ** np.maximum(self._degrees - 1, 0)
        return np.stack([self._sums(by_a, b), self._sums(a, by_b)], axis=1)

    def _sums(self, a: np.ndarray, b: np.ndarray) -> Float[np.ndarray, " k"]:
        return np.asarray(np.einsum("ki,kij,kj->k", a, self._coefficients, b))


def _linear(value: ArrayLike, xs: np.ndarray, ys: np.ndarray) -> float:
    """Piecewise-linear through points, with the outer slopes beyond them; NaN for NaN."""
    value = float(np.asarray(value))
    if value < xs[0] or value > xs[-1]:
        a, b = (0, 1) if value < xs[0] else (-2, -1)
        return float(ys[b] + (value - xs[b]) * (ys[b] - ys[a]) / (xs[b] - xs[a]))
    return float(np.interp(value, xs, ys))


FORMAT: Final = 1
"""Version of the tables."""

_MOST_BYTES: Final = 1_000_000

UNITS: Final[Mapping[str, float]] = {
    "rad": 1.0,
    "deg": 180.0 / math.pi,
    "step": 4096.0 / (2 * math.pi),
    "scs_step": 1024.0 / math.radians(300.0),
}
"""Unit of commands that are angles -> its number in a radian. ``step``: 4096 to a turn;
``scs_step``: 1024 to 300 degrees, as Feetech's SCS0009."""

_TOP: Final = ("format", *(each.name for each in fields(ActuatorMap) if each.name != "file"))
_EACH: Final = ("joint", "zero", "sign", *(each.name for each in fields(Actuator)))
"""Entries of a table, and of each of its actuators."""


def user_tables_folder() -> Path:
    """Folder of the user's tables, ``NAME_SIDE.toml``; it need not exist."""
    return user_hands_folder() / "hardware"


def built_in_tables() -> Path:
    """Folder of the tables that come with the program."""
    return Path(str(files("smooth_operator_devices.hands"))) / "tables"


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
        f"{user_tables_folder()}, or write it with smooth-operator hardware check. Existing "
        f"tables: {have or 'none'}"
    )


def list_tables() -> list[Path]:
    """All tables that can be selected by name, the user's first; a user's table hides the built-in
    table of the same name."""
    tables: dict[str, Path] = {}
    for folder in (user_tables_folder(), built_in_tables()):
        if folder.is_dir():
            for path in sorted(folder.glob("*_*.toml")):
                tables.setdefault(path.name, path)
    return list(tables.values())


def read_table(path: Path) -> ActuatorMap:
    """Reads the table in a file.

    Raises:
        ConfigError: it can't be read, an entry is wrong, or a map is not monotonic; the message
            names file and entry.
    """
    top = _entries(path)
    top.only(*_TOP)
    top.check_format(FORMAT)
    unit = top.text("unit")
    with top.name_file():
        return ActuatorMap(
            driver=top.text("driver", empty=False),
            hand=top.text("hand", empty=False),
            side=top.choice("side", get_args(Side)),
            unit=unit,
            actuators=tuple(_actuator(each, unit) for each in top.tables("actuators")),
            limit=top.number("limit") if "limit" in top.values else None,
            rate=top.number("rate", 100.0),
            on_silence=top.choice("on_silence", get_args(Rest), "hold"),
            on_stop=top.choice("on_stop", get_args(Rest), "hold"),
            on_end=top.choice("on_end", get_args(Rest), "relax"),
            hot=top.number("hot", 65.0),
            settings=dict(top.table("settings", {}).values),
            contact=_contact(top.table("contact")) if "contact" in top.values else None,
            source=top.text("source", "", lines=True),
            file=str(path),
        )


def _contact(each: Entries) -> ContactScale:
    each.only(*(entry.name for entry in fields(ContactScale)))
    return ContactScale(
        each.choice("values", get_args(Measured)),
        each.number("idle"),
        each.number("full"),
        tuple(each.texts("fingers")) if "fingers" in each.values else (),
        each.number("newtons") if "newtons" in each.values else None,
    )


def _entries(path: Path) -> Entries:
    """The entries of a file, completed by those of its ``base`` in the same folder, or built in."""
    hint = "; create one with smooth-operator hardware check"
    own = read_entries(path, "table of a hand", most_bytes=_MOST_BYTES, hint=hint)
    if "base" not in own.values:
        return own
    name = own.text("base", empty=False)
    folder = path.parent if (path.parent / name).is_file() else built_in_tables()
    base = read_entries(folder / name, "table", most_bytes=_MOST_BYTES)
    if "base" in base.values:
        raise own.error("base", f"{name} has a base itself; name a table without a base")
    others = own.tables("actuators") if "actuators" in own.values else []
    changes = {each.text("name"): each.values for each in others}
    actuators = [
        {**each.values, **changes.pop(each.text("name"), {})} for each in base.tables("actuators")
    ]
    merged = {**base.values, **own.values, "actuators": [*actuators, *changes.values()]}
    del merged["base"]
    return replace(own, values=merged)


def _actuator(each: Entries, unit: str) -> Actuator:
    each.only(*_EACH)
    name = each.text("name", empty=False)
    points = _points(each, unit)
    commands = sorted(command for _, command in points)
    ends = (commands[0], commands[-1]) if commands else (0.0, 0.0)
    if "ends" in each.values:
        ends = each.numbers("ends", 2, what="two commands, the minimum and the maximum")
    return Actuator(
        name=name,
        joints=_joints(each),
        points=points,
        ends=ends,
        id=each.whole("id") if "id" in each.values else None,
        limit=each.number("limit") if "limit" in each.values else None,
        settings=dict(each.table("settings", {}).values),
        crank=_crank(each) if "crank" in each.values else (),
    )


def _crank(each: Entries) -> tuple[tuple[float, ...], ...]:
    rows = each.values["crank"]
    try:
        return tuple(tuple(float(number) for number in row) for row in rows)
    except (TypeError, ValueError):
        raise each.error("crank", "expected rows of coefficients [[c00, c01], [c10]]") from None


def _joints(each: Entries) -> dict[str, float]:
    if ("joint" in each.values) == ("joints" in each.values):
        raise each.error("joint", "set either joint, or joints with their weights")
    if "joint" in each.values:
        return {each.text("joint", empty=False): 1.0}
    if isinstance(each.values["joints"], list):
        return dict.fromkeys(each.texts("joints"), 1.0)
    table = each.table("joints")
    return {name: table.number(name) for name in table.names}


def _points(each: Entries, unit: str) -> tuple[tuple[float, float], ...]:
    """The points as they stand, or from ``zero``, ``sign`` and ``ends`` of an angle."""
    if ("points" in each.values) == ("zero" in each.values):
        raise each.error("points", "set either points, or zero with sign and ends")
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
    low, high = each.numbers("ends", 2, what="two commands, the minimum and the maximum")
    pairs = [(sign * (command - zero) / UNITS[unit], command) for command in (low, high)]
    return tuple(sorted(pairs))


def _is_pair(row: Any) -> bool:
    numbers = isinstance(row, list) and len(row) == 2
    return numbers and all(isinstance(v, int | float) and abs(v) < 1e300 for v in row)


def write_table(table: ActuatorMap, path: Path, comment: str = "") -> None:
    """Writes a table, which ``read_table`` reads back, atomically.

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
    if table.contact is not None:
        entries = {name: value for name, value in asdict(table.contact).items() if value}
        yield f"contact = {toml_value({'idle': 0.0, **entries})}"
    for actuator in table.actuators:
        yield "\n[[actuators]]"
        yield f"name = {toml_value(actuator.name)}"
        if actuator.id is not None:
            yield f"id = {actuator.id}"
        if list(actuator.joints.values()) == [1.0]:
            yield f"joint = {toml_value(next(iter(actuator.joints)))}"
        else:
            yield f"joints = {toml_value(actuator.joints)}"
        if actuator.crank:
            yield f"crank = {toml_value(actuator.crank)}"
        yield f"points = {toml_value(actuator.points)} # [rad, {table.unit}]"
        yield f"ends = {toml_value(actuator.ends)}"
        if actuator.limit is not None:
            yield f"limit = {toml_value(actuator.limit)}"
        if actuator.settings:
            yield f"settings = {toml_value(actuator.settings)}"
