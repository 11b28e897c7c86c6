"""Driver of any hand built of Dynamixel X servos, and of the LEAP hand, which is one."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.teleop.hardware.actuator_map import ActuatorMap
from smooth_operator.teleop.hardware.bus_lock import only_port
from smooth_operator.teleop.hardware.device import (
    DeviceLostError,
    Reading,
    Setting,
    WrongAnswerError,
)
from smooth_operator.teleop.hardware.drivers.dynamixel_bus import (
    BUS_WATCHDOG,
    CURRENT_BASED_POSITION,
    CURRENT_LIMIT,
    GAINS,
    GOAL_CURRENT,
    GOAL_POSITION,
    HARDWARE_ERROR,
    OPERATING_MODE,
    POWER,
    PRESENT,
    STEPS,
    TEMPERATURE,
    TORQUE,
    VELOCITY_UNIT,
    VOLATILE,
    DynamixelBus,
    errors_of,
    gains_of,
)
from smooth_operator.teleop.hardware.hardware_sink import HardwareSink

_PER_UNIT: Final = {"step": 1.0, "rad": STEPS / (2 * math.pi), "deg": STEPS / 360.0}
"""Steps of one unit of a table."""

_SETTINGS: Final = ("baud", "current_unit", "watchdog", "kp", "ki", "kd")
_SLOW_EVERY: Final = 25
"""Cycles between two looks at what changes slowly."""

_SLOW: Final = (HARDWARE_ERROR, TEMPERATURE)
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
        if not self._current_unit > 0.0:
            raise ConfigError(f"{actuators.file}: current_unit must be over 0 mA")
        self._watchdog = float(settings.get("watchdog", 0.5))
        if not 0.02 <= self._watchdog <= 2.5:
            raise ConfigError(f"{actuators.file}: watchdog must be 0.02 to 2.5 s")
        self._watchdog_steps = max(1, round(self._watchdog / 0.02))
        self._currents = np.zeros(len(ids), int)
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
        most = np.array(bus.get_numbers(CURRENT_LIMIT), float)
        limits = self._table.limits / self._current_unit
        self._currents = np.where(np.isfinite(limits), np.minimum(limits, most), most).astype(int)
        self._limit()
        self._look(HARDWARE_ERROR)
        self._look(TEMPERATURE)

    def _limit(self) -> None:
        """Write gains and currents, and see that the currents have arrived: no servo confirms what
        is written to all of them.

        Raises:
            WrongAnswerError: a servo has another current than it was sent.
        """
        bus = self._bus
        everywhere = gains_of(self._table.settings)
        rows = [{**everywhere, **gains_of(a.settings)} for a in self._table.actuators]
        for name, register in GAINS.items():
            if all(name in row for row in rows):
                bus.set(register, [row[name] for row in rows])
            elif any(name in row for row in rows):
                for index, row in enumerate(rows):
                    if name in row:
                        bus.set_one(index, register, row[name])
        bus.set(GOAL_CURRENT, self._currents.tolist())
        if bus.get_numbers(GOAL_CURRENT) != self._currents.tolist():
            raise WrongAnswerError(f"{bus.port}: a servo did not take its goal current")

    def _switch_on(self, goals: list[int]) -> None:
        """Limits, torque and goals. A servo that restarted since the last time has no limit."""
        self._bus.set(BUS_WATCHDOG, 0)  # one that has struck refuses currents and goals
        self._limit()
        self._bus.set(TORQUE, 1)
        self._bus.set(GOAL_POSITION, goals)
        self._bus.set(BUS_WATCHDOG, self._watchdog_steps)
        if not self._torque().all():
            raise WrongAnswerError(f"{self._bus.port}: a servo did not switch its torque on")
        self._powered = True

    def _torque(self) -> Float[np.ndarray, " a"]:
        """1 for each servo with torque, or with an error, for which it switches its torque off."""
        return np.array([row[0] or row[-1] > 0 for row in self._bus.get(POWER)], int)

    def settings(self) -> Sequence[Setting]:
        """Goal current; with power watchdog and torque, too."""
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
            self._refuse_struck(self._bus.get_numbers(BUS_WATCHDOG))
        if self._powered:
            self._bus.set(GOAL_POSITION, goals)
        else:
            self._switch_on(goals)

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
        self._errors = tuple(
            f"{name}: {errors_of(bits)}; switch its power off and on"
            for name, bits in zip(self._table.names, values, strict=True)
            if bits
        )

    def _refuse_struck(self, watchdogs: Sequence[int]) -> None:
        if _STRUCK in watchdogs:
            raise DeviceLostError(
                f"the servos stopped themselves: nothing reached them for {self._watchdog:g} s"
            )
