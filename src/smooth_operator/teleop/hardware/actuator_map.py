"""Maps between the joints of a hand's model and the commands of its real actuators.

Each actuator follows a drive angle [rad], a weighted sum of model joints, by a monotonic
piecewise-linear curve. The curve and its ends come from a table, measured on the real hand or by
the maker; the limits of our model are not used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.hands.hand import Hand
from smooth_operator.types import Side

Rest: TypeAlias = Literal["hold", "relax"]
"""Rest of a hand without a command: stand still under power, or give way."""

_KNOWN: Final = 1e-6
"""Tolerance of the share of a joint that the actuators determine."""


@dataclass(frozen=True)
class Actuator:
    """One actuator of a real hand.

    Attributes:
        name: the maker's or the user's name for it.
        joints: model joint -> weight: the drive angle is the weighted sum of their positions [rad].
            One joint with weight 1 in most hands; ``{"a": 0.5, "b": 0.5}`` where one motor moves
            two joints of the model together; ``{"a": 1.0, "b": -1.0}`` for one of a differential.
        points: (drive angle [rad], command) in rising order of the angle, two or more; commands
            rise strictly or fall strictly. In between, the map is linear; beyond, it goes on with
            the slope of the last piece, up to ``ends``.
        ends: lowest and highest command.
        id: number on the bus; None if it has none.
        limit: limit of current [mA], or of force, in the driver's unit; None for the table's.
        settings: further settings for the driver.

    Raises:
        ConfigError: the points are not monotonic, or the ends are not in order.
    """

    name: str
    joints: Mapping[str, float]
    points: tuple[tuple[float, float], ...]
    ends: tuple[float, float]
    id: int | None = None
    limit: float | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
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
            rising = (steps > 0).all()
            if not (rising or (what == "commands" and (steps < 0).all())):
                k = int(
                    np.argmax((steps <= 0) if steps[0] > 0 or what != "commands" else steps >= 0)
                )
                raise ConfigError(
                    f"the map of actuator {self.name!r} is not monotonic: its {what} go from "
                    f"{values[k]:g} to {values[k + 1]:g}; list the points by rising drive angle, "
                    "with commands that always rise or always fall"
                )
        low, high = self.ends
        if not (np.isfinite(self.ends).all() and low < high):
            raise ConfigError(
                f"actuator {self.name!r}: ends must be the least command, then the greatest, not "
                f"[{low:g}, {high:g}]"
            )

    def command(self, angle: float) -> float:
        """Command for a drive angle [rad]; not limited to the ends."""
        angles, commands = np.array(self.points, float).T
        return _linear(angle, angles, commands)

    def angle(self, command: float) -> float:
        """Drive angle [rad] that a command stands for; beyond the ends, too."""
        angles, commands = np.array(self.points, float).T
        if commands[0] > commands[-1]:
            angles, commands = angles[::-1], commands[::-1]
        return _linear(command, commands, angles)


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
                    f"{self.file}: limit must be over 0 and finite, not {limit:g}; leave it out to "
                    "have the device's own"
                )
        for settings in (self.settings, *(a.settings for a in self.actuators)):
            for name, value in settings.items():
                if isinstance(value, float) and not np.isfinite(value):
                    raise ConfigError(f"{self.file}: {name} must be finite, not {value:g}")
        if not 1.0 <= self.rate <= 1000.0:
            raise ConfigError(f"{self.file}: rate must be 1 to 1000 Hz, not {self.rate:g}")

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
        """Refuse a table with another number of actuators than the hand has.

        Raises:
            ConfigError: with the file, the hand (``an Ability Hand``) and both numbers.
        """
        if len(self.actuators) != count:
            raise ConfigError(
                f"{self.file}: {hand} has {count} actuators, not {len(self.actuators)}"
            )

    def bind(self, hand: Hand) -> BoundMap:
        """The map for the joints of a loaded hand.

        Raises:
            UnknownNameError: the hand has no such joint.
        """
        return BoundMap(self, hand)


class BoundMap:
    """An actuator map as arrays, for the joints of one loaded hand.

    Args:
        actuators: the table, of a actuators.
        hand: the hand, of n joints.

    Attributes:
        table: the table.
        names: (n,) names of the model's joints.
        ends: (a, 2) lowest and highest command.
        determined: (n,) True for a joint that the actuators determine, directly or by a coupling.

    Raises:
        ConfigError: the table is that of another hand, with other joints.
        UnknownNameError: the hand has no such joint.
    """

    def __init__(self, actuators: ActuatorMap, hand: Hand) -> None:
        self.table, self.names = actuators, hand.joint_names
        count = len(actuators.actuators)
        self.ends = np.array([actuator.ends for actuator in actuators.actuators], float)
        self._weights = np.zeros((count, len(self.names)))
        for row, actuator in zip(self._weights, actuators.actuators, strict=True):
            for joint, weight in actuator.joints.items():
                if joint not in self.names and actuators.hand != hand.name:
                    raise ConfigError(
                        f"{Path(actuators.file).name} is the table of the hand "
                        f"{actuators.hand!r}, and the run's hand is {hand.name!r}: choose --hand "
                        f"{actuators.hand}, or another table with table=FILE"
                    )
                if joint not in self.names:
                    raise UnknownNameError(
                        f"joint of hand {hand.name!r} in {actuators.file}:",
                        joint,
                        self.names,
                        f"The table is for {actuators.hand!r}: choose it with --hand, or another "
                        "table with table=FILE.",
                    )
                row[self.names.index(joint)] += weight
        self._curves = [_curve(actuator.points) for actuator in actuators.actuators]
        # q = C qa + o of the model's own couplings, and drive angles x = W q: solved for qa, with
        # the least norm where one actuator moves several joints.
        self._gears, self._offset = hand.coupling_matrix, hand.coupling_offset
        reduced = self._weights @ self._gears
        self._inverse = np.linalg.pinv(reduced)
        touched = (self._weights @ self._gears != 0).any(axis=0)
        self.determined: Bool[np.ndarray, " n"] = (np.abs(self._gears) @ ~touched < _KNOWN) & (
            np.abs(self._gears).sum(axis=1) > 0
        )

    def angles(self, positions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " a"]:
        """(a,) drive angles [rad] of joint positions [rad]."""
        result: np.ndarray = self._weights @ positions
        return result

    def commands(self, angles: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
        """(a,) commands for drive angles [rad], not limited to the ends."""
        pairs = zip(angles, self._curves, strict=True)
        return np.array([_linear(angle, curve[0], curve[1]) for angle, curve in pairs])

    def clip(self, commands: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
        """Commands within the ends."""
        clipped: np.ndarray = np.clip(commands, self.ends[:, 0], self.ends[:, 1])
        return clipped

    def drive_angles(self, commands: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
        """(a,) drive angles [rad] that commands, or measured positions, stand for; NaN for NaN."""
        pairs = zip(commands, self._curves, strict=True)
        return np.array([_linear(value, curve[2], curve[3]) for value, curve in pairs])

    def joints(self, commands: Float[np.ndarray, " a"]) -> Float[np.ndarray, " n"]:
        """(n,) joint positions [rad] that measured positions stand for.

        Returns:
            NaN for a joint that no actuator moves, or whose actuator's position is NaN.
        """
        angles = self.drive_angles(commands) - self._weights @ self._offset
        result: np.ndarray = self._spread(angles) + self._offset
        return result

    def joint_velocities(
        self, commands: Float[np.ndarray, " a"], rates: Float[np.ndarray, " a"]
    ) -> Float[np.ndarray, " n"]:
        """(n,) joint velocities [rad/s] from measured positions and velocities of actuators."""
        step = 1e-3
        ahead = self.drive_angles(commands + step * rates)
        return self._spread((ahead - self.drive_angles(commands)) / step)

    def _spread(self, angles: Float[np.ndarray, " a"]) -> Float[np.ndarray, " n"]:
        missing = ~np.isfinite(angles)
        spread: np.ndarray = self._gears @ (self._inverse @ np.where(missing, 0.0, angles))
        unknown = ~self.determined
        if missing.any():
            lost = (np.abs(self._inverse[:, missing]) > _KNOWN).any(axis=1)
            unknown = unknown | ((np.abs(self._gears) @ lost) > 0)
        spread[unknown] = np.nan
        return spread


_Curve: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _curve(points: Sequence[tuple[float, float]]) -> _Curve:
    """Angles and commands by rising angle, and commands and angles by rising command."""
    angles, commands = np.array(points, float).T
    order = 1 if commands[-1] > commands[0] else -1
    return angles, commands, commands[::order].copy(), angles[::order].copy()


def _linear(value: ArrayLike, xs: np.ndarray, ys: np.ndarray) -> float:
    """Piecewise-linear through points, with the outer slopes beyond them; NaN for NaN."""
    value = float(np.asarray(value))
    if value < xs[0] or value > xs[-1]:
        a, b = (0, 1) if value < xs[0] else (-2, -1)
        return float(ys[b] + (value - xs[b]) * (ys[b] - ys[a]) / (xs[b] - xs[a]))
    return float(np.interp(value, xs, ys))
