"""Stamps of messages in seconds, milliseconds, microseconds or nanoseconds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, Literal, TypeAlias

from smooth_operator.errors import RecordingError
from smooth_operator.teleop.sources.live import LATEST_STAMP_S
from smooth_operator.teleop.sources.point_forms import short
from smooth_operator.types import Side

StampUnit: TypeAlias = Literal["s", "ms", "us", "ns"]
"""Unit of stamps, the setting ``stamp_unit``."""

_PARTS: Final[dict[StampUnit, int]] = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}
_NAMES: Final = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}


def read_stamp(message: Mapping[str, Any], unit: StampUnit = "s") -> float | None:
    """The stamp of a message [s], None where it has none.

    Args:
        message: it is under ``stamp`` or ``timestamp``.
        unit: what it is in.

    Raises:
        RecordingError: it is no finite number, or far beyond any clock in this unit; the message
            names the setting ``stamp_unit``.
    """
    stamp = message.get("stamp", message.get("timestamp"))
    if stamp is None:
        return None
    if isinstance(stamp, bool) or not isinstance(stamp, (int, float)) or not _finite(stamp):
        raise RecordingError(f"the stamp must be a finite number of seconds, not {short(stamp)}")
    seconds = float(stamp / _PARTS[unit])  # a whole number of ns is divided without rounding first
    if abs(seconds) < LATEST_STAMP_S:
        return seconds
    likely = next((u for u, n in _PARTS.items() if abs(stamp) / n < LATEST_STAMP_S), None)
    hint = (
        f"; it looks like {_NAMES[likely]} (multiply by {1 / _PARTS[likely]:g}); send seconds, or "
        f"give the source stamp_unit={likely}"
        if likely
        else "; give the source stamp_unit=s, ms, us or ns, whichever the tracker sends"
    )
    said = "in seconds" if unit == "s" else f"in {unit} (stamp_unit={unit})"
    raise RecordingError(f"the stamp must be {said}, not {stamp:.6g}{hint}")


def _finite(value: int | float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond all floats
        return False


class StampPace:
    """Finds a wrong unit by the pace of the stamps: seconds that look like a year pass any bound.

    Args:
        unit: what the stamps are said to be in.
    """

    WINDOW_S: Final = 1.0
    """Time of receipt over which the pace is measured [s]."""
    _FEWEST: Final = 10

    def __init__(self, unit: StampUnit) -> None:
        self._unit = unit
        self._windows: dict[Side, tuple[float, float, int]] = {}
        self._wrong: dict[Side, str] = {}

    def check(self, side: Side, stamp: float, received: float) -> None:
        """Take note of a stamp.

        Args:
            side: which hand it is of.
            stamp: as it was read [s].
            received: when it came [s].

        Raises:
            RecordingError: over the last window the stamps ran about 10^3, 10^6 or 10^9 times too
                fast or too slowly, which another unit explains. The message names the setting.
        """
        start, at, count = self._windows.setdefault(side, (stamp, received, 0))
        self._windows[side] = (start, at, count + 1)
        if received - at >= self.WINDOW_S and count >= self._FEWEST:
            self._wrong[side] = self._judge((stamp - start) / (received - at))
            del self._windows[side]
        if self._wrong.get(side):
            raise RecordingError(self._wrong[side])

    def _judge(self, pace: float) -> str:
        for unit, parts in _PARTS.items():
            times = parts / _PARTS[self._unit]
            if unit != self._unit and 0.5 * times < pace < 2.0 * times:
                return (
                    f"the stamps run {pace:.3g} times as fast as the clock of this computer: they "
                    f"look like {_NAMES[unit]}; give the source stamp_unit={unit}"
                )
        return ""
