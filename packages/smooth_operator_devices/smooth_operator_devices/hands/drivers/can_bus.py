"""A CAN bus with a real hand on it, through python-can."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from smooth_operator.errors import SinkError
from smooth_operator_devices.hands.device import DeviceLostError
from smooth_operator_devices.hands.hardware_sink import HardwareSink

BITRATE: Final = 1_000_000
DATA_BITRATE: Final = 5_000_000

_INTERFACES: Final = {"linux": "socketcan", "win32": "pcan", "darwin": "slcan"}


def can_port(port: str) -> tuple[str, str]:
    """Interface and channel of a port of ``CanBus``."""
    interface, colon, channel = port.partition(":")
    return (interface, channel) if colon else (_INTERFACES.get(sys.platform, "socketcan"), port)


@dataclass(frozen=True)
class CanSink(HardwareSink):
    """Base class of the sinks of hands on a CAN bus; see ``HardwareSink``.

    Attributes:
        port: a CAN channel, ``can0`` or ``INTERFACE:CHANNEL`` of python-can.
    """

    port: str = "can0"

    @property
    def bus(self) -> str:
        """The CAN channel, with its interface."""
        return "can:" + ":".join(can_port(self.port))


class CanBus:
    """One CAN bus at 1 Mbit/s, with 11-bit identifiers; several threads may send.

    Args:
        port: a channel such as ``can0``, or ``INTERFACE:CHANNEL`` with an interface of python-can:
            ``pcan:PCAN_USBBUS1``, ``slcan:/dev/ttyACM0``. Without an interface: socketcan on Linux,
            pcan on Windows, slcan on macOS.
        driver: name of the driver, for messages.
        fd: frames of CAN FD, with data at 5 Mbit/s.

    Raises:
        SinkError: the bus can't be opened.
    """

    def __init__(self, port: str, driver: str, *, fd: bool = False) -> None:
        import can

        interface, channel = can_port(port)
        self._can, self._driver, self._port, self._fd = can, driver, port, fd
        self._sending = threading.Lock()  # frames of two threads must not mix on a serial adapter
        try:
            more: dict[str, Any] = {"fd": True, "data_bitrate": DATA_BITRATE} if fd else {}
            self._bus: Any = can.Bus(interface=interface, channel=channel, bitrate=BITRATE, **more)
        except (can.CanError, OSError, ValueError, ImportError, NotImplementedError) as error:
            up = (
                f"ip link set {channel} up type can bitrate {BITRATE}"
                + (f" dbitrate {DATA_BITRATE} fd on" if fd else "")
                if interface == "socketcan"
                else "see the interfaces of python-can"
            )
            raise SinkError(
                f"{driver}: the CAN bus {port} can't be opened ({error}); plug the adapter in and "
                f"set it to 1 Mbit/s: {up}"
            ) from error

    def send(self, identifier: int, data: bytes = b"", *, remote: bool = False) -> None:
        """Put a frame on the bus.

        Raises:
            DeviceLostError: the adapter is gone, or no device on the bus acknowledges.
        """
        message = self._can.Message(
            arbitration_id=identifier,
            data=data,
            is_extended_id=False,
            is_remote_frame=remote,
            is_fd=self._fd,
            bitrate_switch=self._fd,
        )
        try:
            with self._sending:
                self._bus.send(message, timeout=0.05)
        except (self._can.CanError, OSError) as error:
            raise self._lost(error) from error

    def receive(self, timeout: float) -> tuple[int, bytes] | None:
        """The next data frame, identifier and data; None if none comes in time [s].

        Raises:
            DeviceLostError: the adapter is gone.
        """
        try:
            message = self._bus.recv(timeout=max(timeout, 0.0))
        except (self._can.CanError, OSError) as error:
            raise self._lost(error) from error
        if message is None or message.is_error_frame or message.is_remote_frame:
            return None
        return message.arbitration_id, bytes(message.data)

    def until(self, deadline: float) -> Iterator[tuple[int, bytes]]:
        """The frames until a time of ``time.perf_counter``; at least those that are waiting."""
        while True:
            left = deadline - time.perf_counter()
            frame = self.receive(left)
            if frame is not None:
                yield frame
            elif left <= 0.0:
                return

    def close(self) -> None:
        """Give the bus back; never raises."""
        try:
            self._bus.shutdown()
        except Exception:
            return

    def _lost(self, error: Exception) -> DeviceLostError:
        return DeviceLostError(
            f"{self._driver}: the CAN bus {self._port} does not work ({error}); check the "
            "adapter, the hand's power and the two terminating resistors"
        )
