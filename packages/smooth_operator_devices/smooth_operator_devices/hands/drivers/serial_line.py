"""One serial line of a hand, through pyserial."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

from smooth_operator.errors import SinkError
from smooth_operator_devices.hands.device import DeviceLostError, WrongAnswerError


class SerialLine:
    """A serial port, opened for this program alone.

    Args:
        driver: name of the driver, for messages.
        port: name of the port.
        baud: bits per second.
        timeout: time that the port may take to accept data [s].

    Raises:
        SinkError: the port can't be opened.
    """

    def __init__(self, driver: str, port: str, baud: int, timeout: float) -> None:
        import serial

        self._driver, self._port = driver, port
        try:
            self._serial = serial.Serial(
                port, baud, timeout=0.005, write_timeout=timeout, exclusive=True
            )
        except (OSError, ValueError) as error:
            raise SinkError(
                f"{driver}: the port {port} can't be opened ({error}); check the cable and your "
                "permission to use the port (on Linux: group dialout)"
            ) from error

    def waiting(self) -> bytes:
        """The bytes that have arrived; waits a moment if there are no bytes yet."""
        data: bytes = self._do(lambda line: line.read(max(1, line.in_waiting)))
        return data

    def take(self) -> bytes:
        """The bytes that have arrived, without waiting."""
        data: bytes = self._do(lambda line: line.read(line.in_waiting))
        return data

    def send(self, data: bytes) -> None:
        """Sends bytes."""
        self._do(lambda line: line.write(data))

    def clear(self) -> None:
        """Drops the bytes that have arrived."""
        self._do(lambda line: line.reset_input_buffer())

    def close(self) -> None:
        """Gives the port back."""
        with contextlib.suppress(OSError):
            self._serial.close()

    def _do(self, action: Callable[[Any], Any]) -> Any:
        import serial

        try:
            return action(self._serial)
        except serial.SerialTimeoutException as error:
            raise WrongAnswerError(f"{self._driver}: {self._port} accepts no data") from error
        except (OSError, TypeError) as error:  # TypeError: pyserial, while the port is closing
            raise DeviceLostError(f"{self._driver}: the port {self._port} is gone") from error
