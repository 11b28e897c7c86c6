"""Converts the model's joint angles [rad] to a robot's keys and units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

RANGES = {"range_m100_100": (-100.0, 100.0), "range_0_100": (0.0, 100.0)}
"""Units that express a position within a joint's range, and their values at its two ends."""

UNITS = ("degrees", "radians", *RANGES)
"""Units of a robot's joints."""


@dataclass(frozen=True)
class JointKey:
    """One joint of the robot: ``value = offset + factor * angle``, within its bounds.

    Attributes:
        joint: name of the joint in the model.
        key: key of the robot, such as ``index_mcp.pos``.
        factor: change of the value per radian [unit/rad].
        offset: value at the model's zero [unit].
        low: smallest value [unit].
        high: largest value [unit].
    """

    joint: str
    key: str
    factor: float
    offset: float
    low: float = -math.inf
    high: float = math.inf

    def value(self, angle: float) -> float:
        """Converts an angle [rad] to the robot's value."""
        return min(max(self.offset + self.factor * angle, self.low), self.high)

    def angle(self, value: float) -> float:
        """Converts the robot's value to an angle [rad]."""
        return (value - self.offset) / self.factor


def joint_keys(
    joints: Mapping[str, str],
    unit: str,
    *,
    ends: Mapping[str, Sequence[float]],
    signs: Mapping[str, float],
    offsets: Mapping[str, float],
    prefix: str = "",
) -> tuple[JointKey, ...]:
    """Makes the keys of a robot.

    Args:
        joints: model's joint -> robot's joint.
        unit: one of ``UNITS``.
        ends: robot's joint -> the model's angles at the two ends of its range [rad].
        signs: robot's joint -> 1 or -1.
        offsets: robot's joint -> its value at the model's zero [unit].
        prefix: prefix of every key.

    Raises:
        ValueError: the unit is unknown, a range has no ends or equal ends, a sign is not 1 or -1,
            or two joints have the same key.
    """
    if unit not in UNITS:
        raise ValueError(f"unit must be one of {', '.join(UNITS)}, not {unit!r}")
    for setting, given in (("signs", signs), ("offsets", offsets)):
        if given and unit in RANGES:
            raise ValueError(
                f"{setting} are only for degrees and radians; for unit {unit} set ends"
            )
    if ends and unit not in RANGES:
        raise ValueError(f"ends are only for {' and '.join(RANGES)}; {unit} uses signs and offsets")
    keys: dict[str, JointKey] = {}
    for joint, name in joints.items():
        key = f"{prefix}{name}.pos"
        if key in keys:
            raise ValueError(f"joints: two of the model's joints have the robot's key {key}")
        if unit in RANGES:
            first, last = _ends(name, unit, ends)
            least, most = RANGES[unit]
            factor = (most - least) / (last - first)
            keys[key] = JointKey(joint, key, factor, least - factor * first, least, most)
            continue
        sign, offset = float(signs.get(name, 1.0)), float(offsets.get(name, 0.0))
        if sign not in (1.0, -1.0):
            raise ValueError(f"signs: {name} must be 1 or -1, not {sign:g}")
        if not math.isfinite(offset):
            raise ValueError(f"offsets: {name} must be a number, not {offset}")
        per_radian = 180.0 / math.pi if unit == "degrees" else 1.0
        keys[key] = JointKey(joint, key, sign * per_radian, offset)
    return tuple(keys.values())


def check_names(
    joints: Mapping[str, str], of_joints: Mapping[str, Mapping[str, object]], all_joints: bool
) -> None:
    """Check that settings name existing joints; a misspelt name would have no effect.

    Raises:
        ValueError: a setting names an unknown joint.
    """
    for setting, values in of_joints.items():
        for name in values:
            if not all_joints and name not in joints.values():
                known = ", ".join(joints.values())
                raise ValueError(f"{setting}: {name!r} is not one of the robot's joints: {known}")


def _ends(name: str, unit: str, ends: Mapping[str, Sequence[float]]) -> tuple[float, float]:
    if name not in ends:
        raise ValueError(
            f"unit {unit} needs the model's angles at both ends of {name}: "
            f"ends={{{name}: [OPEN, CLOSED]}} [rad]"
        )
    pair = tuple(map(float, ends[name]))
    if len(pair) != 2 or not all(map(math.isfinite, pair)) or abs(pair[0] - pair[1]) < 1e-3:
        raise ValueError(f"ends: {name} must be two different angles [rad], not {list(pair)}")
    return pair[0], pair[1]
