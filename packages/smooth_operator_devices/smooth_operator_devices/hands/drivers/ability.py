"""Driver of the PSYONIC Ability Hand on its serial line.

Facts of the protocol, from the maker's interface document and API: 460800 baud; frames between
tildes (0x7E), with 0x7D before a byte that would be one of both and is XORed with 0x20. To the
hand: address (0x50), command, six little-endian int16, and a checksum that makes the sum of all
bytes 0. Commands: 0x10 positions, 0x30 currents, 0xA0 nothing but an answer; plus 0, 1 or 2 for
what is answered. Answer 0: position and current of each finger, 30 touch sensors of 12 bits, a byte
with the fingers that are too hot, checksum. A position is 32767 for 150 degrees. Order: index,
middle, ring, little finger, thumb flexor, thumb rotator. Fingers take 0 to 100 degrees, the rotator
0 to -100. After 300 ms without a frame the hand ignores commands until the next frame.
"""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import require
from smooth_operator.settings import check_range
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.device import HandDevice, Reading, WrongAnswerError
from smooth_operator_devices.hands.drivers.serial_line import SerialLine
from smooth_operator_devices.hands.hardware_sink import HardwareSink

MOTORS: Final = 6
DEGREE: Final = 32767 / 150
"""Units of a position per degree."""
MILLIAMPERE: Final = 0.620606079
"""Units of a current per mA."""

_POSITIONS, _CURRENTS, _NOTHING = 0x10, 0x30, 0xA0
_FRAME, _ESCAPE, _MASK = 0x7E, 0x7D, 0x20
_ANSWER: Final = 72
"""Bytes of answer 0: header, 6 pairs, 45 of touch, heat, checksum."""
_TIMEOUT: Final = 0.05
"""Time that an answer may take [s]."""


@dataclass(frozen=True)
class AbilitySink(HardwareSink):
    """Moves a PSYONIC Ability Hand; see ``HardwareSink``.

    Attributes:
        port: its serial port.
        baud: baud rate of the port; the hand's own is 460800.
        address: address of the hand on its line.

    Raises:
        ConfigError: a setting is out of its range.
    """

    driver: ClassVar[str] = "ability"

    port: str = "/dev/ttyUSB0"
    baud: int = 460800
    address: int = 0x50

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("ability: baud", self.baud, 1200, 4_000_000)
        check_range("ability: address", self.address, 0, 255)

    def device(self, actuators: ActuatorMap) -> AbilityDevice:
        """The hand, not yet open; see ``HardwareSink``."""
        require(AbilityDevice.name, "ability", "serial")
        return AbilityDevice(actuators, self.port, self.baud, self.address)


class AbilityDevice(HandDevice):
    """An Ability Hand on its line; see ``HandDevice``.

    The hand's limit of current can't be set; ``limit`` [mA] is that of the contact guard. So the
    driver sets nothing that a restart could delete.

    Args:
        table: table of the hand.
    """

    driver, name, motors = "ability", "an Ability Hand", MOTORS

    def __init__(self, table: ActuatorMap, port: str, baud: int, address: int) -> None:
        super().__init__(table)
        self._port, self._baud, self._address = port, baud, address
        self._line: SerialLine | None = None
        self._expected = False

    def open(self) -> None:
        """Open the port and read the positions; see ``HandDevice``."""
        self._line = SerialLine("ability", self._port, self._baud, _TIMEOUT)
        self._expected = False
        with self._opening(
            f"check the hand's power, that it is set to {self._baud} baud, and that byte "
            "stuffing is on (We46 and We47 in the vendor's app)"
        ):
            self.read()

    def read(self) -> Reading:
        """The answer to the last command, or to a question; see ``HandDevice``."""
        if not self._expected:
            self._send(_NOTHING, None)
        self._expected = False
        body = self._answer()
        pairs = np.array(struct.unpack("<12h", body[1:25]), float)
        packed = np.frombuffer(body[25:70], np.uint8).reshape(15, 3).astype(int)
        words = packed @ [1, 1 << 8, 1 << 16]
        hot = [body[70] >> k & 1 for k in range(MOTORS)]
        return Reading(
            positions=pairs[::2] / DEGREE,
            currents=pairs[1::2] / MILLIAMPERE,
            errors=self._reports(hot, lambda bit: "too hot" if bit else ""),
            touch=np.stack([words & 0xFFF, words >> 12], axis=1).ravel().astype(float),
        )

    def write(self, commands: Float[np.ndarray, " 6"]) -> None:
        """Send the positions [deg]; see ``HandDevice``."""
        self._send(_POSITIONS, np.rint(np.asarray(commands) * DEGREE))

    def relax(self) -> None:
        """Switch off the current of all motors; see ``HandDevice``."""
        self._send(_CURRENTS, np.zeros(MOTORS))

    def close(self) -> None:
        """Give the port back; the hand ignores commands 300 ms later. See ``HandDevice``."""
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def _send(self, command: int, values: Float[np.ndarray, " 6"] | None) -> None:
        body = bytes([self._address, command])
        if values is not None:
            body += struct.pack("<6h", *np.clip(values, -32767, 32767).astype(int))
        line = self._opened(self._line)
        line.clear()
        line.send(framed(body + bytes([-sum(body) & 0xFF])))
        self._expected = True

    def _answer(self) -> bytes:
        """The next valid answer of the hand."""
        deadline, frame, wrong = time.perf_counter() + _TIMEOUT, bytearray(), ""
        while time.perf_counter() < deadline:
            for byte in self._opened(self._line).waiting():
                if byte != _FRAME:
                    frame.append(byte)
                    continue
                if not frame:
                    continue
                body, frame = unstuffed(bytes(frame)), bytearray()
                if len(body) == _ANSWER and not sum(body) & 0xFF and body[0] & 0xF == 0:
                    return body
                wrong = (
                    f"; received a frame of {len(body)} bytes, expected {_ANSWER} and checksum 0"
                )
        raise WrongAnswerError(f"ability: no valid answer from the hand in {_TIMEOUT:g} s{wrong}")


def framed(body: bytes) -> bytes:
    """A body between tildes, with special bytes escaped."""
    out = bytearray([_FRAME])
    for byte in body:
        out += bytes([_ESCAPE, byte ^ _MASK]) if byte in (_FRAME, _ESCAPE) else bytes([byte])
    return bytes(out) + bytes([_FRAME])


def unstuffed(frame: bytes) -> bytes:
    """The bytes between two tildes, without escapes."""
    out, escaped = bytearray(), False
    for byte in frame:
        if byte == _ESCAPE:
            escaped = True
        else:
            out.append(byte ^ _MASK if escaped else byte)
            escaped = False
    return bytes(out)
