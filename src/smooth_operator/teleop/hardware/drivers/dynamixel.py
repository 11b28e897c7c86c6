"""Driver of any hand built of Dynamixel X servos, and of the LEAP hand, which is one."""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.hardware.actuator_map import ActuatorMap
from smooth_operator.teleop.hardware.device import DeviceLostError, Reading, WrongAnswerError
from smooth_operator.teleop.hardware.drivers.dynamixel_bus import (
    BUS_WATCHDOG,
    CURRENT_BASED_POSITION,
    CURRENT_LIMIT,
    GAINS,
    GOAL_CURRENT,
    GOAL_POSITION,
    HARDWARE_ERROR,
    OPERATING_MODE,
    PRESENT,
    STEPS,
    TEMPERATURE,
    TORQUE,
    VELOCITY_UNIT,
    DynamixelBus,
    errors_of,
    gains_of,
)
from smooth_operator.teleop.hardware.hardware_sink import HardwareSink
from smooth_operator.teleop.hardware.serial_port import only_port

_PER_UNIT: Final = {"step": 1.0, "rad": STEPS / (2 * math.pi), "deg": STEPS / 360.0}
"""Steps of one unit of a table."""

_SETTINGS: Final = ("baud", "current_unit", "watchdog", "kp", "ki", "kd")
_SLOW_EVERY: Final = 25
"""Cycles between two looks at what changes slowly."""

_SLOW: Final = (HARDWARE_ERROR, BUS_WATCHDOG, TEMPERATURE)
"""What is looked at in turns."""

_STRUCK: Final = 255
"""What a servo's watchdog register holds once it has stopped the servo."""


@dataclass(frozen=True)
class DynamixelSink(HardwareSink):
    """A hand built of Dynamixel X servos, in current-based position mode.

    The table has the servos' ids; its unit is ``rad``, ``deg`` or ``step`` (4096 to a turn), its
    limit the most current [mA]. ``settings`` may have ``baud``, ``current_unit`` [mA] (1 for XL330
    and XC330, 2.69 for XM430 and XH540), ``watchdog`` [s], and the gains ``kp``, ``ki``, ``kd``,
    for all servos or for one.

    Attributes:
        baud: bits per second; None as the table says.
    """

    driver: ClassVar[str] = "dynamixel"

    baud: int | None = None

    @property
    def bus(self) -> str:
        """The serial port; the only one, if none is named."""
        return self.port or only_port(self.driver, "dynamixel")

    def device(self, actuators: ActuatorMap) -> DynamixelHand:
        """The servos, not yet open."""
        return DynamixelHand(self.bus, actuators, self.baud)


@dataclass(frozen=True)
class LeapSink(DynamixelSink):
    """The LEAP Hand v1: 16 XC330 servos. Settings as those of ``dynamixel``."""

    driver: ClassVar[str] = "leap"


class DynamixelHand:
    """The servos of a hand, as ``HandDevice``.

    Args:
        port: the serial port.
        actuators: the table.
        baud: bits per second; None as the table says, or 57600, the servos' own.

    Raises:
        ConfigError: the table lacks an id, or has a unit or setting that servos don't.
        MissingExtraError: the SDK is not installed.
    """

    def __init__(self, port: str, actuators: ActuatorMap, baud: int | None = None) -> None:
        self._table, settings = actuators, actuators.settings
        for where in (settings, *(a.settings for a in actuators.actuators)):
            for name in where:
                if name not in _SETTINGS:
                    raise ConfigError(
                        f"{actuators.file}: servos have no setting {name!r}; known: "
                        f"{', '.join(_SETTINGS)}"
                    )
        if actuators.unit not in _PER_UNIT:
            raise ConfigError(
                f"{actuators.file}: the unit of servos is {' or '.join(_PER_UNIT)}, not "
                f"{actuators.unit!r}"
            )
        ids = [a.id for a in actuators.actuators if a.id is not None]
        if len(ids) < len(actuators.actuators) or not all(0 <= number <= 252 for number in ids):
            raise ConfigError(f"{actuators.file}: every servo needs an id of 0 to 252")
        self._scale = _PER_UNIT[actuators.unit]
        self._current_unit = float(settings.get("current_unit", 1.0))
        self._watchdog = float(settings.get("watchdog", 0.5))
        if not 0.02 <= self._watchdog <= 2.5:
            raise ConfigError(f"{actuators.file}: watchdog must be 0.02 to 2.5 s")
        self._bus = DynamixelBus(
            port, int(baud or settings.get("baud", 57600)), ids, actuators.names
        )
        self._powered = False
        self._cycle = 0
        self._written = 0.0  # when goals were written last
        self._temperatures: Float[np.ndarray, " a"] | None = None
        self._errors: tuple[str, ...] = ()

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
            if mode != CURRENT_BASED_POSITION:  # kept without power, and wears out when written
                bus.set_one(index, OPERATING_MODE, CURRENT_BASED_POSITION)
        everywhere = gains_of(self._table.settings)
        for name, register in GAINS.items():
            rows = [{**everywhere, **gains_of(a.settings)} for a in self._table.actuators]
            if all(name in row for row in rows):
                bus.set(register, [row[name] for row in rows])
            elif any(name in row for row in rows):
                for index, row in enumerate(rows):
                    if name in row:
                        bus.set_one(index, register, row[name])
        most = np.array(bus.get_numbers(CURRENT_LIMIT), float)
        limits = self._table.limits / self._current_unit
        wanted = np.where(np.isfinite(limits), np.minimum(limits, most), most)
        bus.set(GOAL_CURRENT, [int(value) for value in wanted])
        self._look(HARDWARE_ERROR)
        self._look(TEMPERATURE)

    def read(self) -> Reading:
        """Positions, velocities and currents; temperatures, errors and watchdogs in turns."""
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
            self._errors,
        )

    def write(self, commands: Float[np.ndarray, " a"]) -> None:
        """Goal positions; the first ones switch the torque on.

        Raises:
            DeviceLostError: the servos' watchdogs have stopped them, since nothing reached them for
                too long. They refuse goals until they are opened again.
        """
        goals = [round(value * self._scale) for value in commands.tolist()]
        before, self._written = self._written, time.perf_counter()
        if self._powered and self._written - before > 0.5 * self._watchdog:
            self._look(BUS_WATCHDOG)
        if not self._powered:
            self._bus.set(BUS_WATCHDOG, 0)  # one that has struck refuses goals
            self._bus.set(TORQUE, 1)
            self._bus.set(GOAL_POSITION, goals)
            self._bus.set(BUS_WATCHDOG, max(1, round(self._watchdog / 0.02)))
        else:
            self._bus.set(GOAL_POSITION, goals)
        self._powered = True

    def relax(self) -> None:
        """Torque off."""
        self._bus.set(TORQUE, 0)
        self._powered = False

    def close(self) -> None:
        """Stop the servos' watchdog, which is for a host that died, and give the port back."""
        with contextlib.suppress(DeviceLostError, WrongAnswerError):
            self._bus.set(BUS_WATCHDOG, 0)
        self._bus.close()

    def _look(self, register: tuple[int, int]) -> None:
        """Read what changes slowly."""
        values = self._bus.get_numbers(register)
        if register == TEMPERATURE:
            self._temperatures = np.array(values, float)
            return
        if register == BUS_WATCHDOG:
            if self._powered and _STRUCK in values:
                raise DeviceLostError(
                    f"the servos stopped themselves: nothing reached them for {self._watchdog:g} s"
                )
            return
        self._errors = tuple(
            f"{name}: {errors_of(bits)}; switch its power off and on"
            for name, bits in zip(self._table.names, values, strict=True)
            if bits
        )
