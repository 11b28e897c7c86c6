"""Guard of a real hand: converts target joint positions to safe commands of the actuators.

It has no clock, thread or bus: its commands follow from its arguments, as in the loop's limiter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.settings import check_range
from smooth_operator_devices.hands.actuator_map import BoundMap
from smooth_operator_devices.hands.device import Reading

_CAUGHT_UP: Final = 0.03
"""Distance from the target at which a slow approach ends [rad]."""

_STALLED: Final = 0.3
"""Speed towards its command below which an actuator with a high current counts as blocked
[rad/s]; a free one moves when it pulls as hard."""

_BEYOND: Final = 0.35
"""Angle beyond an end of its table at which an actuator may begin a motion [rad]."""

_MARGIN: Final = 0.1
"""Angle beyond the measured position at which a squeezing command may stay [rad]."""


@dataclass(frozen=True)
class GuardSettings:
    """Settings of the guard of commands.

    Attributes:
        approach: speed of an actuator that is on its way to the operator's hand [rad/s].
        speed: speed limit of every actuator [rad/s].
        contact: share of the limit of current or force from which an actuator counts as
            squeezing; 0 switches the contact guard off.
        contact_s: time for which the current must stay there [s].

    Raises:
        ConfigError: a setting is out of its range.
    """

    approach: float = 0.5
    speed: float = 15.0
    contact: float = 0.8
    contact_s: float = 0.2

    def __post_init__(self) -> None:
        if not 0.0 < self.approach <= self.speed <= 50.0:
            raise ConfigError(
                "approach must be over 0 and at most speed, and speed at most 50 rad/s, not "
                f"{self.approach:g} and {self.speed:g}"
            )
        check_range("contact", self.contact, 0.0, 1.0)
        check_range("contact_s", self.contact_s, 1e-3, 10.0, "s")


class CommandGuard:
    """Makes safe commands: approaches slowly, limits range and speed, and stops squeezing joints.

    A command moves on from the last one only after a new reading, by at most ``speed`` times the
    time of a step. A hand that does not answer keeps its command; after missed periods ``start``
    begins at its position. Therefore no command is further from the last measured position than
    ``speed`` times the reading's age plus the lag of the hand at the measurement. An actuator
    without a position holds.

    The lag itself has no bound. A bound for ``speed`` 0.5 rad/s at 60 Hz would be 0.008 rad, five
    steps of a servo, which does not start for so little; and a finger that holds an object lags
    behind its command while it holds, in a hand without currents (Linker) by up to its whole range.
    With measured currents the contact guard bounds the lag to 0.1 rad.

    Args:
        actuators: the map of the hand, of a actuators.
        settings: the limits.

    Attributes:
        approaching: (a,) True for actuators in a slow approach to their target.
        squeezing: (a,) direction in which an actuator must not move on; 0 if it is free.
        contacts: number of stops of an actuator.
    """

    def __init__(self, actuators: BoundMap, settings: GuardSettings) -> None:
        count = len(actuators.ends)
        self._map, self._settings = actuators, settings
        self._levels = settings.contact * actuators.table.limits
        self._at: Float[np.ndarray, " a"] | None = None
        self._ends = actuators.ends.copy()
        self.approaching = np.ones(count, bool)
        self.squeezing = np.zeros(count)
        self.contacts = 0
        self._bound = np.zeros(count)  # limit of the drive angle of a squeezing actuator [rad]
        self._touched = np.zeros(count)  # measured angle at the contact [rad]
        self._loaded_s = np.zeros(count)  # time of a high current without motion [s]
        self._before: Float[np.ndarray, " a"] | None = None  # measured angle of the last step
        self._reading: Reading | None = None  # reading of the last step, or of the start

    def start(self, reading: Reading) -> None:
        """Begin a slow approach from the hand's position, which is the first command.

        Args:
            reading: position of the hand, confirmed by two readings.

        Raises:
            SinkError: a position is not known, or more than 0.35 rad beyond the table's ends.
        """
        measured = reading.positions
        missing = [n for n, v in zip(self._map.table.names, measured, strict=True) if v != v]
        if missing:
            raise SinkError(
                f"{', '.join(missing)} did not report a position, and the hand is not moved until "
                "its position is known; check its cables and power"
            )
        angles = self._map.drive_angles(measured)
        beyond = np.abs(angles - self._map.drive_angles(self._map.clip(measured)))
        worst = int(np.argmax(beyond))
        if beyond[worst] > _BEYOND:
            table, (low, high) = self._map.table, self._map.ends[worst]
            raise SinkError(
                f"{table.names[worst]} is at {measured[worst]:.6g} {table.unit}, "
                f"{beyond[worst]:.3g} rad beyond its ends {low:.6g} and {high:.6g}, so it is "
                "not moved: the servo may be one turn off, or the table's zero may be "
                "wrong. If the finger really is there, move it between the ends by hand"
            )
        self._at, self._reading, self._before = angles, reading, None
        low, high = self._map.ends.T
        self._ends = np.stack([np.minimum(low, measured), np.maximum(high, measured)], axis=1)
        self.approaching[:] = True
        self.squeezing[:] = 0.0
        self._loaded_s[:] = 0.0

    def step(
        self, target_positions: Float[np.ndarray, " n"], reading: Reading, seconds: float
    ) -> Float[np.ndarray, " a"]:
        """Computes the next commands.

        Args:
            target_positions: (n,) target joint positions [rad].
            reading: last reading of the hand; the same object while there is no new one.
            seconds: time since the last step [s].

        Returns:
            (a,) commands in the actuators' unit.

        Raises:
            SinkError: ``start`` was not called.
        """
        if self._at is None:
            raise SinkError("the guard was not started with the position of the hand")
        target = self._map.clip(self._map.commands(self._map.angles(target_positions)))
        angles = self._map.drive_angles(target)
        if reading is self._reading:
            seconds = 0.0  # there is no new measurement
        self._reading = reading
        self._feel(reading, seconds)
        angles = self._release(angles)
        speed = np.where(self.approaching, self._settings.approach, self._settings.speed)
        top = np.where(np.isfinite(reading.positions), speed * seconds, 0.0)
        self._at = self._at + np.clip(angles - self._at, -top, top)
        self.approaching &= np.abs(angles - self._at) > _CAUGHT_UP
        commands: np.ndarray = np.clip(
            self._map.commands(self._at), self._ends[:, 0], self._ends[:, 1]
        )
        # A hand that began beyond an end can't go back there once it has come in.
        low, high = self._map.ends.T
        self._ends[:, 0] = np.minimum(low, np.maximum(self._ends[:, 0], commands))
        self._ends[:, 1] = np.maximum(high, np.minimum(self._ends[:, 1], commands))
        return commands

    def _feel(self, reading: Reading, seconds: float) -> None:
        """Detect currents that stay high."""
        if reading.currents is None or self._at is None:
            return
        measured = self._map.drive_angles(reading.positions)
        ahead = self._at - measured
        before, self._before = self._before, measured
        if before is None or not seconds > 0.0:
            return
        loaded = np.abs(reading.currents) >= self._levels  # False where either is NaN
        loaded &= np.sign(ahead) * (measured - before) / seconds < _STALLED
        self._loaded_s = np.where(loaded, self._loaded_s + seconds, 0.0)
        began = (
            (self._loaded_s >= self._settings.contact_s)
            & (self.squeezing == 0)
            & (self._levels > 0)
            & np.isfinite(measured)
            & (ahead != 0)
        )
        if began.any():
            self.contacts += int(began.sum())
            self.squeezing = np.where(began, np.sign(ahead), self.squeezing)
            self._touched = np.where(began, measured, self._touched)
            stop = measured + np.clip(ahead, -_MARGIN, _MARGIN)
            self._bound = np.where(began, stop, self._bound)
        # The object is gone, so the actuator may go on, slowly.
        gone = (self.squeezing != 0) & (self.squeezing * (measured - self._touched) > 1.5 * _MARGIN)
        self.approaching |= gone
        self.squeezing = np.where(gone, 0.0, self.squeezing)

    def _release(self, angles: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
        """The target without more squeezing; opening is followed immediately."""
        opened = (self.squeezing != 0) & (self.squeezing * (angles - self._bound) < 0)
        self.squeezing = np.where(opened, 0.0, self.squeezing)
        self._loaded_s = np.where(opened, 0.0, self._loaded_s)
        bounded: np.ndarray = np.where(self.squeezing != 0, self._bound, angles)
        return bounded
