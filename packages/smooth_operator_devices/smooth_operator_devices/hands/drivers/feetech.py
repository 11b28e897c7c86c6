"""Driver of any hand built of Feetech bus servos: SCS0009, STS3215 and others of their series.

Facts, by the maker: registers from ``ftservo-python-sdk`` 2.0.1 (``scservo_sdk``) and from
github.com/ftservo/ftservo-wiki, commit a1c18bd; stall and overload from the data sheet
ST-3215-C018.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np

from smooth_operator.errors import ConfigError, require
from smooth_operator_devices.hands.actuator_map import UNITS, ActuatorMap
from smooth_operator_devices.hands.device import Reading, Setting, WrongAnswerError
from smooth_operator_devices.hands.drivers.feetech_bus import FeetechBus
from smooth_operator_devices.hands.drivers.servo_bank import ServoBank, ServoSink

_TORQUE, _GOAL, _TORQUE_LIMIT = 40, 42, 48
_VOLATILE: Final = (40, 10)
"""Torque in the first byte; torque limit of the STS in the last two."""
_PRESENT: Final = (56, 10)
"""Position, speed, load (2 bytes each), voltage, temperature, waiting, status."""

_OVERLOAD: Final = 0x20
_ERRORS: Final = {0x01: "voltage", 0x02: "angle sensor", 0x04: "too hot", 0x08: "overcurrent"} | {
    _OVERLOAD: "overload"
}
"""Bits of the status, and of the error byte of every answer."""


@dataclass(frozen=True)
class FeetechSink(ServoSink):
    """Moves a hand built of Feetech servos, of the SCS or STS series.

    The table has the servos' ids. Its unit is ``rad``, ``deg``, ``step`` (4096 to a turn) or
    ``scs_step`` (1024 to 300 degrees), and its limit a share of the largest load [%].
    ``settings`` may have ``baud`` (1000000).

    Attributes:
        series: series of all servos; None to find it by their model numbers.
    """

    driver: ClassVar[str] = "feetech"
    extra: ClassVar[str] = "feetech"

    series: Literal["scs", "sts"] | None = None

    def device(self, actuators: ActuatorMap) -> FeetechHand:
        """The servos, not yet open."""
        require(FeetechHand.name, "feetech", "serial")
        return FeetechHand(self.bus, actuators, self.baud, self.series)


class FeetechHand(ServoBank):
    """The servos of a hand; see ``ServoBank``.

    ``Reading.currents`` is the load, a share of the largest one [%]: the SCS0009 measures no
    current. A servo without goals holds its last one for ever: it has no watchdog.
    """

    driver, name = "feetech", "a hand of Feetech servos"

    def __init__(
        self, port: str, actuators: ActuatorMap, baud: int | None = None, series: str | None = None
    ) -> None:
        super().__init__(actuators, math.nan, ("baud",))  # the scale is that of the series
        limits = np.nan_to_num(actuators.limits, nan=100.0)
        if (limits > 100).any() or (limits < 1).any():
            raise ConfigError(f"{actuators.file}: limit must be 1 to 100 % of the largest load")
        self._limits, self._series = np.rint(10 * limits).astype(int), series
        baud = int(baud or actuators.settings.get("baud", 1_000_000))
        self._bus = FeetechBus(port, baud, self._ids, actuators.names)
        self._goals: list[int] = []
        self._overloaded: list[bool] = []

    def open(self) -> None:
        """Find the servos and limit their torque, which is off afterwards; see ``HandDevice``."""
        self._bus.open(self._series)
        self._scale = self._bus.series.per_radian / UNITS[self._table.unit]
        self.relax()
        self._limit()
        self._overloaded = [False] * len(self._ids)

    def _limit(self) -> None:
        """Write limits of torque, and read them back, since no servo confirms them."""
        if not self._bus.series.torque_limit:
            return
        self._bus.set(_TORQUE_LIMIT, [self._bus.word(limit) for limit in self._limits.tolist()])
        if (self._limit_and_torque()[0] != self._limits).any():
            raise WrongAnswerError(f"{self._bus.port}: a servo did not accept its torque limit")

    def _limit_and_torque(self) -> tuple[np.ndarray, np.ndarray]:
        rows = self._bus.get(*_VOLATILE)
        limits = [self._bus.number(row[-2:]) for row in rows]
        return np.array(limits), np.array([row[1] for row in rows])

    def _switch_on(self, goals: list[int]) -> None:
        self._limit()
        self._overloaded = [False] * len(goals)
        self._go(goals)
        self._bus.set(_TORQUE, [b"\1"] * len(goals))
        self._go(goals)
        if (self._limit_and_torque()[1] != 1).any():
            raise WrongAnswerError(f"{self._bus.port}: a servo did not switch its torque on")

    def _go(self, goals: list[int]) -> None:
        """Send goals; an overloaded servo gets no goal twice, which would end its protection."""
        before = self._goals if len(self._goals) == len(goals) else [None] * len(goals)
        rows = zip(self._ids, goals, before, self._overloaded, strict=True)
        new = {n: self._bus.word(goal) for n, goal, old, over in rows if goal != old or not over}
        if new:
            self._bus.set(_GOAL, [*new.values()], [*new])
        self._goals = goals

    def settings(self) -> Sequence[Setting]:
        """Limits of torque (STS), and with power the torque; see ``HandDevice``."""
        found = []
        if self._bus.series.torque_limit or self._powered:
            limits, torque = self._limit_and_torque()
            if self._bus.series.torque_limit:
                found.append(Setting("torque limit", self._limits, limits))
            if self._powered:
                found.append(Setting("torque", np.ones(len(torque)), torque))
        return found

    def read(self) -> Reading:
        """Positions, speeds, loads, temperatures and errors; see ``HandDevice``."""
        rows = self._bus.get(*_PRESENT)
        words = [
            [self._bus.number(row[a : a + 2], sign) for a, sign in ((1, 15), (3, 15), (5, 10))]
            for row in rows
        ]
        positions, speeds, loads = np.array(words, float).T
        status = [row[0] | row[10] for row in rows]
        self._overloaded = [bool(value & _OVERLOAD) for value in status]
        return Reading(
            positions / self._scale,
            speeds / self._scale,
            loads / 10.0,
            np.array([row[8] for row in rows], float),
            self._errors(status, _ERRORS),
        )

    def relax(self) -> None:
        """Switch the torque off."""
        self._bus.set(_TORQUE, [b"\0"] * len(self._ids))
        self._powered = False

    def close(self) -> None:
        """Give the port back; the servos hold their last goals if they have torque."""
        self._bus.close()
