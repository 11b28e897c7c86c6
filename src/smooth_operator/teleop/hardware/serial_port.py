"""Serial ports that hands are on: which there are, and the one that is meant."""

from __future__ import annotations

import re

from smooth_operator.errors import MissingExtraError, SinkError


def is_serial(port: str) -> bool:
    """Whether a name is one of a serial port, a path or ``COM3``, and not an address."""
    return "/" in port or bool(re.fullmatch(r"(\\\\\.\\)?COM\d+", port, re.IGNORECASE))


def serial_ports() -> dict[str, str]:
    """Serial ports of USB adapters -> what they say that they are; empty without pyserial."""
    try:
        from serial.tools import list_ports
    except ImportError:
        return {}
    return {
        port.device: port.description or port.hwid
        for port in sorted(list_ports.comports(), key=lambda port: port.device)
        if port.vid is not None
    }


def only_port(driver: str, extra: str) -> str:
    """The only USB serial port of this machine.

    Raises:
        MissingExtraError: pyserial is not installed.
        SinkError: there is none, or more than one.
    """
    try:
        import serial  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(f"the driver {driver}", extra) from error
    ports = serial_ports()
    if len(ports) == 1:
        return next(iter(ports))
    found = ", ".join(ports) or "none"
    raise SinkError(
        f"{driver}: name the serial port, such as {driver}:/dev/ttyUSB0; there are: {found}. "
        "Check cable and power if the hand's is not among them"
    )
