"""Two readings of a hand that agree: one alone may be wrong, and a motion would begin from it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

import numpy as np

from smooth_operator.teleop.hardware.actuator_map import ActuatorMap
from smooth_operator.teleop.hardware.device import DeviceLostError, Reading

_AGREE: Final = 0.15
"""How far apart two readings may be [rad]: a fast finger moves so far between them, 10 rad/s for
15 ms."""

_APART_S: Final = 0.01
"""Time between two readings [s]: a damaged report that is kept for a few ms is not read twice."""

_READINGS: Final = 3


def apart(first: Reading, second: Reading, table: ActuatorMap) -> list[int]:
    """Indices of the actuators whose positions differ by more than a motion explains."""
    one, other = (
        np.array([a.angle(v) for a, v in zip(table.actuators, reading.positions, strict=True)])
        for reading in (first, second)
    )
    same = np.isclose(one, other, rtol=0.0, atol=_AGREE, equal_nan=True)
    return [int(index) for index in np.flatnonzero(~same)]


def agreed_reading(read: Callable[[], Reading], table: ActuatorMap) -> Reading:
    """Where the hand is, by two readings within 0.15 rad of each other; a third may decide.

    Args:
        read: one exchange with the hand; takes some ms.
        table: the hand's, for the angles and names of its actuators.

    Returns:
        The later of the two.

    Raises:
        DeviceLostError: no two of three readings agree.
        WrongAnswerError: an exchange failed.
    """
    readings = [read()]
    while len(readings) < _READINGS:
        time.sleep(_APART_S)
        readings.append(read())
        if any(not apart(earlier, readings[-1], table) for earlier in readings[:-1]):
            return readings[-1]
    index = apart(readings[-2], readings[-1], table)[0]
    values = ", ".join(f"{reading.positions[index]:.6g}" for reading in readings)
    raise DeviceLostError(
        f"{table.names[index]}: {_READINGS} readings of its position within a moment differ, "
        f"{values} {table.unit}; check its cable and power, and that nothing moves the hand"
    )
