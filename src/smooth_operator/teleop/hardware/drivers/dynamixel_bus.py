"""Dynamixel servos of the X series on one bus: protocol 2.0 through ROBOTIS' own SDK.

Addresses and units are those of the control tables that ROBOTIS publishes for the X series
(XL330, XC330, XM430 and others alike).
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any, Final

from smooth_operator.errors import MissingExtraError, SinkError
from smooth_operator.teleop.hardware.device import DeviceLostError, WrongAnswerError

OPERATING_MODE: Final = (11, 1)
CURRENT_LIMIT: Final = (38, 2)
TORQUE: Final = (64, 1)
HARDWARE_ERROR: Final = (70, 1)
GAINS: Final = {"kd": (80, 2), "ki": (82, 2), "kp": (84, 2)}
BUS_WATCHDOG: Final = (98, 1)
GOAL_CURRENT: Final = (102, 2)
VOLATILE: Final = (98, 6)
"""Watchdog (1), and goal current (2) in the last two bytes: gone after a restart."""
POWER: Final = (64, 7)
"""Torque in the first byte, hardware error in the last."""
GOAL_POSITION: Final = (116, 4)
PRESENT: Final = (126, 10)
"""Current (2), velocity (4), position (4)."""
TEMPERATURE: Final = (146, 1)

CURRENT_BASED_POSITION: Final = 5
"""The operating mode in which the goal current limits the force."""

MODELS: Final = frozenset(
    (1000, 1001, 1010, 1011, 1020, 1030, 1040, 1050, 1100, 1101, 1110, 1111, 1120, 1130, 1140, 1150,
     1170, 1180, 1190, 1200, 1210, 1220, 1230, 1240, 1270, 1280, 1310)
)  # fmt: skip
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
"""How long an answer may take beyond its time on the wire [ms]."""

_TRIES: Final = 4
"""How often a servo is asked while the hand is opened. The first packet after power-on may be
lost, and on a busy machine an answer may be read too late."""

_Register = tuple[int, int]  # address, bytes


class DynamixelBus:
    """The servos of one port.

    Args:
        port: the serial port.
        baud: bits per second.
        ids: ids of the servos, in the order in which values are given and come back.
        names: what messages call them.
        extra: the extra that brings the SDK, for the message where it is missing.

    Raises:
        MissingExtraError: the SDK is not installed.
    """

    def __init__(self, port: str, baud: int, ids: Sequence[int], names: Sequence[str]) -> None:
        try:
            import dynamixel_sdk
        except ImportError as error:
            raise MissingExtraError("Dynamixel servos", "dynamixel") from error
        self._sdk: Any = dynamixel_sdk
        self.port, self.baud, self.ids, self.names = port, baud, tuple(ids), tuple(names)
        self._packets = dynamixel_sdk.PacketHandler(2.0)
        self._handler: Any = None
        self._fast: bool | None = None  # whether the servos know the fast instruction
        self._readers: dict[_Register, Any] = {}

    def open(self) -> None:
        """Open the port, and check that every servo answers and has the X series' control table.

        Raises:
            SinkError: there is no such port, it is in use, servos do not answer or are others.
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
            if model not in MODELS:  # the same address may mean something else there
                raise SinkError(
                    f"{self.port}: the servo {servo} is of model number {model}, whose control "
                    "table is another one; expected an X series servo with a goal current: XL330, "
                    "XC330, XM, XH, XD or XW"
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
        """Write a register of one servo, and wait for its word that it took it.

        Raises:
            SinkError: it refuses the value.
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
            WrongAnswerError: a servo does not answer in time, or not as it should.
            DeviceLostError: the port is gone.
        """
        reader = self._readers.get(register)
        if reader is None:
            reader = self._sdk.GroupSyncRead(self._open(), self._packets, *register)
            for number in self.ids:
                reader.addParam(number)
            self._readers[register] = reader
        with self._lost():
            self._handler.ser.reset_input_buffer()  # what came too late for the last question
            if self._fast is None:
                self._fast = reader.fastSyncRead() == self._sdk.COMM_SUCCESS
                self._handler.ser.reset_input_buffer()
            result = reader.fastSyncRead() if self._fast else reader.txRxPacket()
        self._check(result)
        blocks = [bytes(reader.data_dict[number]) for number in self.ids]
        if any(len(data) != register[1] for data in blocks):
            raise WrongAnswerError(f"{self.port}: an answer of the wrong length")
        return blocks

    def get_numbers(self, register: _Register) -> list[int]:
        """The same as whole numbers without sign."""
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
        except (IndexError, KeyError) as error:  # the SDK reads on behind a short packet's end
            raise WrongAnswerError(f"{self.port}: an answer is cut short") from error
        except Exception as error:  # of pyserial or termios, in several classes
            raise DeviceLostError(
                f"{self.port} is gone ({error}); check cable and power"
            ) from error
        finally:
            if self._handler is not None:
                self._handler.is_using = False  # the SDK leaves it set when the port is gone


def _port_handler(sdk: Any, port: str, baud: int) -> Any:
    """An open port, exclusive, that sleeps while it waits: the SDK's own spins.

    Raises:
        OSError: there is no such port, or it is in use.
        ValueError: it does not know the baud rate.
    """
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
        handler.ser.set_low_latency_mode(True)  # USB adapters hold bytes back for 16 ms otherwise
    except (AttributeError, NotImplementedError, OSError, ValueError):
        handler.answer_ms = 36.0
    handler.ser.reset_input_buffer()
    return handler


def _cant_open(port: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    text = str(error)
    if number == 2 or "No such file" in text:
        return f"there is no serial port {port}; check cable and power, or name another one"
    if number == 13 or "Permission" in text or "denied" in text:
        return (
            f"no permission to open {port}: add yourself to its group (on Linux: sudo usermod -aG "
            "dialout $USER, then log in again)"
        )
    if number in (11, 16) or "exclusively lock" in text:
        return f"{port} is in use by another program; end that one first"
    return f"can't open {port}: {text}"


def errors_of(bits: int) -> str:
    """The hardware error status in words."""
    return ", ".join(text for bit, text in ERRORS.items() if bits & bit) or f"error 0x{bits:02x}"


def gains_of(settings: Mapping[str, Any]) -> dict[str, int]:
    """The gains among settings of a table."""
    return {name: int(settings[name]) for name in GAINS if name in settings}
