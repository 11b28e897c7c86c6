"""Base class of sinks that move a real hand."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.hardware.actuator_map import ActuatorMap
from smooth_operator.teleop.hardware.device import HandDevice
from smooth_operator.teleop.hardware.guard import GuardSettings
from smooth_operator.teleop.hardware.table_file import find_table, read_table
from smooth_operator.teleop.hardware.worker import BusStatistics, HandWorker, WorkerSettings
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import HandState, Tick
from smooth_operator.types import Side


@dataclass(frozen=True)
class HardwareSink(Sink):
    """Moves one real hand safely, through a driver of its protocol.

    A thread of its own uses the bus and takes the newest command. At the start, and after silence,
    an emergency stop, missing answers or a lost device, it reads the position of the hand twice and
    approaches the target slowly. Without commands the hand rests as its table says.

    A driver is a frozen dataclass that derives from this one, sets ``driver`` and implements
    ``device``; it may add settings, such as a baud rate.

    Attributes:
        port: port of the hand: a serial port, a network address, a CAN channel.
        table: table of its actuators: a file, or the name of one; empty for the driver's own.
        side: side of the hand in the run; None for the only one.
        rate: cycles per second on the bus [Hz]; None for that of the table.
        limit: limit of current [mA], or of force, in the driver's unit; None for that of the table.
        approach: speed of a slow approach [rad/s].
        speed: speed limit of every actuator [rad/s].
        contact: share of ``limit`` from which on an actuator counts as squeezing and stops; 0 for
            no contact guard.
        silence_s: time without a command after which the hand rests [s].
        lost_s: time without a right answer after which the device is opened again [s].

    Raises:
        ConfigError: a setting is out of its range.
    """

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
            GuardSettings(self.approach, self.speed, self.contact)
        except ConfigError as error:
            raise ConfigError(f"{self.driver}: {error}") from None
        if self.rate is not None and not 1.0 <= self.rate <= 1000.0:
            raise ConfigError(f"{self.driver}: rate must be 1 to 1000 Hz, not {self.rate}")
        if self.limit is not None and not 0.0 < self.limit < math.inf:
            raise ConfigError(
                f"{self.driver}: limit must be over 0 and finite, not {self.limit:g}; leave it out "
                "to have the table's"
            )
        if not (0.02 <= self.silence_s <= 5.0 and 0.05 <= self.lost_s <= 60.0):
            raise ConfigError(
                f"{self.driver}: silence_s must be 0.02 to 5 s and lost_s 0.05 to 60 s, not "
                f"{self.silence_s} and {self.lost_s}"
            )

    @abstractmethod
    def device(self, actuators: ActuatorMap) -> HandDevice:
        """Create the device, not yet open; ``actuators`` has the run's limit of current.

        Raises:
            MissingExtraError: its library is not installed.
            ConfigError: a setting or an entry of the table does not fit the driver.
        """

    @property
    def bus(self) -> str:
        """Bus that is locked for this program, in a form of ``bus_name``; by default the port."""
        return self.port or self.driver

    @property
    def label(self) -> str:
        """The driver and the port."""
        return f"{self.driver} {self.port}".strip()

    @property
    def note(self) -> str:
        """Note on a hand that does not follow, on errors, temperatures and counts."""
        worker = self._worker
        return "" if worker is None else worker.note

    @property
    def measures(self) -> bool:
        """True: the hand is read in every cycle."""
        return True

    @property
    def figures(self) -> dict[str, Any]:
        """Counts and times of the bus, for the summary of a run."""
        return self._statistics.summary()

    def table_of(self, hand: str) -> str:
        """Name or path of the table for a robot hand; empty for the one that the driver names."""
        del hand
        return self.table

    def actuators(self, side: Side, hand: str = "") -> ActuatorMap:
        """The table of its hand, with this sink's settings.

        Args:
            hand: name of the run's hand, of a driver that has a table for each of several.

        Raises:
            ConfigError: there is none, or it can't be used.
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
        """Check table and settings, open and read the hand, and close it; nothing moves."""
        self.open(hands, {})
        self.close()

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Lock the bus, and open and read the hand; see ``Sink``."""
        if self._worker is not None:
            raise SinkError(f"{self.label}: it is open already")
        side = self._side(hands)
        table = self.actuators(side, hands[side].name)
        bound = table.bind(hands[side])
        device = self.device(table)
        guard = GuardSettings(self.approach, self.speed, self.contact)
        settings = WorkerSettings(1.0 / table.rate, self.silence_s, self.lost_s, guard)
        worker = HandWorker(
            self.label, device, self.bus, bound, side, hands[side].name, settings, self._statistics
        )
        worker.start()
        self._set(_worker=worker)

    def send(self, tick: Tick) -> None:
        """Leave the command for the thread; takes microseconds, whatever the bus does.

        Raises:
            SinkError: the thread gave up.
        """
        worker = self._worker
        if worker is None:
            raise SinkError(f"{self.label}: it is not open")
        if tick.side == worker.side:
            worker.post(tick)

    def state(self, side: Side) -> HandState | None:
        """The last measured state of the hand; safe from any thread."""
        worker = self._worker
        return worker.state if worker is not None and worker.side == side else None

    def close(self) -> None:
        """Bring the hand to rest as its table says, and close the bus."""
        worker = self._worker
        self._set(_worker=None)
        if worker is not None:
            worker.end()

    def _side(self, hands: Mapping[Side, Hand]) -> Side:
        if self.side is not None:
            if self.side not in hands:
                raise ConfigError(f"{self.label}: the run has no {self.side} hand; see --side")
            return self.side
        if len(hands) != 1:
            raise ConfigError(
                f"{self.label}: the run has both hands, and a device is one of them: add "
                "side=right or side=left, and name a second sink for the other"
            )
        return next(iter(hands))

    def _set(self, **values: object) -> None:
        for name, value in values.items():  # the settings are frozen, an open sink is more
            object.__setattr__(self, name, value)


def real_hand(sink: object) -> HardwareSink | None:
    """The sink if it moves a real hand, else None."""
    return sink if isinstance(sink, HardwareSink) else None


def is_driver(kind: object) -> bool:
    """True for a class of sinks that move a real hand."""
    return isinstance(kind, type) and issubclass(kind, HardwareSink)
