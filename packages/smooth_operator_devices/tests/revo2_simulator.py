"""A simulated BrainCo Revo2 that speaks Modbus RTU, for the maker's own package on a serial line.

Registers as the package 2.0.8 uses them on the line: holding 901 (which hand), 937 (unit of
positions), 1022 to 1033 (position and speed of each finger in turns); input 2000 to 2023
(positions, speeds, currents, states), 3000 to 3029 (version and serial number, as text).
"""

import struct

import numpy as np
from simulators.common import Faults, Motors
from simulators.modbus_rtu import RtuDevice


class Revo2Hand(RtuDevice):
    """The hand behind the bus: six motors, 0 open to 1000 closed."""

    def __init__(self, left: bool = False) -> None:
        self.motors = Motors([0.0] * 6, 8000.0)
        self.left, self.node = left, 0x7E if left else 0x7F
        self.serial_number = f"BCXT{'L' if left else 'R'}0000000042"
        self.unit_mode: int | None = None
        self.faults = Faults(*self.WRONG)

    def answer(self, function: int, body: bytes) -> bytes:
        """Function code and data that answer a request."""
        address, count = struct.unpack(">HH", body[:4])
        if function == 6:
            self.unit_mode = count if address == 937 else self.unit_mode
            return bytes([function]) + body[:4]
        if function == 16:
            if (address, count) == (1022, 12):
                self.motors.move(struct.unpack(">12h", body[5:])[::2])
            return bytes([function]) + body[:4]
        words = [*self._registers(function, address, count), *[0] * count][:count]
        return bytes([function, 2 * count]) + struct.pack(f">{count}H", *words)

    def _registers(self, function: int, address: int, count: int) -> list[int]:
        """Words from an address; none where nothing is known."""
        if function == 3:
            return {901: [2 if self.left else 1], 937: [self.unit_mode or 0]}.get(address, [])
        if address == 2000:
            away = self.motors.targets - self.motors.positions
            states = [
                (2 if k in self.motors.stuck else 1) * (abs(x) > 5) for k, x in enumerate(away)
            ]
            positions, currents = self.motors.positions, self.motors.currents
            rows = (positions, np.zeros(6), currents, states)
            return [int(value) for row in rows for value in np.rint(row)]
        if 3000 <= address < 3030:
            text = self.serial_number if address == 3010 else "1.0.20.U"
            data = text.encode().ljust(2 * count, b"\0")[: 2 * count]
            return list(struct.unpack(f">{count}H", data))
        return []
