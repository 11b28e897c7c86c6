"""A simulated PSYONIC Ability Hand on a serial line: frames between tildes, positions, a checksum.

Written from the maker's interface document; it shares no code with the driver, nor with the maker's
package. The hand leaves the mode in which it takes commands when none has come for 300 ms.
"""

import struct
import time

import numpy as np
from simulators.common import Faults, Motors

DEGREE = 32767 / 150
"""Units of the wire per degree."""
MILLIAMPERE = 0.620606079
SILENCE = 0.3
"""After so long without a frame the hand stops taking commands [s]."""


class AbilityHand:
    """The hand on the line, bytes in, bytes out: index, middle, ring, little finger, thumb flexor,
    thumb rotator."""

    def __init__(self, address: int = 0x50) -> None:
        self.motors = Motors([15.0] * 5 + [-15.0], 1200.0, stall_current=1100.0)
        self.address = address
        self.faults = Faults("checksum")
        self.hot = 0
        self.touch = list(range(0, 3000, 100))
        self.bad_frames = 0
        self.gaps: list[float] = []
        """Silences between two frames that were longer than the hand bears."""
        self._last = time.perf_counter()
        self._inside = bytearray()
        self._escaped = False

    def receive(self, data: bytes) -> bytes:
        """Answer the frames in the bytes; an incomplete frame waits for its rest."""
        answers = b""
        for byte in data:
            if byte == 0x7E:
                if self._inside:
                    answers += self._take(bytes(self._inside))
                self._inside.clear()
                self._escaped = False
            elif byte == 0x7D:
                self._escaped = True
            else:
                self._inside.append(byte ^ 0x20 if self._escaped else byte)
                self._escaped = False
        return answers

    def _take(self, frame: bytes) -> bytes:
        if len(frame) < 3 or sum(frame) & 0xFF or frame[0] != self.address:
            self.bad_frames += 1
            return b""
        now = time.perf_counter()
        if now - self._last > SILENCE:
            self.gaps.append(now - self._last)
        self._last = now
        command = frame[1]
        if self.faults.silent:
            return b""
        if command == 0x10 and len(frame) == 15:
            self.motors.move([value / DEGREE for value in struct.unpack("<6h", frame[2:14])])
            self.motors.set_power(True)
        elif command == 0x30 and len(frame) == 15:
            self.motors.set_power(any(struct.unpack("<6h", frame[2:14])))
        elif command != 0xA0:
            return b""
        return self._reply()

    def _reply(self) -> bytes:
        where = np.rint(self.motors.positions * DEGREE).astype(int)
        currents = np.rint(self.motors.currents * MILLIAMPERE).astype(int)
        pairs = [value for both in zip(where, currents, strict=True) for value in both]
        body = b"\0" + struct.pack("<12h", *pairs)
        for one, two in zip(self.touch[::2], self.touch[1::2], strict=True):
            body += (one | two << 12).to_bytes(3, "little")
        body += bytes([self.hot])
        check = -sum(body) & 0xFF
        if self.faults.next_wrong():
            check ^= 0x55
        out = bytearray(b"~")
        for byte in body + bytes([check]):
            out += bytes([0x7D, byte ^ 0x20]) if byte in (0x7D, 0x7E) else bytes([byte])
        return bytes(out) + b"~"
