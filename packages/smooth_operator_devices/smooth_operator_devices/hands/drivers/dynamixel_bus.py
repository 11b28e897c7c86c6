"""Registers of Dynamixel X servos, and a bus of them, through ROBOTIS' SDK."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any, Final

from smooth_operator.errors import SinkError, require
from smooth_operator_devices.hands.device import WrongAnswerError
from smooth_operator_devices.hands.drivers.servo_bank import TRIES, ServoBus, open_port

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

_Register = tuple[int, int]  # address, bytes


class DynamixelBus(ServoBus):
    """The servos of one port; see ``ServoBus``.

    Raises:
        MissingExtraError: the SDK is not installed.
    """

    def __init__(self, port: str, baud: int, ids: Sequence[int], names: Sequence[str]) -> None:
        super().__init__(port, baud, ids, names)
        require("the driver dynamixel", "dynamixel", "dynamixel_sdk")
        import dynamixel_sdk

        self._sdk: Any = dynamixel_sdk
        self._packets = dynamixel_sdk.PacketHandler(2.0)
        self._fast: bool | None = None  # whether the servos know the fast instruction
        self._readers: dict[_Register, Any] = {}

    def open(self) -> None:
        """Open the port, and check that every servo answers and has the X series' control table.

        Raises:
            SinkError: the port can't be opened, or servos do not answer or have another table.
        """
        self._line = _port_handler(self._sdk, self.port, self.baud)
        self._find(MODELS, "an X series servo with a goal current: XL330, XC330, XM, XH, XD or XW")

    def close(self) -> None:
        """Give the port back; a second call does nothing."""
        handler, self._line = self._line, None
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
            for _ in range(TRIES):
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
            self._line.ser.reset_input_buffer()  # answers that came too late
            if self._fast is None:
                self._fast = reader.fastSyncRead() == self._sdk.COMM_SUCCESS
                self._line.ser.reset_input_buffer()
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
            for _ in range(TRIES):
                model, result, _ = self._packets.ping(self._open(), number)
                if result == self._sdk.COMM_SUCCESS:
                    return int(model)
        return None

    def _check(self, result: int) -> None:
        if result != self._sdk.COMM_SUCCESS:
            text = str(self._packets.getTxRxResult(result)).removeprefix("[TxRxResult] ")
            raise WrongAnswerError(f"{self.port}: {text}")

    @contextlib.contextmanager
    def _lost(self) -> Iterator[None]:
        try:
            with super()._lost():
                yield
        finally:
            if self._line is not None:
                self._line.is_using = False  # the SDK leaves it set when the port is gone


def _port_handler(sdk: Any, port: str, baud: int) -> Any:
    """An open port; the SDK's own is shared with other programs, and spins while it waits."""

    class Port(sdk.PortHandler):  # type: ignore[misc]
        def setPacketTimeout(self, packet_length: int) -> None:
            self.packet_start_time = self.getCurrentTime()
            self.packet_timeout = self.tx_time_per_byte * packet_length + self.answer_ms

    handler = Port(port)
    handler.ser, handler.answer_ms = open_port(port, baud)
    handler.baudrate, handler.tx_time_per_byte = baud, 1e4 / baud
    handler.is_open = True
    return handler
