"""Driver of OYMotion's ROHand with Modbus RTU firmware, first and second generation.

Facts of the protocol, by the maker: oymotion.github.io, commit 1600e846, the pages
``OHandModBusRTUProtocol_Gen1`` and ``_Gen2``. Serial line at 115200 baud, 8 data bits, no parity;
device 2. Holding registers, one 16-bit word per motor in the order thumb bending, index, middle,
ring, little, thumb rotation; a position goes from 0 (open) to 65535. The main version of the
protocol (1000) is the generation: registers 1115 to 1119 limit the forces of the first one, and
switch the second one to force control if they are not 0; the measured forces begin at 1120 and
1175. Current limits (1178 mA), speeds and forces are at their defaults after power on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import SinkError, require
from smooth_operator_devices.hands.actuator_map import ActuatorMap
from smooth_operator_devices.hands.bus_lock import only_port
from smooth_operator_devices.hands.device import HandDevice, Reading, Setting
from smooth_operator_devices.hands.drivers.modbus_line import ModbusLine
from smooth_operator_devices.hands.hardware_sink import HardwareSink

MOTORS: Final = 6
FORCES: Final = 5
BAUD: Final = 115200

_VERSION, _REASON = 1000, 1006
_STATUS, _CURRENT_LIMIT, _CURRENT, _FORCE_SET = 1085, 1095, 1105, 1115
_SPEED, _TARGET, _POSITION = 1125, 1135, 1145
_FORCES: Final = {1: 1120, 2: 1175}
"""Register of the first measured force, by generation."""

_DEVICE_FAILURE: Final = 4
"""Modbus exception with its reason in register ``_REASON``."""
_REASONS: Final = {
    1: "it is initialising: wait, and press its button if it waits for the self-test",
    2: "it is calibrating",
    3: "invalid value",
    4: "a motor is stuck",
    5: "the operation failed",
    6: "saving failed",
}
_STATUSES: Final = {3: "stopped by its current limit", 5: "stuck"}
"""Values of ``_STATUS`` of a motor that was stopped, and starts with its next target."""

_SPEED_DEFAULT: Final = 65000
"""Positions per second: not 65535, the value after a restart, so that a restart is noticed."""


@dataclass(frozen=True)
class RohandSink(HardwareSink):
    """Moves a ROHand; see ``HardwareSink``.

    Attributes:
        port: its serial port; empty for the only USB adapter.
    """

    driver: ClassVar[str] = "rohand"

    def device(self, actuators: ActuatorMap) -> RohandDevice:
        """The hand, not yet open; see ``HardwareSink``."""
        require(RohandDevice.name, "rohand", "pymodbus", "serial")
        return RohandDevice(actuators, self.port)


class RohandDevice(HandDevice):
    """A ROHand on its serial line; see ``HandDevice``.

    It has no command that switches its motors off, so ``relax`` does nothing. ``Reading.currents``
    is in mA, ``Reading.touch`` the forces of the five fingers [mN]; it reports no temperatures.

    Args:
        table: table of the hand; ``limit`` is the current limit of each motor [mA]. Its settings
            may have ``device_id`` (2), ``speed`` (1 to 65535 per second) and ``force``, the limit
            of the first generation's forces (1 to 15000 mN).
    """

    driver, name, motors = "rohand", "a ROHand", MOTORS

    def __init__(self, table: ActuatorMap, port: str) -> None:
        super().__init__(table)
        self._check_settings(("device_id", "speed", "force"))
        self._port = port
        self._device_id = self._setting("device_id", 2, 1, 247)
        speed = self._setting("speed", _SPEED_DEFAULT, 1, 65535)
        self._force = self._setting("force", 15000, 1, 15000)
        self._settings = {"speed": (_SPEED, [speed] * MOTORS)}
        if np.isfinite(table.limits).any():
            limits = np.clip(np.nan_to_num(table.limits, nan=1178.0), 1, 65535).astype(int)
            self._settings["current limit"] = (_CURRENT_LIMIT, limits.tolist())
        self._line = ModbusLine("rohand", port, self._device_id, BAUD)
        self._forces_at = 0
        self._turn = 0
        self._slow: dict[int, list[int]] = {}

    def open(self) -> None:
        """Connect, check that the hand answers, and set its limits; see ``HandDevice``."""
        port = self._port or only_port("rohand", "rohand")
        self._line = ModbusLine("rohand", port, self._device_id, BAUD, why=self._why)
        self._turn, self._slow, self._limited = 0, {}, False
        with self._opening(
            f"check power, the port {port}, that no other program uses it, and that the hand has "
            f"Modbus firmware and is device {self._device_id}"
        ):
            self._line.open()
            generation = self._line.ask(_VERSION, 1)[0] >> 8
            if generation not in _FORCES:
                raise SinkError(
                    f"rohand: the hand has version {generation} of the protocol, not 1 or 2"
                )
            self._forces_at = _FORCES[generation]
            force = self._force if generation == 1 else 0  # 0: no force control
            self._settings["force"] = (_FORCE_SET, [force] * FORCES)
            self.read()
            self._limit()

    def _limit(self) -> None:
        """Send speed, current limit and force, which a restart of the hand deletes."""
        for address, words in self._settings.values():
            self._line.tell(address, words)

    def read(self) -> Reading:
        """Positions, and one of currents, states and forces; see ``HandDevice``."""
        positions = self._line.ask(_POSITION, MOTORS)
        turns = (_CURRENT, _STATUS, _CURRENT, self._forces_at)
        address = turns[self._turn % len(turns)]
        self._turn += 1
        self._slow[address] = self._line.ask(
            address, FORCES if address == self._forces_at else MOTORS
        )
        currents, forces = self._slow.get(_CURRENT), self._slow.get(self._forces_at)
        states = self._slow.get(_STATUS, [])
        return Reading(
            positions=np.array(positions, float),
            currents=None if currents is None else np.array(currents, float),
            errors=self._reports(states, lambda state: _STATUSES.get(state, "")),
            touch=None if forces is None else np.array(forces, float),
        )

    def settings(self) -> Sequence[Setting]:
        """Speed, current limit and force; see ``HandDevice``."""
        return [
            Setting(
                name, np.array(words, float), np.array(self._line.ask(address, len(words)), float)
            )
            for name, (address, words) in self._settings.items()
        ]

    def write(self, commands: Float[np.ndarray, " 6"]) -> None:
        """Send the positions, 0 (open) to 65535, the first time after the limits; see
        ``HandDevice``."""
        if not self._limited:
            self._limit()
            self._limited = True
        self._line.tell(_TARGET, np.clip(np.rint(commands), 0, 65535).astype(int).tolist())

    def close(self) -> None:
        """Give the line back; the hand keeps its last target. See ``HandDevice``."""
        self._line.close()

    def _why(self, register: int, code: int) -> str:
        """The hand's reason for a refusal, or an empty text."""
        if code != _DEVICE_FAILURE or register == _REASON:
            return ""
        return _REASONS.get(self._line.ask(_REASON, 1)[0], "")
