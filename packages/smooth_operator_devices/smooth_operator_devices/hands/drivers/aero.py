"""Driver of TetherIA's Aero Hand Open on a serial line.

Facts of the protocol, by the maker: TetherIA/aero-open-firmware, commit d7bd82e8
(``main/firmware_v0.1.0.ino``), and the package ``aero-open-sdk`` 0.1.0.dev1. 921600 baud. A frame
is 16 bytes without a checksum: operation, 0, seven words, low byte first. Order: thumb abduction,
flexion and tendon, index, middle, ring, pinky. 0x11 sets positions, 0 (extended) to 65535, and is
not answered; 0x12 sets torques; 0x22, 0x24 and 0x25 ask for positions, currents (6.5 mA) and
temperatures (degrees Celsius); 0x31 and 0x32 limit speed (up to 32766) and torque (up to 1023) of
one actuator, and answer with the value that holds. At power on the hand prints text.

The hand cuts what it receives into 16 bytes each, whatever they are: after a lost byte it
understands nothing. The driver then sends single zeros until a question is answered; a frame of
operation 0 does nothing.
"""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import require
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.bus_lock import only_port
from smooth_operator_devices.hands.device import (
    DeviceLostError,
    HandDevice,
    Reading,
    WrongAnswerError,
)
from smooth_operator_devices.hands.drivers.serial_line import SerialLine
from smooth_operator_devices.hands.hardware_sink import HardwareSink

MOTORS: Final = 7
BAUD: Final = 921600
MILLIAMPERES: Final = 6.5
"""Current of a unit [mA]."""

_FRAME: Final = 16
_POSITIONS, _TORQUES = 0x11, 0x12
_ASK_POSITIONS, _ASK_CURRENTS, _ASK_TEMPERATURES = 0x22, 0x24, 0x25
_LIMIT_SPEED, _LIMIT_TORQUE = 0x31, 0x32
_IN_TURNS: Final = (_ASK_CURRENTS, _ASK_CURRENTS, _ASK_CURRENTS, _ASK_TEMPERATURES)
_POWER_ON: Final = (b"[BOOT]", b"[Init]", b"Servo ")
"""Parts of the text that the hand prints at power on."""

_TIMEOUT: Final = 0.1
"""Time that an answer may take [s]."""
_PROBE: Final = 0.03
"""Time to wait for an answer while the frames may be shifted [s]."""


@dataclass(frozen=True)
class AeroSink(HardwareSink):
    """Moves an Aero Hand Open; see ``HardwareSink``.

    Attributes:
        port: its serial port; empty for the only USB adapter.
    """

    driver: ClassVar[str] = "aero"

    def device(self, actuators: ActuatorMap) -> AeroDevice:
        """The hand, not yet open; see ``HardwareSink``."""
        require(AeroDevice.name, "aero", "serial")
        return AeroDevice(actuators, self.port)


class AeroDevice(HandDevice):
    """An Aero Hand Open on its line; see ``HandDevice``.

    ``relax`` switches to torque control without torque, so that the tendons give way. The limits
    can't be read without setting them; the driver notices a restart by the text of the hand.
    ``Reading.currents`` is in mA. The protocol has no fault codes. While one servo does not answer
    the hand's own controller, all values stay as they were.

    Args:
        table: table of the hand. Its settings may have ``speed`` (1 to 32766) and ``torque`` (1 to
            1000), the hand's own limits. ``limit`` [mA] is that of the contact guard.
    """

    driver, name, motors = "aero", "an Aero Hand Open", MOTORS

    def __init__(self, table: ActuatorMap, port: str) -> None:
        super().__init__(table)
        self._check_settings(("speed", "torque"))
        self._port = port
        self._speed = self._setting("speed", 32766, 1, 32766)
        self._torque = self._setting("torque", 700, 1, 1000)
        self._line: SerialLine | None = None
        self._turn = self._missed = 0
        self._currents: Float[np.ndarray, " 7"] | None = None
        self._temperatures: Float[np.ndarray, " 7"] | None = None

    def open(self) -> None:
        """Open the port, find the beginning of a frame, set limits; see ``HandDevice``."""
        port = self._port or only_port("aero", "aero")
        self._line = SerialLine("aero", port, BAUD, _TIMEOUT)
        self._turn = self._missed = 0
        self._currents = self._temperatures = None
        self._limited = False
        with self._opening("check the hand's power and cable, and that it is not homing"):
            self._synchronise()
            self._limit()
            self.read()

    def _limit(self) -> None:
        """Send speed and torque, which a restart of the hand deletes, and check the answers."""
        for actuator in range(MOTORS):
            for operation, value in ((_LIMIT_SPEED, self._speed), (_LIMIT_TORQUE, self._torque)):
                holds = self._asked(operation, actuator, value)[:2].tolist()
                if holds != [actuator, value]:
                    name = self._table.names[actuator]
                    raise WrongAnswerError(
                        f"aero: the hand answered {holds} to the limit {value} of {name}"
                    )

    def read(self) -> Reading:
        """Positions, and currents or temperatures in turns; see ``HandDevice``."""
        if self._missed > 1:
            self._synchronise()
        try:
            positions = self._asked(_ASK_POSITIONS)
            operation = _IN_TURNS[self._turn % len(_IN_TURNS)]
            words = self._asked(operation)
        except WrongAnswerError:
            self._missed += 1
            raise
        self._missed = 0
        self._turn += 1
        if operation == _ASK_CURRENTS:
            self._currents = MILLIAMPERES * words.astype(np.uint16).astype(np.int16)
        else:
            self._temperatures = words.astype(float)
        return Reading(
            positions=positions.astype(float),
            currents=self._currents,
            temperatures=self._temperatures,
        )

    def write(self, commands: Float[np.ndarray, " 7"]) -> None:
        """Send the positions, 0 (extended) to 65535, the first time after the limits; see
        ``HandDevice``."""
        if not self._limited:
            self._limit()
            self._limited = True
        self._send(_POSITIONS, *np.clip(np.rint(commands), 0, 65535).astype(int).tolist())

    def relax(self) -> None:
        """Switch to torque control without torque; see ``HandDevice``."""
        self._send(_TORQUES)
        super().relax()

    def close(self) -> None:
        """Give the port back; the hand keeps its last target. See ``HandDevice``."""
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def _synchronise(self) -> None:
        """Shift the frames byte by byte until the hand answers twice; two rounds, because an answer
        may be late on a busy machine."""
        for _ in range(2 * _FRAME + 1):
            try:
                self._asked(_ASK_POSITIONS, seconds=_PROBE)
                self._asked(_ASK_POSITIONS)
            except WrongAnswerError:
                self._opened(self._line).send(b"\0")
                continue
            self._missed = 0
            return
        raise WrongAnswerError("aero: the hand does not answer")

    def _send(self, operation: int, *words: int) -> None:
        rest = [0] * (MOTORS - len(words))
        self._opened(self._line).send(struct.pack("<2B7H", operation, 0, *words, *rest))

    def _asked(self, operation: int, *words: int, seconds: float | None = None) -> np.ndarray:
        """The seven words of the answer to a question."""
        self._heard(self._opened(self._line).take())  # late, or text
        self._send(operation, *words)
        seconds = _TIMEOUT if seconds is None else seconds
        deadline, got = time.perf_counter() + seconds, b""
        while time.perf_counter() < deadline:
            got += self._opened(self._line).waiting()
            begin = got.find(bytes([operation, 0]))  # text has no 0
            if 0 <= begin <= len(got) - _FRAME:
                self._heard(got[:begin])
                return np.array(struct.unpack_from("<7H", got, begin + 2))
        self._heard(got)
        raise WrongAnswerError(
            f"aero: no valid answer to operation 0x{operation:02X} within {seconds:g} s"
        )

    def _heard(self, data: bytes) -> None:
        """Notice that the hand was switched on again; its limits are lost."""
        if self._limited and any(part in data for part in _POWER_ON):
            raise DeviceLostError("aero: the hand restarted")
