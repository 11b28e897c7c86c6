"""Base class of sinks that move a real hand, and the thread that uses the hand's bus."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final, Literal, TypeVar

import numpy as np

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.settings import check_range
from smooth_operator.teleop.runtime.statistics import RecentTimes, percentiles
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import HandState, Mode, Tick
from smooth_operator.types import JointCommand, Side
from smooth_operator_devices.hands.actuator_map import (
    ActuatorMap,
    BoundMap,
    Rest,
    find_table,
    read_table,
)
from smooth_operator_devices.hands.bus_lock import BusLock
from smooth_operator_devices.hands.device import (
    DeviceLostError,
    HandDevice,
    Reading,
    SettingsWatch,
    WrongAnswerError,
    agreed_reading,
    apart,
)
from smooth_operator_devices.hands.guard import CommandGuard, GuardSettings

_T = TypeVar("_T")

_RETRY_S: Final = 1.0
"""Time after a loss until a device is opened again [s]."""

_OPENING_S: Final = 15.0
"""Time that a device may take to open [s]; some boot their motors one by one."""

_MISSED: Final = 3
"""Periods without a valid answer, at least ``_MISSED_S``, after which the hand may have moved: its
position is read again and approached slowly."""

_MISSED_S: Final = 0.05
"""Shortest outage that counts [s]: at high rates a few periods are normal jitter."""

_TRIES: Final = 3
"""Least number of tries to open a device and get its first answer, if answers are invalid."""

_CLOSING_S: Final = 2.0
"""Time that closing waits for a bus that may hang [s]."""

_MANY: Final = 0.05
"""Share of slow cycles above which the note reports their number."""

_HANGS_S: Final = 0.5
"""Length of a call to the bus after which the note reports it [s]."""


class HandWorker:
    """Runs a device on a thread of its own, from ``start`` to ``end``.

    The bus is locked (``BusLock``) only while the device is open: a port that is gone may come back
    as that of another device.

    Args:
        sink: label, bus, limits and times of the worker, and the statistics in which it counts.
        device: the hand; only the thread touches it.
        actuators: map of the hand.
        side: side of the hand.
        hand: name of the robot hand.

    Attributes:
        state: the newest measured state; None before the first one and while the device is lost.
        reading: the newest measurement in the actuators' unit.
        statistics: counts and times of the bus.
    """

    def __init__(
        self, sink: HardwareSink, device: HandDevice, actuators: BoundMap, side: Side, hand: str
    ) -> None:
        self.state: HandState | None = None
        self.reading: Reading | None = None
        self.side = side
        self.statistics = sink._statistics
        self._label, self._bus, self._hand = sink.label, sink.bus, hand
        self._silence_s, self._lost_s = sink.silence_s, sink.lost_s
        self._period = 1.0 / actuators.table.rate
        self._device, self._map = device, actuators
        self._lock: BusLock | None = None
        self._guard = CommandGuard(actuators, sink.guard)
        self._watch = SettingsWatch(device, actuators.table.names)
        self._tick: tuple[Tick, float] | None = None
        self._finite: JointCommand | None = None  # the last finite command
        self._error: Exception | None = None  # reason of the end of the thread
        self._trouble = ""  # reason why the device is being opened again
        self._doing = "opening"
        self._busy_since: float | None = None
        self._commands: np.ndarray | None = None  # the last ones; None without power
        self._place: np.ndarray | None = None  # position at which the hand rests
        self._resting = False
        self._ending = False
        self._opened = threading.Event()
        self._change = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=f"hand {self._label}", daemon=True)

    def start(self) -> None:
        """Open the device, and wait for its first answer.

        Raises:
            SinkError: the device can't be opened, or does not answer in time.
        """
        self._thread.start()
        if not self._opened.wait(_OPENING_S):
            self._ending = True  # as soon as it comes back
            self._release()
            raise SinkError(
                f"{self._label}: no answer for {_OPENING_S:g} s while it was opened; check "
                "its power and cable, then start again"
            )
        if self._error is not None:
            raise self._error

    def post(self, tick: Tick) -> None:
        """Leave a command for the thread; returns immediately, independent of the bus.

        A command that is not finite is counted and replaced by the last finite one; before that
        nothing moves.

        Raises:
            SinkError: the thread gave up, with its reason.
        """
        if self._error is not None:
            raise SinkError(f"{self._label}: {self._error}") from self._error
        if np.isfinite(tick.command.joint_positions).all():
            self._finite = tick.command
        else:
            self.statistics.not_finite += 1
            if self._finite is not None:
                tick = replace(tick, command=self._finite)
            elif tick.mode is not Mode.STOPPED:
                return
        self._tick = (tick, time.perf_counter())
        # If the thread has the lock it is awake. Waiting for it would cost the loop a time slice.
        if self._change.acquire(blocking=False):
            try:
                self._change.notify()
            finally:
                self._change.release()

    def end(self) -> None:
        """Bring the hand to rest as its table says, and close the bus.

        Raises:
            SinkError: the bus hangs; it stays open.
        """
        with self._change:
            self._ending = True
            self._change.notify()
        self._thread.join(_CLOSING_S)
        if self._thread.is_alive():
            self._release()
            raise SinkError(
                f"{self._label}: the bus does not answer; the hand was left in its last state"
            )

    @property
    def note(self) -> str:
        """Note for the user; empty if all is well."""
        facts, since, reading = [], self._busy_since, self.reading
        if since is not None and (waited := time.perf_counter() - since) > _HANGS_S:
            facts.append(f"no answer from the bus for {waited:.1f} s")
        if self._trouble:
            facts.append(f"{self._trouble}; retrying every second")
        elif self._doing != "following":
            facts.append(self._doing)
        if reading is not None and not self._trouble:
            facts += self._warnings(reading)
        count = self.statistics
        slow = count.slow if count.slow > _MANY * count.cycles else 0
        counted = {
            "wrong answers": count.wrong,
            "slow cycles": slow,
            "losses": count.lost,
            "commands not finite": count.not_finite,
        }
        facts += [f"{number} {what}" for what, number in counted.items() if number]
        return "; ".join(facts)

    def _warnings(self, reading: Reading) -> list[str]:
        names = self._map.table.names
        warnings = [*reading.errors, *self._watch.warnings]
        held = [name for name, way in zip(names, self._guard.squeezing, strict=True) if way]
        if held:
            warnings.append(f"contact limit reached: {', '.join(held)}")
        if reading.temperatures is not None:
            pairs = zip(names, reading.temperatures, strict=True)
            hot = [f"{name} {t:.0f} °C" for name, t in pairs if t >= self._map.table.hot]
            warnings += [f"hot: {', '.join(hot)}"] if hot else []
        return warnings

    def _run(self) -> None:
        try:
            while not self._ending:
                try:
                    self._serve()
                except Exception as error:  # of any library
                    if not self._opened.is_set():
                        raise
                    self._lose(error)
        except Exception as error:  # reaches the loop with its next command
            self._error = error if isinstance(error, SinkError) else _described(error)
        finally:
            self.state = self.reading = None
            self._close()  # before `start` returns, so that another try finds the bus free
            self._opened.set()

    def _lose(self, error: Exception) -> None:
        """Report the loss of the device, and wait before the next opening."""
        self.state = self.reading = None  # before the note reports the loss
        reason = error if isinstance(error, SinkError) else _described(error)
        self.statistics.latest = self._trouble = str(reason)
        self.statistics.lost += 1
        self._close()
        with self._change:
            self._change.wait_for(lambda: self._ending, _RETRY_S)

    def _serve(self) -> None:
        """Open the device and run cycles until the end, or until the device is lost."""
        now, period = time.perf_counter, self._period
        self._commands = self._place = None
        self._until_answered(self._open)
        reading = self._until_answered(self._ask)
        moving, cycle = False, now() - period
        self._trouble = ""
        self._opened.set()
        self._doing = "waiting for the first command"
        begun = answered = now()  # begin and end of the last exchange that was answered
        while True:
            self._pace(cycle)
            if self._ending:
                with contextlib.suppress(WrongAnswerError):
                    self._rest(self._map.table.on_end, reading)
                return
            cycle, newest = now(), self._tick
            # After an exchange that took as long as a silence the hand may have moved, too.
            if (
                cycle - answered > max(_MISSED * period, _MISSED_S)
                or cycle - begun > self._silence_s
            ):
                moving, self._place = False, None
            try:
                rest = self._at_rest(newest, cycle)
                if rest is None and newest is not None:
                    if not moving:
                        self._doing = "waiting for two readings that agree"
                        reading = agreed_reading(self._ask, self._map.table)
                        self._guard.start(reading)
                        moving, self._place = True, None
                    seconds = min(cycle - begun, 2 * period)
                    positions = newest[0].command.joint_positions
                    self._commands = self._guard.step(positions, reading, seconds)
                    self._call(self._device.write, self._commands)
                    self._doing = "approaches" if self._guard.approaching.any() else "following"
                elif rest is not None:
                    moving = False
                    self._rest(rest, reading)
                before, reading = reading, self._ask()
                begun, answered = cycle, now()
                if (np.isnan(before.positions) > np.isnan(reading.positions)).any():
                    moving = False  # an actuator is back, and may have moved meanwhile
                self._call(self._watch.look)
                answered = now()
            except WrongAnswerError as error:
                self.statistics.wrong += 1
                self.statistics.latest = str(error)
                if now() - answered > self._lost_s:
                    raise DeviceLostError(f"no valid answer: {error}") from error
            self.statistics.add(now() - cycle, period)

    def _until_answered(self, action: Callable[[], _T]) -> _T:
        """The result of an action on the bus, repeated while the answers are wrong."""
        end, tries = time.perf_counter() + self._lost_s, 0
        while True:
            try:
                return action()
            except WrongAnswerError as error:
                self.statistics.wrong += 1
                tries += 1
                late = tries >= _TRIES and time.perf_counter() > end
                if late or self._ending:
                    raise DeviceLostError(str(error)) from error

    def _open(self) -> None:
        if self._lock is None:
            self._lock = BusLock(self._bus)
        try:
            self._call(self._device.open)
        except WrongAnswerError:
            self._close()
            raise

    def _pace(self, cycle: float) -> None:
        """Wait for the next cycle. A new command ends the wait once the bus is due again."""
        period, before = self._period, self._tick
        with self._change:
            early = cycle + 0.9 * period - time.perf_counter()
            if early > 0:
                self._change.wait_for(lambda: self._ending, early)
            late = cycle + 1.5 * period - time.perf_counter()
            if late > 0:
                self._change.wait_for(lambda: self._ending or self._tick is not before, late)

    def _at_rest(self, newest: tuple[Tick, float] | None, now: float) -> Rest | None:
        """Kind of rest if there is no valid command; None if there is one."""
        if newest is None:
            return None
        if newest[0].mode is Mode.STOPPED:
            self._doing, self._resting = "emergency stop", False
            return self._map.table.on_stop
        if now - newest[1] > self._silence_s:
            self.statistics.silences += not self._resting
            self._doing, self._resting = "no commands arrive: the hand rests", True
            return self._map.table.on_silence
        self._resting = False
        return None

    def _close(self) -> None:
        with contextlib.suppress(Exception):  # closing a lost device must not raise
            self._device.close()
        self._release()

    def _release(self) -> None:
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.release()

    def _rest(self, rest: Rest, reading: Reading) -> None:
        """Hold the position on which two readings agree, or relax. A hand without power stays as it
        is."""
        try:
            if self._commands is None:
                return
            if self._place is None and not apart(reading, latest := self._ask(), self._map.table):
                here = latest.positions
                self._place = np.where(np.isfinite(here), here, self._commands)
            if self._place is not None:
                self._call(self._device.write, self._place)
        finally:
            if rest == "relax":
                self._commands = None
                self._call(self._device.relax)

    def _ask(self) -> Reading:
        reading = self._call(self._device.read)
        if len(reading.positions) != len(self._map.ends):
            raise WrongAnswerError(
                f"{len(reading.positions)} positions received instead of {len(self._map.ends)}"
            )
        stamp, rates = time.perf_counter(), reading.velocities
        self.reading = reading
        self.state = HandState(
            self.side,
            self._hand,
            stamp,
            self._map.names,
            self._map.joints(reading.positions),
            None if rates is None else self._map.joint_velocities(reading.positions, rates),
            self._map.table.names,
            None if reading.currents is None else np.asarray(reading.currents, float),
            None if reading.temperatures is None else np.asarray(reading.temperatures, float),
            None if reading.touch is None else np.asarray(reading.touch, float),
            self._map.contact(reading.currents, reading.touch, reading.pads),
        )
        return reading

    def _call(self, action: Callable[..., _T], *arguments: object) -> _T:
        """Call an action on the bus, and remember when it started."""
        self._busy_since = time.perf_counter()
        try:
            return action(*arguments)
        finally:
            self._busy_since = None


def _described(error: Exception) -> SinkError:
    return SinkError(f"{type(error).__name__}: {error}")


class BusStatistics:
    """Counts and times of a bus. Its worker writes them, and any thread may read them.

    Attributes:
        cycles: number of cycles.
        wrong: number of failed exchanges: no answer in time, a wrong checksum, an invalid answer.
        slow: number of cycles that took longer than their period.
        lost: number of times that the device was lost.
        silences: number of times that no commands arrived.
        not_finite: number of commands with a NaN or an infinity, each of which was replaced by the
            last finite command.
        latest: the last failure, in one sentence; empty if there was none.
    """

    def __init__(self) -> None:
        self.cycles = self.wrong = self.slow = self.lost = self.silences = 0
        self.not_finite = 0
        self.latest = ""
        self._times = RecentTimes()

    def add(self, seconds: float, period: float) -> None:
        """Add a cycle, with its length and its period [s]."""
        self._times.append(seconds * 1e3)
        self.cycles += 1
        self.slow += seconds > period

    def summary(self) -> dict[str, Any]:
        """Counts, and percentiles of the lengths of the last cycles [ms], as plain values."""
        figures: dict[str, Any] = {
            "cycles": self.cycles,
            "wrong_answers": self.wrong,
            "slow_cycles": self.slow,
            "device_lost": self.lost,
            "silences": self.silences,
            "commands_not_finite": self.not_finite,
        }
        if times := percentiles(self._times.newest()):
            figures["cycle_ms"] = times
        return figures


@dataclass(frozen=True)
class HardwareSink(Sink):
    """Base class of the sinks that move a real hand.

    A separate thread uses the bus, and sends the newest command. At the start, and after silence,
    an emergency stop, missing answers or a lost device, the thread reads the position of the hand
    twice and approaches the target slowly. Without commands the hand rests as its table says.

    A driver is a frozen dataclass that derives from this class, sets ``driver`` and implements
    ``device``. It may add settings, such as a baud rate.

    Attributes:
        port: port of the hand: a serial port, a network address or a CAN channel.
        table: file or name of the table of its actuators; empty for the driver's own table.
        side: side of the hand in the run; None if the run has only one hand.
        rate: cycles per second on the bus [Hz]; None for the rate of the table.
        limit: limit of current [mA], or of force in the driver's unit; None for the limit of the
            table.
        approach: speed of a slow approach [rad/s].
        speed: speed limit of every actuator [rad/s].
        contact: share of ``limit`` at which an actuator counts as in contact and stops; 0 switches
            the contact guard off.
        silence_s: time without a command after which the hand rests [s].
        lost_s: time without a valid answer after which the device is opened again [s].

    Raises:
        ConfigError: a setting is outside its range.
    """

    moves_real_hand: ClassVar[bool] = True

    driver: ClassVar[str] = ""

    port: str = ""
    table: str = ""
    side: Literal["right", "left"] | None = None
    rate: float | None = None
    limit: float | None = None
    approach: float = 0.5
    speed: float = 15.0
    contact: float = 0.8
    silence_s: float = 0.2
    lost_s: float = 0.5
    _worker: HandWorker | None = field(default=None, init=False, repr=False, compare=False)
    _statistics: BusStatistics = field(
        default_factory=BusStatistics, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        try:
            _ = self.guard
        except ConfigError as error:
            raise ConfigError(f"{self.driver}: {error}") from None
        check_range(f"{self.driver}: rate", self.rate, 1.0, 1000.0, "Hz")
        check_range(f"{self.driver}: silence_s", self.silence_s, 0.02, 5.0, "s")
        check_range(f"{self.driver}: lost_s", self.lost_s, 0.05, 60.0, "s")
        if self.limit is not None and not 0.0 < self.limit < math.inf:
            raise ConfigError(
                f"{self.driver}: limit must be positive and finite, not {self.limit:g}; leave it "
                "out to use the limit of the table"
            )

    @abstractmethod
    def device(self, actuators: ActuatorMap) -> HandDevice:
        """Create the device, which is not open yet.

        Args:
            actuators: table of the hand, with the limits of this sink.

        Raises:
            MissingExtraError: its library is not installed.
            ConfigError: a setting or an entry of the table does not fit the driver.
        """

    @property
    def bus(self) -> str:
        """Bus that this program locks, in a form of ``bus_name``. Default: the port."""
        return self.port or self.driver

    @property
    def guard(self) -> GuardSettings:
        """Limits of the commands."""
        return GuardSettings(self.approach, self.speed, self.contact)

    @property
    def label(self) -> str:
        """The driver and the port."""
        return f"{self.driver} {self.port}".strip()

    @property
    def note(self) -> str:
        """Note for the user: the hand does not follow, errors, temperatures and counts."""
        return "" if self._worker is None else self._worker.note

    @property
    def measures(self) -> bool:
        """True, because the hand is read in every cycle."""
        return True

    @property
    def figures(self) -> dict[str, Any]:
        """Counts and times of the bus, for the summary of a run."""
        return self._statistics.summary()

    def table_of(self, hand: str) -> str:
        """Name or path of the table for a robot hand; empty for the driver's own table."""
        del hand
        return self.table

    def actuators(self, side: Side, hand: str = "") -> ActuatorMap:
        """Table of the hand, with the rate and the limits of this sink.

        Args:
            hand: name of the robot hand, for a driver that has tables for several hands.

        Raises:
            ConfigError: there is no such table, or it can't be used.
        """
        table = read_table(find_table(self.table_of(hand), self.driver, side))
        if table.driver != self.driver:
            raise ConfigError(
                f"{table.file} is a table for the driver {table.driver!r}, not {self.driver!r}"
            )
        if table.side != side:
            raise ConfigError(f"{table.file} is for a {table.side} hand, not for a {side} one")
        if self.limit is not None:
            weaker = tuple(
                replace(a, limit=None if a.limit is None else min(a.limit, self.limit))
                for a in table.actuators
            )
            table = replace(table, limit=self.limit, actuators=weaker)
        return table if self.rate is None else replace(table, rate=self.rate)

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Check the table and the settings, and open, read and close the hand. Nothing moves."""
        self.open(hands, {})
        self.close()

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Lock the bus, open the hand and read it; see ``Sink``."""
        if self._worker is not None:
            raise SinkError(f"{self.label} is already open")
        side = self._side(hands)
        hand = hands[side]
        table = self.actuators(side, hand.name)
        worker = HandWorker(self, self.device(table), BoundMap(table, hand), side, hand.name)
        worker.start()
        self._set(_worker=worker)

    def send(self, tick: Tick) -> None:
        """Hand the command to the thread. This takes microseconds, whatever the bus does.

        Raises:
            SinkError: the thread has ended with an error.
        """
        worker = self._worker
        if worker is None:
            raise SinkError(f"{self.label} is not open")
        if tick.side == worker.side:
            worker.post(tick)

    def state(self, side: Side) -> HandState | None:
        """Last measured state of the hand. Any thread may ask for it."""
        worker = self._worker
        return worker.state if worker is not None and worker.side == side else None

    @property
    def reading(self) -> Reading | None:
        """Newest measurement in the unit of the actuators, with touch pads; None while the hand is
        lost. Any thread may ask for it."""
        worker = self._worker
        return None if worker is None else worker.reading

    def close(self) -> None:
        """Bring the hand to rest as its table says, and close the bus."""
        worker = self._worker
        self._set(_worker=None)
        if worker is not None:
            worker.end()

    def _side(self, hands: Mapping[Side, Hand]) -> Side:
        if self.side is not None:
            if self.side not in hands:
                raise ConfigError(
                    f"{self.label}: the run has no {self.side} hand; choose it with --side"
                )
            return self.side
        if len(hands) != 1:
            raise ConfigError(
                f"{self.label}: the run has two hands, and this sink moves one of them; add "
                "side=right or side=left, and a second sink for the other hand"
            )
        return next(iter(hands))
