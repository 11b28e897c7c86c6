"""Driver of any hand built of Dynamixel X servos, and of the LEAP hand, which is one."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, MissingExtraError, SinkError
from smooth_operator_devices.hands.actuator_map import UNITS, ActuatorMap
from smooth_operator_devices.hands.bus_lock import only_port
from smooth_operator_devices.hands.device import (
    DeviceLostError,
    HandDevice,
    Reading,
    Setting,
    WrongAnswerError,
)
from smooth_operator_devices.hands.hardware_sink import HardwareSink

OPERATING_MODE: Final = (11, 1)
CURRENT_LIMIT: Final = (38, 2)
TORQUE: Final = (64, 1)
HARDWARE_ERROR: Final = (70, 1)
GAINS: Final = {"kd": (80, 2), "ki": (82, 2), "kp": (84, 2)}
BUS_WATCHDOG: Final = (98, 1)
GOAL_CURRENT: Final = (102, 2)
VOLATILE: Final = (98, 6)
"""Watchdog in the first byte, goal current in the last two; a restart deletes both."""
POWER: Final = (64, 7)
"""Torque in the first byte, hardware error in the last."""
GOAL_POSITION: Final = (116, 4)
PRESENT: Final = (126, 10)
"""Current (2), velocity (4), position (4)."""
TEMPERATURE: Final = (146, 1)

CURRENT_BASED_POSITION: Final = 5
"""The operating mode in which the goal current limits the force."""

MODELS: Final = frozenset(
    {*range(1000, 1051, 10), *range(1100, 1151, 10), *range(1170, 1241, 10)}
    | {1001, 1011, 1101, 1111, 1270, 1280, 1310}
)
"""Model numbers of the X series with a goal current: XL330, XC330, and all of XM, XH, XD and XW."""

STEPS: Final = 4096
"""Steps of a turn."""

VELOCITY_UNIT: Final = 0.229 * STEPS / 60.0
"""Steps per second of one unit of velocity, 0.229 turns a minute."""

ERRORS: Final = {
    0x01: "input voltage",
    0x04: "overheating",
    0x08: "encoder",
    0x10: "electrical shock",
    0x20: "overload",
}
"""Bits of the hardware error status. A servo with one has switched its torque off."""

_ANSWER_MS: Final = 12.0
"""Time that an answer may take beyond its time on the wire [ms]."""

_SLOW_ANSWER_MS: Final = 36.0
"""The same, if the adapter holds bytes back for 16 ms."""

_TRIES: Final = 4
"""Number of questions to a servo while the hand is opened. The first packet after power-on may be
lost, and on a busy machine an answer may be read too late."""

_Register = tuple[int, int]  # address, bytes


class DynamixelBus:
    """The servos of one port.

    Args:
        port: the serial port.
        baud: bits per second.
        ids: ids of the servos, in the order in which values are given and come back.
        names: names of the servos, for messages.

    Raises:
        MissingExtraError: the SDK is not installed.
    """

    def __init__(self, port: str, baud: int, ids: Sequence[int], names: Sequence[str]) -> None:
        try:
            import dynamixel_sdk
        except ImportError as error:
            raise MissingExtraError("the driver dynamixel", "dynamixel") from error
        self._sdk: Any = dynamixel_sdk
        self.port, self.baud, self.ids, self.names = port, baud, tuple(ids), tuple(names)
        self._packets = dynamixel_sdk.PacketHandler(2.0)
        self._handler: Any = None
        self._fast: bool | None = None  # whether the servos know the fast instruction
        self._readers: dict[_Register, Any] = {}

    def open(self) -> None:
        """Open the port, and check that every servo answers and has the X series' control table.

        Raises:
            SinkError: the port can't be opened, or servos do not answer or have another table.
        """
        try:
            self._handler = _port_handler(self._sdk, self.port, self.baud)
        except (OSError, ValueError) as error:
            raise SinkError(_cant_open(self.port, error)) from error
        named = [f"{n} ({name})" for n, name in zip(self.ids, self.names, strict=True)]
        models = [self._model(number) for number in self.ids]
        silent = [servo for servo, model in zip(named, models, strict=True) if model is None]
        if silent:
            raise SinkError(
                f"{self.port}: no answer from the servos {', '.join(silent)} at {self.baud} baud; "
                "check power, cable, baud rate and ids"
                if len(silent) < len(self.ids)
                else f"{self.port}: no servo answers at {self.baud} baud; check power, cable, baud "
                "rate and ids"
            )
        for servo, model in zip(named, models, strict=True):
            if model not in MODELS:  # an address may have another meaning there
                raise SinkError(
                    f"{self.port}: the servo {servo} is of model number {model}, which has a "
                    "different control table; expected an X series servo with a goal "
                    "current: XL330, XC330, XM, XH, XD or XW"
                )

    def close(self) -> None:
        """Give the port back; a second call does nothing."""
        handler, self._handler = self._handler, None
        self._readers.clear()
        self._fast = None
        if handler is not None:
            with contextlib.suppress(Exception):  # it may be unplugged
                handler.ser.flush()
                handler.closePort()

    def set(self, register: _Register, values: Sequence[int] | int) -> None:
        """Write a register of all servos, in one packet that is not answered."""
        address, size = register
        each = [values] * len(self.ids) if isinstance(values, int) else values
        group = self._sdk.GroupSyncWrite(self._open(), self._packets, address, size)
        for number, value in zip(self.ids, each, strict=True):
            group.addParam(number, int(value).to_bytes(size, "little", signed=value < 0))
        with self._lost():
            self._check(group.txPacket())

    def set_one(self, index: int, register: _Register, value: int) -> None:
        """Write a register of one servo, and wait for its confirmation.

        Raises:
            SinkError: the servo refuses the value.
        """
        address, size = register
        data = int(value).to_bytes(size, "little", signed=value < 0)
        with self._lost():
            for _ in range(_TRIES):
                result, error = self._packets.writeTxRx(
                    self._open(), self.ids[index], address, size, data
                )
                if result == self._sdk.COMM_SUCCESS:
                    break
        self._check(result)
        if error & 0x7F:
            text = str(self._packets.getRxPacketError(error)).removeprefix("[RxPacketError] ")
            raise SinkError(
                f"servo {self.ids[index]} ({self.names[index]}) refuses {value} at address "
                f"{address}: {text}"
            )

    def get(self, register: _Register) -> list[bytes]:
        """Read a register of all servos, in one packet.

        Raises:
            WrongAnswerError: a servo gives no valid answer in time.
            DeviceLostError: the port is gone.
        """
        reader = self._readers.get(register)
        if reader is None:
            reader = self._sdk.GroupSyncRead(self._open(), self._packets, *register)
            for number in self.ids:
                reader.addParam(number)
            self._readers[register] = reader
        with self._lost():
            self._handler.ser.reset_input_buffer()  # answers that came too late
            if self._fast is None:
                self._fast = reader.fastSyncRead() == self._sdk.COMM_SUCCESS
                self._handler.ser.reset_input_buffer()
            result = reader.fastSyncRead() if self._fast else reader.txRxPacket()
        self._check(result)
        blocks = [bytes(reader.data_dict[number]) for number in self.ids]
        if any(len(data) != register[1] for data in blocks):
            raise WrongAnswerError(f"{self.port}: received an answer of the wrong length")
        return blocks

    def get_numbers(self, register: _Register) -> list[int]:
        """Read a register of all servos as unsigned whole numbers; see ``get``."""
        return [int.from_bytes(data, "little") for data in self.get(register)]

    def _model(self, number: int) -> int | None:
        """Model number of a servo; None if it does not answer."""
        with self._lost():
            for _ in range(_TRIES):
                model, result, _ = self._packets.ping(self._open(), number)
                if result == self._sdk.COMM_SUCCESS:
                    return int(model)
        return None

    def _open(self) -> Any:
        if self._handler is None:
            raise DeviceLostError(f"{self.port} is not open")
        return self._handler

    def _check(self, result: int) -> None:
        if result != self._sdk.COMM_SUCCESS:
            text = str(self._packets.getTxRxResult(result)).removeprefix("[TxRxResult] ")
            raise WrongAnswerError(f"{self.port}: {text}")

    @contextlib.contextmanager
    def _lost(self) -> Any:
        try:
            yield
        except SinkError:
            raise
        except (IndexError, KeyError) as error:  # the SDK reads beyond the end of a short packet
            raise WrongAnswerError(f"{self.port}: received a truncated answer") from error
        except Exception as error:  # of pyserial or termios, in several classes
            raise DeviceLostError(
                f"{self.port} is gone ({error}); check cable and power"
            ) from error
        finally:
            if self._handler is not None:
                self._handler.is_using = False  # the SDK leaves it set when the port is gone


def _port_handler(sdk: Any, port: str, baud: int) -> Any:
    """An open port, exclusive, that sleeps while it waits: the SDK's own spins."""
    import serial

    class Port(sdk.PortHandler):  # type: ignore[misc]
        def setPacketTimeout(self, packet_length: int) -> None:
            self.packet_start_time = self.getCurrentTime()
            self.packet_timeout = self.tx_time_per_byte * packet_length + self.answer_ms

    handler = Port(port)
    handler.answer_ms = _ANSWER_MS
    handler.ser = serial.Serial(port, baud, timeout=0.001, write_timeout=0.2, exclusive=True)
    handler.baudrate, handler.tx_time_per_byte = baud, 1e4 / baud
    handler.is_open = True
    try:
        handler.ser.set_low_latency_mode(True)
    except (AttributeError, NotImplementedError, OSError, ValueError):
        handler.answer_ms = _SLOW_ANSWER_MS
    handler.ser.reset_input_buffer()
    return handler


def _cant_open(port: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    text = str(error)
    if number == 2 or "No such file" in text:
        return f"there is no serial port {port}; check cable and power, or name another port"
    if number == 13 or "Permission" in text or "denied" in text:
        return (
            f"no permission to open {port}: add yourself to its group (on Linux: sudo usermod -aG "
            "dialout $USER, then log in again)"
        )
    if number in (11, 16) or "exclusively lock" in text:
        return f"{port} is in use by another program; end that program first"
    return f"can't open {port}: {text}"


_SETTINGS: Final = ("baud", "current_unit", "watchdog", *GAINS)
_SLOW_EVERY: Final = 25
"""Number of cycles between two readings of slow registers."""

_SLOW: Final = (HARDWARE_ERROR, TEMPERATURE)
"""Slow registers, which are read in turns."""

_STRUCK: Final = 255
"""Value of the watchdog's register after it has stopped the servo."""


@dataclass(frozen=True)
class DynamixelSink(HardwareSink):
    """A hand built of Dynamixel X servos, in current-based position mode.

    The table has the servos' ids. Its unit is ``rad``, ``deg`` or ``step`` (4096 to a turn), and
    its limit the largest current [mA]. ``settings`` may have ``baud``, ``current_unit`` [mA] (1 for
    XL330 and XC330, 2.69 for XM430 and XH540), ``watchdog`` [s], and the gains ``kp``, ``ki``,
    ``kd``, for all servos or for one.

    Attributes:
        baud: bits per second; None for those of the table.
    """

    driver: ClassVar[str] = "dynamixel"

    baud: int | None = None

    @property
    def bus(self) -> str:
        """The serial port; by default the only one of this machine."""
        return self.port or only_port(self.driver, "dynamixel")

    def device(self, actuators: ActuatorMap) -> DynamixelHand:
        """The servos, not yet open."""
        return DynamixelHand(self.bus, actuators, self.baud)


@dataclass(frozen=True)
class LeapSink(DynamixelSink):
    """The LEAP Hand v1: 16 XC330 servos. Settings as those of ``dynamixel``."""

    driver: ClassVar[str] = "leap"


class DynamixelHand(HandDevice):
    """The servos of a hand, as ``HandDevice``.

    Args:
        actuators: the table.
    """

    driver, name, motors = "dynamixel", "a hand of Dynamixel servos", 0

    def __init__(self, port: str, actuators: ActuatorMap, baud: int | None = None) -> None:
        super().__init__(actuators)
        settings = actuators.settings
        self._check_settings(_SETTINGS)
        if actuators.unit not in UNITS:
            raise ConfigError(
                f"{actuators.file}: the unit of servos must be {' or '.join(UNITS)}, not "
                f"{actuators.unit!r}"
            )
        ids = [a.id for a in actuators.actuators if a.id is not None]
        if len(ids) < len(actuators.actuators) or not all(0 <= number <= 252 for number in ids):
            raise ConfigError(f"{actuators.file}: every servo needs an id of 0 to 252")
        self._scale = UNITS["step"] / UNITS[actuators.unit]
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
        self._written = 0.0  # time of the last goals [s]
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
        self._powered = True

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
            self._errors,
        )

    def write(self, commands: Float[np.ndarray, " a"]) -> None:
        """Send goal positions; the first ones switch the torque on.

        Raises:
            DeviceLostError: the servos' watchdogs have stopped them after a silence. They refuse
                goals until they are opened again.
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
        errors = []
        for name, bits in zip(self._table.names, values, strict=True):
            if bits:
                words = ", ".join(text for bit, text in ERRORS.items() if bits & bit)
                words = words or f"error 0x{bits:02x}"
                errors.append(f"{name}: {words}; switch its power off and on")
        self._errors = tuple(errors)

    def _refuse_struck(self, watchdogs: Sequence[int]) -> None:
        if _STRUCK in watchdogs:
            raise DeviceLostError(
                "the servos stopped themselves, because they received nothing for "
                f"{self._watchdog:g} s"
            )
