"""Moves single actuators of a real hand slowly, for a person who looks on."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import SinkError
from smooth_operator.teleop.hardware.actuator_map import ActuatorMap
from smooth_operator.teleop.hardware.device import (
    HandDevice,
    Reading,
    WrongAnswerError,
    agreed_reading,
)
from smooth_operator.teleop.hardware.table_file import SettingsWatch

_CONTACT: Final = 0.8
"""Share of the limit of current from which an actuator counts as blocked."""

_BLOCKED_S: Final = 0.15
_PATIENCE_S: Final = 0.5
"""Time without a right answer after which the device counts as lost [s]."""

_WAIT_S: Final = 60.0
"""Longest that one motion may take [s]."""


class ActuatorMover:
    """A hand whose actuators stand where they are until one is asked to move.

    A thread keeps talking to the device, whatever the person does meanwhile, since devices have
    watchdogs of their own. An actuator whose current stays high stops where it is. Use as a context
    manager: at the end, after an error and after a signal the hand is relaxed.

    Args:
        device: the hand.
        actuators: its table; the commands are not limited to its ends, which are to be found.
        seconds: how long a motion over the table's whole range of an actuator takes [s].

    Attributes:
        names: names of the actuators.

    Raises:
        SinkError: it can't be opened, or a position is not known.
    """

    def __init__(self, device: HandDevice, actuators: ActuatorMap, seconds: float = 6.0) -> None:
        self.names = actuators.names
        self._device, self._period, self._table = device, 1.0 / actuators.rate, actuators
        self._watch = SettingsWatch(device, actuators.names)
        ranges = np.array([high - low for low, high in (a.ends for a in actuators.actuators)])
        self._speeds = ranges / seconds
        self._levels = _CONTACT * actuators.limits
        try:
            device.open()
            self._reading = self._first()
        except BaseException:
            device.close()
            raise
        self._goal: Float[np.ndarray, " a"] = self._reading.positions.copy()
        self._at = self._goal.copy()
        self._loaded_s = np.zeros(len(self._goal))
        self._blocked = np.zeros(len(self._goal), bool)
        self._cycles = 0
        self._error: Exception | None = None
        self._ending, self._relaxed = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="actuators", daemon=True)

    @property
    def reading(self) -> Reading:
        """The newest answer of the hand.

        Raises:
            SinkError: the device was lost.
        """
        if self._error is not None:
            raise SinkError(f"the hand was lost: {self._error}") from self._error
        return self._reading

    def position(self, index: int) -> float:
        """Measured position of an actuator, in its unit."""
        return float(self.reading.positions[index])

    def move(self, index: int, command: float) -> bool:
        """Bring one actuator to a command, slowly, and wait until it is there.

        Returns:
            False if something blocks it: it then stands where it was stopped.

        Raises:
            SinkError: the device was lost.
        """
        self._blocked[index] = False
        self._loaded_s[index] = 0.0
        self._goal[index] = command
        end = time.monotonic() + _WAIT_S
        while self._at[index] != self._goal[index] and time.monotonic() < end:
            _ = self.reading  # raises where the device is gone
            time.sleep(self._period)
        settled = self._cycles + round(_BLOCKED_S / self._period) + 3
        while self._cycles < settled and time.monotonic() < end:
            _ = self.reading
            time.sleep(self._period)
        return not self._blocked[index]

    def __enter__(self) -> ActuatorMover:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._ending.set()
        try:
            self._relaxed.wait(2.0)
        except KeyboardInterrupt:  # a second one: the hand is relaxed first
            self._relaxed.wait(2.0)
        self._device.close()

    def _first(self) -> Reading:
        end = time.monotonic() + _PATIENCE_S
        while True:
            try:
                reading = agreed_reading(self._device.read, self._table)
                break
            except WrongAnswerError:
                if time.monotonic() > end:
                    raise
        lost = [n for n, v in zip(self.names, reading.positions, strict=True) if v != v]
        if lost:
            raise SinkError(f"{', '.join(lost)} gave no position; check their cables")
        return reading

    def _run(self) -> None:
        answered, missed = time.monotonic(), False
        try:
            while not self._ending.wait(self._period):
                step = self._speeds * self._period
                try:
                    if missed:  # it may have moved on, or fallen: it goes on from there
                        here = agreed_reading(self._device.read, self._table).positions
                        self._at = np.where(np.isfinite(here), here, self._at)
                    self._at += np.clip(self._goal - self._at, -step, step)
                    self._device.write(self._at)
                    self._feel(self._device.read())
                    self._watch.look()
                    answered, missed = time.monotonic(), False
                    self._cycles += 1
                except WrongAnswerError:
                    missed = True
                    if time.monotonic() - answered > _PATIENCE_S:
                        raise
        except Exception as error:  # reaches the person with the next question
            self._error = error
        finally:
            try:
                self._device.relax()
            except Exception as error:
                self._error = self._error or error
            self._relaxed.set()

    def _feel(self, reading: Reading) -> None:
        """Stop an actuator whose current stays high."""
        before, self._reading = self._reading, reading
        if reading.currents is None:
            return
        high = np.abs(reading.currents) >= self._levels  # False where there is no limit
        high &= np.abs(reading.positions - before.positions) < 0.3 * self._speeds * self._period
        self._loaded_s = np.where(high, self._loaded_s + self._period, 0.0)
        stop = (self._loaded_s >= _BLOCKED_S) & ~self._blocked
        self._blocked |= stop
        self._goal[stop] = self._at[stop] = reading.positions[stop]
