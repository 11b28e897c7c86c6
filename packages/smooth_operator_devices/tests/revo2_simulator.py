"""A simulated BrainCo Revo2 that speaks Modbus RTU, for the maker's own package on a pty.

Registers as the package 2.0.8 uses them on the line: holding 901 (which hand), 937 (unit of
positions), 1022 to 1033 (position and speed of each finger in turns); input 2000 to 2023
(positions, speeds, currents, states), 3000 to 3029 (version and serial number, as text).
"""

import struct
import time

import numpy as np
from hand_servos import Faults, Servos


class Revo2Hand:
    """The hand behind the bus: six motors, 0 open to 1000 closed."""

    def __init__(self, left: bool = False) -> None:
        self.servos = Servos([0.0] * 6, speed=8000.0, lower=0.0, upper=1000.0)
        self.left, self.unit = left, 0x7E if left else 0x7F
        self.serial_number = f"BCXT{'L' if left else 'R'}0000000042"
        self.unit_mode: int | None = None
        self.faults = Faults()
        self.unknown: set[tuple[int, int]] = set()
        """Function and address of requests that the simulator knows nothing of."""

    def answer(self, pdu: bytes) -> bytes | None:
        """The answer to a request, both without frame; None for no answer."""
        if self.faults.delay_s:
            time.sleep(self.faults.delay_s)
        if self.faults.mute:
            return None
        code, address, count = struct.unpack(">BHH", pdu[:5])
        if self.faults.refuse:
            return bytes([code | 0x80, 4])
        if code == 6:
            if address == 937:
                self.unit_mode = count
            else:
                self.unknown.add((code, address))
            return pdu
        if code == 16:
            words = struct.unpack(f">{count}h", pdu[6 : 6 + 2 * count])
            if address == 1022 and count == 12:
                self.servos.aim(words[::2])
            else:
                self.unknown.add((code, address))
            return pdu[:5]
        words = self.registers(code, address, count)
        return bytes([code, 2 * count]) + struct.pack(f">{count}H", *(w & 0xFFFF for w in words))

    def registers(self, code: int, address: int, count: int) -> list[int]:
        """Words from an address; zeros where nothing is known."""
        if code == 3 and address == 901:
            return [2 if self.left else 1][:count]
        if code == 3 and address == 937:
            return [self.unit_mode or 0][:count]
        if code == 4 and address == 2000:
            load = self.servos.load()
            stall = [
                2 if k in self.servos.stuck and abs(x) > 5 else int(abs(x) > 5)
                for k, x in enumerate(load)
            ]
            where = np.rint(self.servos.positions()).astype(int).tolist()
            amperes = np.rint(np.clip(2 * load, -1000, 1000)).astype(int).tolist()
            return [*where, *[0] * 6, *amperes, *stall][:count]
        if code == 4 and 3000 <= address < 3030:
            text = self.serial_number if address == 3010 else "1.0.20.U"
            data = text.encode().ljust(2 * count, b"\0")[: 2 * count]
            return list(struct.unpack(f">{count}H", data))
        self.unknown.add((code, address))
        return [0] * count
