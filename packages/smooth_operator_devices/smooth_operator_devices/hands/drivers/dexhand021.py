"""Driver of DexRobot's DexHand021 on CAN FD.

Facts of the protocol, by the maker: DexRobot/pyzlg_dexhand, commit 316575ac
(``dexhand_protocol``), and DexRobot/dexhand_sdk_cpp, commit 3827b1f1 (``commondef.h``). 1 Mbit/s,
data at 5 Mbit/s. An identifier is a kind and a board: 0x100 commands, 0x00 configuration, 0x180
feedback, 0x600 errors; boards 1 to 6 of a left hand, 7 to 12 of a right one, two motors each. A
command is mode, enabled motors and two 16-bit values, low byte first, in mode 0x44 hundredths of a
degree. Feedback has per motor current [mA], speed and Hall counts, then two angles in hundredths of
a degree, and from byte 16 the fingertip: normal and tangential force [N], direction, proximity and
temperature. A motor in the error state ignores commands until 03 A4.
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
from smooth_operator_devices.hands.device import HandDevice, Reading, WrongAnswerError
from smooth_operator_devices.hands.drivers.can_bus import CanBus, CanSink

MOTORS: Final = 12
BOARDS: Final = 6

_FIRST: Final = {"left": 0x01, "right": 0x07}
"""Number of the first board."""
_COMMAND, _CONFIGURE, _FEEDBACK, _ERROR = 0x100, 0x000, 0x180, 0x600
_FREE, _POSITION, _BOTH = 0x00, 0x44, 0x03
_PERIODIC: Final = bytes([0x03, 0x74, 0x01, 0x01, 0x01])
"""Feedback every 10 ms; a restart deletes that."""
_CLEAR: Final = bytes([0x03, 0xA4])
_LEAST, _WITH_TOUCH = 16, 42
_ERRORS: Final = ("too much current", "Hall sensor", "stalled", "invalid parameter")
"""Bits of an error, from the lowest."""
_BACK: Final = 5.0
"""Distance of a command from its motor at which a motor that stalled is switched on again
[deg]."""
_STOPPED: Final = 0b0101
"""Errors that end so: too much current, stalled."""

_TIMEOUT: Final = 0.1
"""Time that feedback of all boards may take [s]."""


@dataclass(frozen=True)
class DexHand021Sink(CanSink):
    """Moves a DexHand021; see ``CanSink``."""

    driver: ClassVar[str] = "dexhand021"

    def device(self, actuators: ActuatorMap) -> DexHand021Device:
        """The hand, not yet open; see ``HardwareSink``."""
        require(DexHand021Device.name, "dexhand021", "can")
        return DexHand021Device(actuators, self.port)


class DexHand021Device(HandDevice):
    """A DexHand021 on its bus; see ``HandDevice``.

    The driver sets no limits in the hand; ``limit`` [mA] is that of the contact guard.
    ``Reading.temperatures`` are those of the fingertips, for both motors of a board, NaN for the
    board without one; ``Reading.touch`` their normal and tangential forces [N].

    Args:
        table: table of the hand, in degrees.
    """

    driver, name, motors = "dexhand021", "a DexHand021", MOTORS

    def __init__(self, table: ActuatorMap, port: str) -> None:
        super().__init__(table)
        self._check_settings(())
        self._port, self._first = port, _FIRST[table.side]
        self._bus: CanBus | None = None
        self._frames: dict[int, bytes] = {}
        self._bits = [0] * MOTORS
        self._angles: Float[np.ndarray, " 12"] = np.full(MOTORS, np.nan)

    def open(self) -> None:
        """Open the bus, ask for feedback, check that every board reports; see ``HandDevice``."""
        self._bus = CanBus(self._port, "dexhand021", fd=True)
        self._limited, self._bits = False, [0] * MOTORS
        other = "left" if self._table.side == "right" else "right"
        with self._opening(
            f"check power and cable, that the adapter speaks CAN FD, and that it is not a {other} "
            "hand, which has other boards"
        ):
            for board in range(BOARDS):
                self._send(_CONFIGURE, board, _PERIODIC)
            self.read()

    def read(self) -> Reading:
        """Feedback of all boards that is newer than this call; see ``HandDevice``."""
        self._collect(time.perf_counter())
        self._frames.clear()
        self._collect(time.perf_counter() + _TIMEOUT)
        missing = [board for board in range(BOARDS) if board not in self._frames]
        if missing:
            raise WrongAnswerError(
                f"dexhand021: no feedback from board {self._first + missing[0]} within "
                f"{_TIMEOUT:g} s"
            )
        frames = [self._frames[board] for board in range(BOARDS)]
        if short := [len(frame) for frame in frames if len(frame) < _LEAST]:
            raise WrongAnswerError(
                f"dexhand021: feedback of {short[0]} bytes received, instead of {_LEAST} or more"
            )
        words = np.array([struct.unpack_from("<8h", frame) for frame in frames], float)
        self._angles = words[:, 6:8].ravel() / 100.0
        heat, touch = np.full(MOTORS, np.nan), []
        for board, frame in enumerate(frames):
            if len(frame) >= _WITH_TOUCH:
                normal, _, tangential, _, _, _, degrees = struct.unpack_from("<fIfIHII", frame, 16)
                heat[2 * board : 2 * board + 2] = degrees
                touch += [normal, tangential]
        return Reading(
            positions=self._angles,
            currents=words[:, [0, 3]].ravel(),
            temperatures=heat,
            errors=self._reports(
                self._bits,
                lambda bits: ", ".join(t for bit, t in enumerate(_ERRORS) if bits >> bit & 1),
            ),
            touch=np.array(touch, float),
        )

    def write(self, commands: Float[np.ndarray, " 12"]) -> None:
        """Send the angles [deg]; the first time after errors are cleared. A motor that stalled is
        cleared when its command comes back to it. See ``HandDevice``."""
        values = np.asarray(commands, float)
        near = np.abs(values - self._angles) < _BACK
        for board in range(BOARDS):
            pair = (2 * board, 2 * board + 1)
            back = any(self._bits[k] & _STOPPED and near[k] for k in pair)
            if back or not self._limited:
                self._send(_CONFIGURE, board, _CLEAR)
                self._bits[pair[0]] = self._bits[pair[1]] = 0
            angles = np.clip(np.rint(100.0 * values[list(pair)]), -32768, 32767).astype(int)
            self._send(_COMMAND, board, struct.pack("<BBhh", _POSITION, _BOTH, *angles))
        self._limited = True

    def relax(self) -> None:
        """Switch all motors off; see ``HandDevice``."""
        super().relax()
        for board in range(BOARDS):
            self._send(_COMMAND, board, struct.pack("<BBhh", _FREE, _BOTH, 0, 0))

    def close(self) -> None:
        """Give the bus back; the hand keeps its last target. See ``HandDevice``."""
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def _send(self, kind: int, board: int, data: bytes) -> None:
        self._opened(self._bus).send(kind + self._first + board, data)

    def _collect(self, deadline: float) -> None:
        """Take frames of the hand until all boards have reported, or until a time."""
        for identifier, data in self._opened(self._bus).until(deadline):
            kind, board = identifier & 0xF80, (identifier & 0x7F) - self._first
            if not 0 <= board < BOARDS:
                continue
            if kind == _ERROR and len(data) >= 3 and data[0] == 0xEE:
                self._bits[2 * board : 2 * board + 2] = data[2] & 0xF, data[2] >> 4
            elif kind == _FEEDBACK:
                self._frames[board] = data
                if len(self._frames) == BOARDS:
                    return
