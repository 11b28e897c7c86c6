"""Driver of any hand built of Dynamixel X servos, and of the LEAP hand, which is one."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator_devices.hands.actuator_map import UNITS, ActuatorMap
from smooth_operator_devices.hands.device import DeviceLostError, Reading, Setting, WrongAnswerError
from smooth_operator_devices.hands.drivers.dynamixel_bus import (
    BUS_WATCHDOG,
    CURRENT_BASED_POSITION,
    CURRENT_LIMIT,
    ERRORS,
    GAINS,
    GOAL_CURRENT,
    GOAL_POSITION,
    HARDWARE_ERROR,
    OPERATING_MODE,
    POWER,
    PRESENT,
    TEMPERATURE,
    TORQUE,
    VELOCITY_UNIT,
    VOLATILE,
    DynamixelBus,
)
from smooth_operator_devices.hands.drivers.servo_bank import ServoBank, ServoSink

_SETTINGS: Final = ("baud", "current_unit", "watchdog", *GAINS)
_SLOW_EVERY: Final = 25
"""Number of cycles between two readings of slow registers."""

_SLOW: Final = (HARDWARE_ERROR, TEMPERATURE)
"""Slow registers, which are read in turns."""

_STRUCK: Final = 255
"""Value of the watchdog's register after it has stopped the servo."""


@dataclass(frozen=True)
class DynamixelSink(ServoSink):
    """A hand built of Dynamixel X servos, in current-based position mode.

    The table has the servos' ids. Its unit is ``rad``, ``deg`` or ``step`` (4096 to a turn), and
    its limit the largest current [mA]. ``settings`` may have ``baud``, ``current_unit`` [mA] (1 for
    XL330 and XC330, 2.69 for XM430 and XH540), ``watchdog`` [s], and the gains ``kp``, ``ki``,
    ``kd``, for all servos or for one.
    """

    driver: ClassVar[str] = "dynamixel"
    extra: ClassVar[str] = "dynamixel"

    def device(self, actuators: ActuatorMap) -> DynamixelHand:
        """The servos, not yet open."""
        return DynamixelHand(self.bus, actuators, self.baud)


@dataclass(frozen=True)
class LeapSink(DynamixelSink):
    """The LEAP Hand v1: 16 XC330 servos. Settings as those of ``dynamixel``."""

    driver: ClassVar[str] = "leap"


class DynamixelHand(ServoBank):
    """The servos of a hand; see ``ServoBank``.

    Args:
        actuators: the table.
    """

    driver, name = "dynamixel", "a hand of Dynamixel servos"

    def __init__(self, port: str, actuators: ActuatorMap, baud: int | None = None) -> None:
        super().__init__(actuators, UNITS["step"], _SETTINGS)
        settings = actuators.settings
        self._current_unit = float(settings.get("current_unit", 1.0))
        if not self._current_unit > 0.0:
            raise ConfigError(f"{actuators.file}: current_unit must be over 0 mA")
        self._watchdog = float(settings.get("watchdog", 0.5))
        if not 0.02 <= self._watchdog <= 2.5:
            raise ConfigError(f"{actuators.file}: watchdog must be 0.02 to 2.5 s")
        self._watchdog_steps = max(1, round(self._watchdog / 0.02))
        self._currents = np.zeros(len(self._ids), int)
        baud = int(baud or settings.get("baud", 57600))
        self._bus = DynamixelBus(port, baud, self._ids, actuators.names)
        self._cycle = 0
        self._written = 0.0  # time of the last goals [s]
        self._temperatures: Float[np.ndarray, " a"] | None = None
        self._reported: tuple[str, ...] = ()

    def open(self) -> None:
        """Find the servos, and set mode, gains and currents; their torque is off afterwards."""
        bus = self._bus
        bus.open()
        self._powered = False
        self._cycle = 0
        bus.set(TORQUE, 0)  # the mode can't be changed otherwise
        bus.set(BUS_WATCHDOG, 0)
        modes = bus.get_numbers(OPERATING_MODE)
        for index, mode in enumerate(modes):
            if mode != CURRENT_BASED_POSITION:  # non-volatile, and wears out when written
                bus.set_one(index, OPERATING_MODE, CURRENT_BASED_POSITION)
        most = np.array(bus.get_numbers(CURRENT_LIMIT), float)
        limits = self._table.limits / self._current_unit
        self._currents = np.where(np.isfinite(limits), np.minimum(limits, most), most).astype(int)
        self._limit()
        self._look(HARDWARE_ERROR)
        self._look(TEMPERATURE)

    def _limit(self) -> None:
        """Write gains and currents, and read the currents back, since no servo confirms them."""
        bus = self._bus
        rows = [{**self._table.settings, **a.settings} for a in self._table.actuators]
        for name, register in GAINS.items():
            if all(name in row for row in rows):
                bus.set(register, [int(row[name]) for row in rows])
            else:
                for index, row in enumerate(rows):
                    if name in row:
                        bus.set_one(index, register, int(row[name]))
        bus.set(GOAL_CURRENT, self._currents.tolist())
        if bus.get_numbers(GOAL_CURRENT) != self._currents.tolist():
            raise WrongAnswerError(f"{bus.port}: a servo did not accept its goal current")

    def _switch_on(self, goals: list[int]) -> None:
        """Write limits, torque and goals. A servo that has restarted has no limit."""
        self._bus.set(BUS_WATCHDOG, 0)  # after it struck, a servo refuses currents and goals
        self._limit()
        self._bus.set(TORQUE, 1)
        self._bus.set(GOAL_POSITION, goals)
        self._bus.set(BUS_WATCHDOG, self._watchdog_steps)
        if not self._torque().all():
            raise WrongAnswerError(f"{self._bus.port}: a servo did not switch its torque on")

    def _go(self, goals: list[int]) -> None:
        self._bus.set(GOAL_POSITION, goals)

    def _torque(self) -> Float[np.ndarray, " a"]:
        """1 for each servo with torque, or with an error, which switches its torque off."""
        return np.array([row[0] or row[-1] > 0 for row in self._bus.get(POWER)], int)

    def settings(self) -> Sequence[Setting]:
        """Goal current; with power also watchdog and torque."""
        rows = self._bus.get(VOLATILE)
        currents = np.array([int.from_bytes(row[4:], "little") for row in rows])
        limits = Setting("goal current", self._currents, currents)
        if not self._powered:
            return (limits,)
        watchdogs = [row[0] for row in rows]
        self._refuse_struck(watchdogs)
        every = np.ones(len(rows), int)
        return (
            limits,
            Setting("watchdog", self._watchdog_steps * every, np.array(watchdogs)),
            Setting("torque", every, self._torque()),
        )

    def read(self) -> Reading:
        """Positions, velocities and currents; temperatures and errors in turns."""
        if self._cycle % _SLOW_EVERY == _SLOW_EVERY - 1:
            self._look(_SLOW[self._cycle // _SLOW_EVERY % len(_SLOW)])
        self._cycle += 1
        rows = self._bus.get(PRESENT)
        numbers = [
            [int.from_bytes(row[a:b], "little", signed=True) for a, b in ((0, 2), (2, 6), (6, 10))]
            for row in rows
        ]
        currents, velocities, positions = np.array(numbers, float).T
        return Reading(
            positions / self._scale,
            velocities * VELOCITY_UNIT / self._scale,
            currents * self._current_unit,
            self._temperatures,
            self._reported,
        )

    def write(self, commands: Float[np.ndarray, " a"]) -> None:
        """Send goal positions; the first ones switch the torque on.

        Raises:
            DeviceLostError: the servos' watchdogs have stopped them after a silence. They refuse
                goals until they are opened again.
        """
        before, self._written = self._written, time.perf_counter()
        if self._powered and self._written - before > 0.5 * self._watchdog:
            self._refuse_struck(self._bus.get_numbers(BUS_WATCHDOG))
        super().write(commands)

    def relax(self) -> None:
        """Switch the torque off."""
        self._bus.set(TORQUE, 0)
        self._powered = False

    def close(self) -> None:
        """Stop the servos' watchdog, which is meant for a dead host, and give the port back."""
        with contextlib.suppress(DeviceLostError, WrongAnswerError):
            self._bus.set(BUS_WATCHDOG, 0)
        self._bus.close()

    def _look(self, register: tuple[int, int]) -> None:
        """Read a slow register."""
        values = self._bus.get_numbers(register)
        if register == TEMPERATURE:
            self._temperatures = np.array(values, float)
            return
        self._reported = self._errors(values, ERRORS, "; switch its power off and on")

    def _refuse_struck(self, watchdogs: Sequence[int]) -> None:
        if _STRUCK in watchdogs:
            raise DeviceLostError(
                "the servos stopped themselves, because they received nothing for "
                f"{self._watchdog:g} s"
            )
