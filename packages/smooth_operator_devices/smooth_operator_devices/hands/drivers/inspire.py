"""Driver of the Inspire RH56 hands (DFX, FTP and DFTP): Modbus over TCP or over a serial line.

Facts of the protocol, from the maker's register map as published: holding registers, one 16-bit
word per motor at ``ANGLE_SET`` (1486), ``FORCE_SET`` (1498), ``SPEED_SET`` (1522), ``ANGLE_ACT``
(1546), ``FORCE_ACT`` (1582), ``CURRENT`` (1594); two motors to a word, the first in the low byte,
at ``ERROR`` (1606), ``STATUS`` (1612), ``TEMP`` (1618). Motors in the order little, ring, middle
and index finger, thumb bending, thumb rotation; 1000 is open, 0 is closed. TCP port 6000; serial
line 115200 baud, 8 data bits, no parity; device 1.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, require
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.bus_lock import is_serial
from smooth_operator_devices.hands.device import HandDevice, Reading, Setting, WrongAnswerError
from smooth_operator_devices.hands.drivers.inspire_touch import BLOCKS, pads
from smooth_operator_devices.hands.drivers.modbus_line import ModbusLine
from smooth_operator_devices.hands.hardware_sink import HardwareSink

MOTORS: Final = 6
PORT: Final = 6000
BAUD: Final = 115200

_CLEAR_ERROR, _CURRENT_LIMIT = 1004, 1020
_ANGLE_SET, _FORCE_SET, _SPEED_SET = 1486, 1498, 1522
_ANGLE_ACT, _FORCE_ACT, _CURRENT = 1546, 1582, 1594
_ERROR, _STATUS, _TEMP = 1606, 1612, 1618

_IN_TURNS: Final = (_CURRENT, _FORCE_ACT, _ERROR, _CURRENT, _FORCE_ACT, _STATUS, _CURRENT, _TEMP)
"""Registers that are read besides the angles, one in each cycle, since a serial line is slow."""

_ERRORS: Final = (
    "rotor locked",
    "too hot",
    "too much current",
    "motor faulty",
    "motor does not answer",
)
"""Bits of ``ERROR``, from the lowest."""

_STATUSES: Final = {5: "stopped by its current limit", 6: "rotor locked", 7: "faulty"}
"""Values of ``STATUS`` of a motor that can't move."""

_MARGIN: Final = 100
"""Margin of a measured angle around 0 to 1000."""

_NO_VALUE: Final = -1
"""A word of 0xFFFF: no angle. Among angles to set it means to leave the motor."""


@dataclass(frozen=True)
class InspireSink(HardwareSink):
    """Moves an Inspire RH56 hand; see ``HardwareSink``.

    Attributes:
        port: ``ADDRESS`` or ``ADDRESS:PORT`` for Modbus TCP; a serial port, such as
            ``/dev/ttyUSB0``, for Modbus RTU.
    """

    driver: ClassVar[str] = "inspire"

    port: str = "192.168.11.210"

    @property
    def bus(self) -> str:
        """The serial port, or the network address with its port."""
        host, _, number = self.port.partition(":")
        return self.port if is_serial(self.port) else f"tcp:{host}:{number or PORT}"

    def device(self, actuators: ActuatorMap) -> InspireDevice:
        """The hand, not yet open; see ``HardwareSink``."""
        require(InspireDevice.name, "inspire", "pymodbus", "serial")
        return InspireDevice(actuators, self.port)


class InspireDevice(HandDevice):
    """An Inspire RH56 hand on its bus; see ``HandDevice``.

    Its screws hold the fingers without current, so ``relax`` does nothing. ``Reading.currents`` is
    in mA, ``Reading.touch`` the six forces [g] and, with touch pads, the sum of each pad, in the
    order of ``Reading.pads``.

    Args:
        table: table of the hand. Its settings may have ``device_id`` (1), ``speed`` and ``force``,
            the hand's own limits: 0 to 1000, and 0 to 3000 g; and ``touch``, 1 for a hand with
            touch pads. ``limit``: largest current [mA].
    """

    driver, name, motors = "inspire", "an Inspire hand", MOTORS

    def __init__(self, table: ActuatorMap, port: str) -> None:
        super().__init__(table)
        number = port.partition(":")[2]
        self._serial = is_serial(port)
        if not self._serial and number and not (number.isdigit() and int(number) < 65536):
            raise ConfigError(f"inspire: {port!r} is not ADDRESS, ADDRESS:PORT or a serial port")
        device_id = self._setting("device_id", 1, 1, 254)
        self._speed = self._setting("speed", 1000, 0, 1000)
        self._force = self._setting("force", 500, 0, 3000)
        self._blocks = BLOCKS if self._setting("touch", 0, 0, 1) else ()
        self._line = ModbusLine("inspire", port, device_id, BAUD, PORT)
        self._turn = 0
        self._slow: dict[int, np.ndarray] = {}
        self._cells: dict[int, list[int]] = {}

    def open(self) -> None:
        """Connect, check that the hand answers, and set its limits; see ``HandDevice``."""
        self._turn, self._slow, self._cells = 0, {}, {}
        self._limited = False
        way = (
            f"the adapter's port and the {BAUD} baud of the hand"
            if self._serial
            else "power, cable, and that this computer is in the hand's network"
        )
        with self._opening(f"check {way}, and that no other program uses the hand"):
            self._line.open()
            self._angles()
            if _bytes(self._line.ask(_ERROR, 3)).any():
                self._line.tell(_CLEAR_ERROR, [1])
            self._limit()

    def _limit(self) -> None:
        """Send speed, force and current, which a restart of the hand deletes."""
        self._line.tell(_SPEED_SET, [self._speed] * MOTORS)
        self._line.tell(_FORCE_SET, [self._force] * MOTORS)
        limits = self._table.limits
        if not np.isfinite(limits).any():
            return
        words = np.clip(np.nan_to_num(limits, nan=1500.0), 0, 1500).astype(int)
        with contextlib.suppress(WrongAnswerError):  # not every model has this register
            self._line.tell(_CURRENT_LIMIT, words.tolist())

    def read(self) -> Reading:
        """Angles; in turns currents, forces, errors, temperatures, touch; see ``HandDevice``."""
        angles = self._angles()
        address = _IN_TURNS[self._turn % len(_IN_TURNS)]
        words = self._line.ask(address, 3 if address in (_ERROR, _STATUS, _TEMP) else MOTORS)
        self._slow[address] = _bytes(words) if len(words) == 3 else _signed(words)
        if self._blocks:
            block = self._blocks[self._turn % len(self._blocks)]
            self._cells[block[0]] = self._line.ask(*block)
        self._turn += 1
        currents, temperatures = self._slow.get(_CURRENT), self._slow.get(_TEMP)
        cells = pads(self._cells)
        return Reading(
            positions=angles,
            currents=None if currents is None else currents.astype(float),
            temperatures=None if temperatures is None else temperatures.astype(float),
            errors=self._errors(),
            touch=self._touch(cells),
            pads=cells,
        )

    def _touch(self, cells: Mapping[str, np.ndarray]) -> Float[np.ndarray, " k"] | None:
        """Forces and sums of pads; None until all were read, since their number can't change."""
        forces = self._slow.get(_FORCE_ACT)
        if forces is None or (self._blocks and not cells):
            return None
        return np.array([*forces, *(pad.sum() for pad in cells.values())], float)

    def _errors(self) -> tuple[str, ...]:
        texts = []
        flags = self._slow.get(_ERROR, np.zeros(MOTORS, int))
        statuses = self._slow.get(_STATUS, np.zeros(MOTORS, int))
        for name, flag, status in zip(self._table.names, flags, statuses, strict=True):
            words = [text for bit, text in enumerate(_ERRORS) if int(flag) >> bit & 1]
            if not words and int(status) in _STATUSES:
                words = [_STATUSES[int(status)]]
            texts += [f"{name}: {text}" for text in words]
        return tuple(texts)

    def settings(self) -> Sequence[Setting]:
        """Force and speed; see ``HandDevice``."""
        pairs = (("force", _FORCE_SET, self._force), ("speed", _SPEED_SET, self._speed))
        return [
            Setting(name, np.full(MOTORS, value), _signed(self._line.ask(address, MOTORS)))
            for name, address, value in pairs
        ]

    def write(self, commands: Float[np.ndarray, " 6"]) -> None:
        """Send the angles, 0 (closed) to 1000 (open), the first time after the limits; see
        ``HandDevice``."""
        if not self._limited:
            self._limit()
            self._limited = True
        self._line.tell(_ANGLE_SET, np.clip(np.rint(commands), 0, 1000).astype(int).tolist())

    def close(self) -> None:
        """Give the line back; the hand keeps its last target. See ``HandDevice``."""
        self._line.close()

    def _angles(self) -> Float[np.ndarray, " 6"]:
        angles = _signed(self._line.ask(_ANGLE_ACT, MOTORS)).astype(float)
        if ((angles < -_MARGIN) | (angles > 1000 + _MARGIN) | (angles == _NO_VALUE)).any():
            raise WrongAnswerError(
                f"inspire: the hand reports motor positions {angles.astype(int).tolist()}; "
                f"expected 0 to 1000, and {_NO_VALUE} is not a position"
            )
        return angles


def _signed(words: list[int]) -> np.ndarray:
    return np.array(words, np.uint16).astype(np.int16).astype(int)


def _bytes(words: list[int]) -> np.ndarray:
    """Six bytes from three words, the low byte first."""
    pairs = np.array(words, int)
    return np.stack([pairs & 0xFF, pairs >> 8 & 0xFF], axis=1).ravel()
