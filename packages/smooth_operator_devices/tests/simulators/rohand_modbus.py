"""A ROHand (OYMotion) with Modbus RTU firmware, first and second generation.

Sources, by the maker (OYMotion):

- oymotion.github.io, commit 1600e846 (2025-12-23), `en/ROHand/ROH-Protocols/
  OHandModBusRTUProtocol_Gen1` (V1.0) and `_Gen2` (V2.0): frames, errors, registers with their
  defaults and access, angles, status codes.
- github.com/oymotion/roh_gen2_demos, commit 026e86bb (2026-07-13), `common/roh_registers_v2.py`,
  and github.com/oymotion/roh_demos, commit a7fbf70f (2026-01-09), `common/roh_registers_v1.py`.
- github.com/oymotion/roh_firmware, `FAQs` (a motor over its current limit stops, and starts again
  when its target is written again).

Facts: 115200 baud 8N1, node 2; functions 3 and 16. Fingers: thumb bending, index, middle, ring,
little, thumb rotation. Target and position 0 (open) to 65535. Defaults at every power on: current
limit 1178 mA, speed 65535 a second. Error 4 (device failure) has its reason in register 1006.

**The generations differ**: the first has force limits (15000 mN) at 1115 to 1119 and forces at 1120
to 1124; the second has force targets (0: no force control) at 1115 to 1119 and forces at 1175 to
1179.

Not found: when the errors "motor stuck" and "invalid register value" come (here the hand accepts a
target of a stuck finger), the answer to a register outside the table (here error 2), whether
broadcasts (node 0) are obeyed (here they are not), and how long the hand initialises after power on
(here `init_time`). Only what the driver uses is here: no angles, and no function 6.
"""

from __future__ import annotations

import time

import numpy as np

from .common import Faults, Motors
from .modbus_rtu import RtuDevice

FINGERS = ("thumb", "index", "middle", "ring", "little", "thumb_rotation")
OPENING, CLOSING, REACHED, OVER_CURRENT, FORCE_REACHED, STUCK = range(6)
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, DEVICE_FAILURE = 1, 2, 4
NOT_INITIALISED = 1


class RoHand(RtuDevice):
    """A simulated ROHand; bytes in, bytes out; positions 0 to 65535."""

    node = 2

    def __init__(self, generation: int = 2) -> None:
        self.generation = generation
        self.init_time = 0.0
        self.faults = Faults(*self.WRONG)
        self.motors = Motors(np.zeros(6), 65535.0)
        self.forces = np.zeros(5, dtype=int)  # mN
        self._clock = time.monotonic
        self._start()
        self._ready_at = self._clock()

    def _start(self) -> None:
        self._registers = {
            1000: self.generation << 8,
            1006: 0,
            **{1095 + k: 1178 for k in range(6)},
            **{1115 + k: 15000 if self.generation == 1 else 0 for k in range(5)},
            **{1125 + k: 65535 for k in range(6)},
        }
        self._stopped = [False] * 6  # by the current limit
        for finger in range(6):
            self.motors.set_speed(finger, 65535.0)
        self.motors.place(self.motors.positions)
        self.motors.set_power(True)

    def reboot(self) -> None:
        """Switch the hand off and on: limits and speeds are at their defaults again."""
        self._start()
        self.buffer = b""
        self._ready_at = self._clock() + self.init_time

    def answer(self, function: int, body: bytes) -> bytes:
        """Function code and data that answer a request."""
        address, count = int.from_bytes(body[:2], "big"), int.from_bytes(body[2:4], "big")
        if function not in (3, 16):
            return bytes([function | 0x80, ILLEGAL_FUNCTION])
        if self._clock() < self._ready_at and address != 1006:
            self._registers[1006] = NOT_INITIALISED
            return bytes([function | 0x80, DEVICE_FAILURE])
        if function == 3:
            values = self.read(address, count)
            if values is None:
                return bytes([0x83, ILLEGAL_ADDRESS])
            return bytes([3, 2 * count]) + b"".join(v.to_bytes(2, "big") for v in values)
        for i in range(count):
            self._write(address + i, int.from_bytes(body[5 + 2 * i : 7 + 2 * i], "big"))
        return bytes([function]) + body[:4]

    def _write(self, address: int, value: int) -> None:
        finger = address % 10 - 5 if address % 10 >= 5 else address % 10 + 5
        self._registers[address] = value
        if finger >= 6:
            return
        if 1125 <= address < 1135:
            self.motors.set_speed(finger, float(value))
        if 1135 <= address < 1145:
            self._go(finger, value)

    def _go(self, finger: int, target: int) -> None:
        self._stopped[finger] = False
        self.motors.set_power(True, [finger])
        self.motors.move([target], [finger])

    def read(self, address: int, count: int) -> list[int] | None:
        """Registers as they are now, or None if one of them does not exist."""
        self._refresh()
        values = []
        for one in range(address, address + count):
            blocks = range(1000, 1284) if self.generation == 2 else range(1000, 1175)
            if one not in blocks and not (2000 <= one < 3000):
                return None
            values.append(self._registers.get(one, 0) & 0xFFFF)
        return values

    def _refresh(self) -> None:
        motors = self.motors
        positions, targets, currents = motors.positions, motors.targets, motors.currents
        for k in range(6):
            if k in motors.stuck and currents[k] > self._registers[1095 + k]:
                self._stopped[k] = True
                motors.set_power(False, [k])
            away = targets[k] - positions[k]
            if self._stopped[k]:
                status = OVER_CURRENT
            elif abs(away) < 0.5:
                status = REACHED
            elif k in motors.stuck:
                status = STUCK
            else:
                status = CLOSING if away > 0 else OPENING
            self._registers[1085 + k] = status
            self._registers[1105 + k] = round(0.0 if self._stopped[k] else currents[k])
            self._registers[1145 + k] = round(positions[k])
        first = 1120 if self.generation == 1 else 1175
        for k in range(5):
            self._registers[first + k] = int(self.forces[k])
