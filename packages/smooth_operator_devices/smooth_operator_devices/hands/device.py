"""Base class of the drivers of real robot hands, and their readings.

A driver implements only the hand's protocol, in the hand's unit. ``HardwareSink`` adds limits, slow
approach, watchdog and retries, the same for every hand.
"""

from __future__ import annotations

import contextlib
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator_devices.hands.actuator_map import ActuatorMap

_T = TypeVar("_T")


class DeviceLostError(SinkError):
    """Raised if the device was unplugged or switched off; it must be opened again."""


class WrongAnswerError(SinkError):
    """Raised if one exchange failed: no answer in time, a wrong checksum or an invalid answer.

    The next exchange may succeed. Many failures in a row count as a lost device.
    """


@dataclass(frozen=True, eq=False)
class Reading:
    """Measurements of a hand, in the order of its table.

    Attributes:
        positions: (a,) measured positions in the actuators' unit, that of ``HandDevice.write``;
            NaN where one could not be read.
        velocities: (a,) measured velocities in that unit per second, or None.
        currents: (a,) current of the motors [mA], or force or effort in the driver's unit, the same
            as that of the table's ``limit``; the sign does not matter. None if there is none.
        temperatures: (a,) temperatures [degrees Celsius], or None.
        errors: reports of the actuators, a few words each: ``thumb_cmc: overload``.
        touch: (k,) touch or force sensors, in the driver's unit, or None. A hand with touch pads
            also has one value for each pad: the sum of its cells.
        pads: touch pad -> (rows, columns) its cells, in the driver's unit. Names begin with the
            finger: ``index_tip``, ``palm``. Empty if there are none, or not all were read yet.
    """

    positions: Float[np.ndarray, " a"]
    velocities: Float[np.ndarray, " a"] | None = None
    currents: Float[np.ndarray, " a"] | None = None
    temperatures: Float[np.ndarray, " a"] | None = None
    errors: tuple[str, ...] = ()
    touch: Float[np.ndarray, " k"] | None = None
    pads: Mapping[str, Float[np.ndarray, "rows columns"]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Setting:
    """A volatile setting of a hand, read back from the hand.

    Attributes:
        name: name of the setting, for messages: ``goal current``.
        expected: (k,) last written values, in the unit of the protocol.
        measured: (k,) values from the hand.
    """

    name: str
    expected: Float[np.ndarray, " k"]
    measured: Float[np.ndarray, " k"]


class HandDevice(ABC):
    """A real hand on its bus. All methods are called from one thread and may wait for the bus.

    Each may raise ``DeviceLostError`` (it has to be opened again) or ``WrongAnswerError`` (this
    exchange failed). An ``OSError`` counts as a lost device.

    A subclass sets ``driver``, ``name`` and ``motors``.

    Args:
        table: table of the hand's actuators.

    Raises:
        ConfigError: the table has another number of actuators.
    """

    driver: ClassVar[str]
    """Name of the driver, for messages."""
    name: ClassVar[str]
    """Name of the hand with its article, for messages."""
    motors: ClassVar[int]
    """Number of motors; 0 if the table determines it."""

    _limited = False
    """True if the limits were written to the hand since it was opened or relaxed."""

    def __init__(self, table: ActuatorMap) -> None:
        if self.motors:
            table.check_count(self.motors, self.name)
        self._table = table

    def _setting(self, name: str, default: float, low: float, high: float) -> Any:
        """A number from the table's settings; a whole one if the default is whole."""
        value = self._table.settings.get(name, default)
        kinds = int if isinstance(default, int) else int | float
        if not isinstance(value, kinds) or isinstance(value, bool) or not low <= value <= high:
            number = "a whole number from " if isinstance(default, int) else ""
            raise ConfigError(
                f"{self._table.file}: {name} must be {number}{low:g} to {high:g}, not {value!r}"
            )
        return value

    def _check_settings(self, names: Sequence[str]) -> None:
        """Raise ConfigError if the table or one of its actuators has a setting with another
        name."""
        for settings in (self._table.settings, *(a.settings for a in self._table.actuators)):
            for name in settings:
                if name not in names:
                    raise ConfigError(
                        f"{self._table.file}: {self.driver} has no setting {name!r}; expected one "
                        f"of {', '.join(names)}"
                    )

    @contextlib.contextmanager
    def _opening(self, advice: str) -> Iterator[None]:
        """Closes the hand if the block fails, and adds advice to the error."""
        try:
            yield
        except SinkError as error:
            self.close()
            raise type(error)(f"{error}; {advice}") from error

    def _check_side(self, side: str | None, hand: str = "the hand") -> None:
        """Raise an error if the hand is of the other side than its table."""
        if side is not None and side != self._table.side:
            raise SinkError(
                f"{self.driver}: {hand} is a {side} hand, but {self._table.file} is for a "
                f"{self._table.side} hand"
            )

    def _opened(self, part: _T | None) -> _T:
        """A part that exists while the hand is open; DeviceLostError if it is closed."""
        if part is None:
            raise DeviceLostError(f"{self.driver}: the hand is not open")
        return part

    def _reports(self, values: Iterable[_T], words: Callable[[_T], str]) -> tuple[str, ...]:
        """``Reading.errors`` by a value of each actuator; no report where there are no words."""
        pairs = zip(self._table.names, map(words, values), strict=False)
        return tuple(f"{name}: {text}" for name, text in pairs if text)

    @abstractmethod
    def open(self) -> None:
        """Connect, check that every actuator answers, set current limits. Nothing moves.

        Called again after ``close`` when the device was lost.

        Raises:
            SinkError: the hand can't be opened; the message has advice.
        """

    @abstractmethod
    def read(self) -> Reading:
        """Read the state of the hand; once in every cycle, after ``write``.

        Values that are slow to read (temperatures, error flags) may be read in turns and repeated.
        Positions must not be repeated, since the next command relies on them. If a hand reports
        them by itself, a report that is older than a few periods is a ``WrongAnswerError``, and so
        is the maker's mark of a missing value; a single actuator without a value is NaN.
        """

    @abstractmethod
    def write(self, commands: Float[np.ndarray, " a"]) -> None:
        """Send position commands, in the actuators' unit and the order of the table.

        They are finite and within the table's ends, or, during a slow approach, between the ends
        and the hand's position. The first call after ``open`` or ``relax`` switches the motors on;
        its commands are the hand's position. A driver must write the hand's limits before it
        switches motors on, since a restart deletes them. To hold, the same commands come in every
        cycle, so that a device with a watchdog of its own stays active.
        """

    def settings(self) -> Sequence[Setting]:
        """Read back settings that a restart of the hand deletes, or enough of them to detect one.

        Called about once a second (``SettingsWatch``). Empty if the protocol can't read them.
        """
        return ()

    def relax(self) -> None:
        """Switch the motors' torque off. Called in every cycle of a rest without torque.

        A hand that has no such command does nothing; its last command is its own position. Before
        the next command, it gets its limits again.
        """
        self._limited = False

    @abstractmethod
    def close(self) -> None:
        """Give the bus back. Must not raise, nor move anything, also when the device is gone; a
        second call does nothing."""


_AGREE: Final = 0.15
"""Largest difference of two readings that agree [rad]; a finger at 10 rad/s moves this far in
15 ms."""

_APART_S: Final = 0.01
"""Time between two readings [s], so that a damaged report is not read twice."""

_READINGS: Final = 3


def apart(first: Reading, second: Reading, table: ActuatorMap) -> list[int]:
    """Indices of the actuators whose positions differ by more than ``_AGREE``."""
    one, other = (
        np.array([a.angle(v) for a, v in zip(table.actuators, reading.positions, strict=True)])
        for reading in (first, second)
    )
    same = np.isclose(one, other, rtol=0.0, atol=_AGREE, equal_nan=True)
    return [int(index) for index in np.flatnonzero(~same)]


def agreed_reading(read: Callable[[], Reading], table: ActuatorMap) -> Reading:
    """Reads the hand up to three times until a reading agrees with an earlier one within 0.15 rad.

    Args:
        read: exchanges one question and answer with the hand.
        table: table of the hand, for the angles and names of its actuators.

    Returns:
        the later of the two.

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
        f"{table.names[index]}: {_READINGS} consecutive readings of its position differ, "
        f"{values} {table.unit}; check its cable and power, and that nothing moves the hand"
    )


_EVERY_S: Final = 1.0
"""Time between two readings of a hand's settings [s]."""

_TRIES: Final = 3
"""Number of readings after which the watch gives up if none confirmed a setting: the hand can't
read them back, and waiting for its answer costs time on the bus."""

_TOLERANCE: Final = 0.01
"""Relative difference of two values that counts as rounding."""


class SettingsWatch:
    """Reads a hand's volatile settings periodically, and compares them with the written values.

    No driver has been tried on a physical hand. Therefore a difference counts as a loss only for a
    setting that the hand has once returned as written; otherwise it is a warning.

    Args:
        device: the hand.
        names: the actuators' names, for messages.

    Attributes:
        warnings: settings that the hand did not accept as written, a few words each.
    """

    def __init__(self, device: HandDevice, names: Sequence[str]) -> None:
        self.warnings: tuple[str, ...] = ()
        self._device, self._names = device, names
        self._confirmed: set[str] = set()
        self._readings = 0
        self._last = -np.inf

    def look(self) -> None:
        """Read the settings, if they are due.

        Raises:
            DeviceLostError: the hand has lost a confirmed setting, by two readings.
            WrongAnswerError: the hand does not answer.
        """
        now = time.perf_counter()
        useful = self._confirmed or self._readings < _TRIES
        if now - self._last < _EVERY_S or not useful:
            return
        self._last = now
        self._readings += 1
        try:
            different = self._different(self._device.settings())
            if not self._confirmed.isdisjoint(different):  # one wrong reading restarts no hand
                different = self._different(self._device.settings())
        except SinkError as error:
            if self._confirmed:
                raise
            self.warnings = ("its limits can't be read back",)
            raise WrongAnswerError(str(error)) from error  # a hand that is gone fails again
        if lost := [text for name, text in different.items() if name in self._confirmed]:
            raise DeviceLostError(f"the hand restarted: {', '.join(lost)}")
        self.warnings = tuple(different.values())

    def _different(self, settings: Sequence[Setting]) -> dict[str, str]:
        """Setting that differs -> description of the difference; confirms the others."""
        different: dict[str, str] = {}
        for setting in settings:
            pairs = zip(setting.measured, setting.expected, strict=True)
            wrong = [k for k, (a, b) in enumerate(pairs) if abs(a - b) > _TOLERANCE * abs(b)]
            if not wrong:
                self._confirmed.add(setting.name)
                continue
            first, every = wrong[0], len(setting.measured) == len(self._names)
            where = self._names[first] if every else f"no. {first + 1}"
            different[setting.name] = (
                f"{setting.name} of {where} is {setting.measured[first]:g}, not "
                f"{setting.expected[first]:g}"
            )
        return different
