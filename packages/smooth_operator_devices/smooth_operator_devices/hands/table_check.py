"""Dialogue that measures how the actuators of a real hand move, and makes its table."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator_devices.hands.actuator_map import Actuator, ActuatorMap
from smooth_operator_devices.hands.device import (
    HandDevice,
    Reading,
    SettingsWatch,
    WrongAnswerError,
    agreed_reading,
)

_STEPS: Final = 20
"""Number of steps over the range of an actuator."""

HELP: Final = """The actuators move a little and back, one after the other. Enter what you see. In a
second terminal, `smooth-operator hands show NAME` shows each joint and the direction in which its
slider moves it. Keep the space around the robot hand free, and keep your own hand on its power
switch. Ctrl-C relaxes the robot hand."""


class TableCheck:
    """Asks the user about each actuator, and collects the answers in a table.

    Args:
        mover: the hand.
        hand: model of the hand, with the joints that the actuators move.
        ask: function that shows a question and returns the answer, like ``input``.
        say: function that shows a line.
    """

    def __init__(
        self,
        mover: ActuatorMover,
        hand: Hand,
        ask: Callable[[str], str],
        say: Callable[[str], None],
    ) -> None:
        self._mover, self._hand, self._ask, self._say = mover, hand, ask, say

    def run(self, table: ActuatorMap) -> ActuatorMap | None:
        """Go through the actuators of a table.

        Returns:
            the table with the measurements, in which skipped actuators are unchanged; None if no
            actuator was measured or confirmed.

        Raises:
            SinkError: the device was lost.
        """
        actuators, confirmed = list(table.actuators), 0
        for index, actuator in enumerate(table.actuators):
            number = "" if actuator.id is None else f" (id {actuator.id})"
            self._say(f"\n{index + 1} of {len(actuators)}: {actuator.name}{number}")
            answer = self._one(index, actuator, table.unit)
            if answer == "quit":
                break
            if isinstance(answer, Actuator):
                actuators[index] = answer
                confirmed += 1
        if not confirmed:
            return None
        source = f"smooth-operator hardware check: {confirmed} of {len(actuators)} actuators"
        return replace(table, actuators=tuple(actuators), source=source)

    def _one(self, index: int, actuator: Actuator, unit: str) -> Actuator | str:
        start = self._mover.position(index)
        joints = self._joints(index, actuator, start)
        if isinstance(joints, str):
            return joints
        low = self._end(index, actuator, start, -1, unit)
        high = None if low is None else self._end(index, actuator, start, +1, unit)
        self._mover.move(index, start)
        if low is None or high is None:
            return "quit"
        if not low < high:
            self._say(f"the ends {low:g} and {high:g} are not a range, so nothing was changed")
            return "skip"
        points = actuator.points if actuator.crank else self._angles(actuator, low, high, unit)
        return replace(actuator, joints=joints, points=points, ends=(low, high))

    def _joints(self, index: int, actuator: Actuator, start: float) -> dict[str, float] | str:
        """Ask for the joint that an actuator moves."""
        low, high = actuator.ends
        step = 0.12 * (high - low) * (1 if start < (low + high) / 2 else -1)
        now = " + ".join(f"{w:g} {j}" if w != 1 else j for j, w in actuator.joints.items())
        while True:
            self._mover.move(index, start + step)
            self._mover.move(index, start)
            answer = self._ask(
                f"Which joint moved? Press Enter for {now}, or type the name of a joint, a to see "
                "the motion again, s to skip, q to quit: "
            ).strip()
            if answer == "":
                return dict(actuator.joints)
            if answer in ("s", "q"):
                return "skip" if answer == "s" else "quit"
            if answer in self._hand.joint_names and not actuator.crank:
                return {answer: 1.0}
            if answer != "a":
                self._say(
                    f"the joints of {self._hand.name} are {', '.join(self._hand.joint_names)}"
                )

    def _end(
        self, index: int, actuator: Actuator, start: float, way: int, unit: str
    ) -> float | None:
        """Find the end of the range of an actuator in one direction; None to quit."""
        low, high = actuator.ends
        step, stated = way * (high - low) / _STEPS, high if way > 0 else low
        side = "maximum" if way > 0 else "minimum"
        self._mover.move(index, start)
        while True:
            at = self._mover.position(index)
            if way * (stated - at) < 0.25 * abs(step):
                self._say(
                    f"the {side} command, {stated:g} {unit}, is reached and is used as the end"
                )
                return float(stated)
            answer = self._ask(
                f"It moves towards its {side} command and is at {at:.6g} {unit}. Press Enter for a "
                "step, or type a number of steps, e if this is the end of its range, k to keep "
                f"{stated:g} as the end, q to quit: "
            ).strip()
            if answer == "q":
                return None
            if answer == "k":
                return float(stated)
            if answer == "e":
                return float(at)
            count = int(answer) if answer.isdigit() else 1
            if not self._mover.move(index, at + count * step):
                at = self._mover.position(index)
                self._say(f"it is blocked at {at:.6g}, which is used as the end")
                return float(at - 0.5 * step)

    def _angles(
        self, actuator: Actuator, low: float, high: float, unit: str
    ) -> tuple[tuple[float, float], ...]:
        """Ask for the angle of the joint at both ends."""
        while True:
            pairs = []
            for command in (low, high):
                stated = np.rad2deg(actuator.angle(command))
                answer = self._ask(
                    f"Type the angle of the joint in the model at {command:.6g} {unit}, in "
                    f"degrees, or press Enter for {stated:.1f}: "
                ).strip()
                try:
                    degrees = float(answer) if answer else stated
                except ValueError:
                    self._say(f"{answer!r} is not a number")
                    break
                pairs.append((float(np.deg2rad(degrees)), command))
            if len(pairs) < 2:
                continue
            points = tuple(sorted(pairs))
            try:
                replace(actuator, points=points, ends=(low, high))
            except ConfigError as error:
                self._say(str(error))
                continue
            return points


def blank_table(
    driver: str,
    hand: Hand,
    ids: list[int],
    unit: str,
    ends: tuple[float, float],
    limit: float | None = None,
) -> ActuatorMap:
    """New table for a hand. Every id moves the first joint until a check corrects it.

    Args:
        ends: range in which an actuator may be moved.
        limit: limit of current or force, in the driver's unit; None for the limit of the device.
    """
    joint = hand.actuated_names[0]
    return ActuatorMap(
        driver=driver,
        hand=hand.name,
        side=hand.spec.side,
        unit=unit,
        limit=limit,
        actuators=tuple(
            Actuator(
                f"actuator {number}", {joint: 1.0}, ((-1.0, ends[0]), (1.0, ends[1])), ends, number
            )
            for number in ids
        ),
    )


_CONTACT: Final = 0.8
"""Share of the limit of current at which an actuator counts as blocked."""

_BLOCKED_S: Final = 0.15
_PATIENCE_S: Final = 0.5
"""Time without a valid answer after which the device counts as lost [s]."""

_WAIT_S: Final = 60.0
"""Longest time of one motion [s]."""


class ActuatorMover:
    """Moves single actuators of a hand, while the others hold.

    A thread exchanges messages with the device all the time, because a device may have a watchdog.
    An actuator whose current stays high stops. It is a context manager, which relaxes the hand at
    the end, after an error and after a signal.

    Args:
        device: the hand.
        actuators: table of the hand. Commands may be outside its ends, because the check measures
            the ends.
        seconds: time of a motion over the whole range of an actuator [s].

    Attributes:
        names: names of the actuators.

    Raises:
        SinkError: the hand can't be opened, or an actuator gives no position.
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
        """Newest answer of the hand.

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
        """Move one actuator slowly to a command, and wait for it.

        Returns:
            False if the actuator was blocked; it then holds the position where it stopped.

        Raises:
            SinkError: the device was lost.
        """
        self._blocked[index] = False
        self._loaded_s[index] = 0.0
        self._goal[index] = command
        end = time.monotonic() + _WAIT_S
        while self._at[index] != self._goal[index] and time.monotonic() < end:
            _ = self.reading  # raises if the device is lost
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
        except KeyboardInterrupt:  # a second one, after which the hand is relaxed, too
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
            raise SinkError(f"no position from {', '.join(lost)}; check the cables")
        return reading

    def _run(self) -> None:
        answered, missed = time.monotonic(), False
        try:
            while not self._ending.wait(self._period):
                step = self._speeds * self._period
                try:
                    if missed:  # the hand may have moved in the meantime
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
        except Exception as error:  # raised by the next question to the user
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
        high = np.abs(reading.currents) >= self._levels  # False for an actuator without a limit
        high &= np.abs(reading.positions - before.positions) < 0.3 * self._speeds * self._period
        self._loaded_s = np.where(high, self._loaded_s + self._period, 0.0)
        stop = (self._loaded_s >= _BLOCKED_S) & ~self._blocked
        self._blocked |= stop
        self._goal[stop] = self._at[stop] = reading.positions[stop]
