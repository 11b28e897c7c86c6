"""One Modbus device on TCP or on a serial line, through pymodbus."""

from __future__ import annotations

import logging
import struct
import time
from collections.abc import Callable
from typing import Any, Final

from smooth_operator_devices.hands.bus_lock import is_serial
from smooth_operator_devices.hands.device import DeviceLostError, WrongAnswerError

TIMEOUT: Final = 0.2
"""Time that an answer may take [s]."""


class ModbusLine:
    """One Modbus device, which answers one request at a time.

    An Inspire hand may answer with a transaction number that is off by one. The first answer on a
    new connection can't be an old one, so its difference counts for all answers on it; an answer
    with another difference is one that came too late.

    Args:
        driver: name of the driver, for messages.
        port: ``ADDRESS`` or ``ADDRESS:PORT`` for Modbus TCP; a serial port for Modbus RTU.
        device_id: number of the device.
        baud: bits per second of a serial line.
        tcp_port: port without one in ``port``.
        why: function that returns the device's reason for a refusal, given the register and the
            Modbus exception; it may ask the device, and returns an empty text without a reason.
    """

    def __init__(
        self,
        driver: str,
        port: str,
        device_id: int,
        baud: int,
        tcp_port: int = 502,
        why: Callable[[int, int], str] = lambda register, code: "",
    ) -> None:
        self._driver, self._port, self._device_id = driver, port, device_id
        self._baud, self._tcp_port, self._why = baud, tcp_port, why
        self._client: Any = None
        self._number, self._difference = 0, -1

    def open(self) -> None:
        """Connect.

        Raises:
            DeviceLostError: nothing answers at the port.
        """
        from pymodbus.client import ModbusSerialClient, ModbusTcpClient

        # Without a handler of its own, each lost answer would be a line in the user's terminal.
        logging.getLogger("pymodbus").addHandler(logging.NullHandler())
        if is_serial(self._port):
            self._client = ModbusSerialClient(
                self._port, baudrate=self._baud, timeout=TIMEOUT, retries=0
            )
        else:
            host, _, number = self._port.partition(":")
            port = int(number or self._tcp_port)
            self._client = ModbusTcpClient(
                host, port=port, timeout=TIMEOUT, retries=0, trace_packet=self._renumbered
            )
        self._difference = -1
        if not self._client.connect():
            raise DeviceLostError(f"{self._driver}: nothing answers at {self._port}")

    def close(self) -> None:
        """Give the line back; a second call does nothing."""
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def ask(self, address: int, count: int) -> list[int]:
        """Reads words from holding registers.

        Raises:
            WrongAnswerError: there is no valid answer in time, or the device refuses.
            DeviceLostError: there is no connection.
        """
        words: list[int] = self._exchange("read_holding_registers", address, count=count).registers
        if len(words) != count:
            raise WrongAnswerError(
                f"{self._driver}: {len(words)} words received from register {address} instead of "
                f"{count}"
            )
        return words

    def tell(self, address: int, words: list[int]) -> None:
        """Write holding registers; see ``ask``."""
        self._exchange("write_registers", address, words)

    def _exchange(self, function: str, *values: Any, **named: Any) -> Any:
        """Send a request and wait for its answer; clears the line of an answer that is late."""
        from pymodbus.exceptions import ConnectionException, ModbusException

        if self._client is None:
            raise DeviceLostError(f"{self._driver}: the hand is not open")
        try:
            answer = getattr(self._client, function)(*values, device_id=self._device_id, **named)
        except (ConnectionException, OSError) as error:
            raise DeviceLostError(
                f"{self._driver}: no connection to the hand at {self._port}"
            ) from error
        except (ModbusException, struct.error, ValueError) as error:
            self._clear()
            raise WrongAnswerError(
                f"{self._driver}: no valid answer from device {self._device_id} at {self._port} "
                f"within {TIMEOUT:g} s"
            ) from error
        if answer.isError():
            code = getattr(answer, "exception_code", 0)
            reason = self._why(values[0], code) or f"Modbus exception {code}"
            raise WrongAnswerError(
                f"{self._driver}: the hand refused register {values[0]} ({reason})"
            )
        return answer

    def _renumbered(self, sent: bool, data: bytes) -> bytes:
        """An answer with the number of its question; pymodbus drops all others."""
        if len(data) < 2:
            return data
        number = int.from_bytes(data[:2], "big")
        if sent:
            self._number = number
            return data
        difference = (number - self._number) & 0xFFFF
        if self._difference < 0:
            self._difference = difference
        right = difference == self._difference
        return self._number.to_bytes(2, "big") + data[2:] if right else data

    def _clear(self) -> None:
        """Drop late answers: close the connection, or read the serial line until it is silent."""
        if not is_serial(self._port):
            self._client.close()  # the next request opens it again
            self._difference = -1
            return
        line = self._client.socket
        deadline = time.perf_counter() + TIMEOUT
        try:
            while line is not None and time.perf_counter() < deadline:
                line.reset_input_buffer()
                time.sleep(0.01)
                if not line.in_waiting:
                    return
        except OSError as error:
            raise DeviceLostError(f"{self._driver}: {self._port} is gone ({error})") from error
