"""A simulated PSYONIC Ability Hand on a pty: frames between tildes, int16 positions, a checksum.

Written from the maker's interface document; it shares no code with the driver, nor with the maker's
package. The hand leaves the mode in which it takes commands when none has come for 300 ms.
"""

import struct
import time

import numpy as np
from hand_servos import Faults, Servos
from serial_port import SerialPort

DEGREE = 32767 / 150
"""Units of the wire per degree."""
AMPERE = 620.606079
SILENCE = 0.3
"""After so long without a frame the hand stops taking commands [s]."""


class AbilityHand:
    """The hand on the line: index, middle, ring, little finger, thumb flexor, thumb rotator."""

    def __init__(self, address: int = 0x50) -> None:
        lower, upper = [0.0] * 5 + [-100.0], [100.0] * 5 + [0.0]
        self.servos = Servos(
            [15.0] * 5 + [-15.0], speed=1200.0, lower=lower, upper=upper, slack=0.01
        )
        self.address = address
        self.faults = Faults()
        self.hot = 0
        self.touch = list(range(0, 3000, 100))
        self.frames, self.bad_frames = 0, 0
        self.gaps: list[float] = []
        """Silences between two frames that were longer than the hand bears."""
        self._last: float | None = None
        self._inside = bytearray()
        self._escaped = False
        self._port = SerialPort(self._serve)
        self.port = self._port.path

    def _serve(self, arrived: bytes) -> None:
        for byte in arrived:
            if byte == 0x7E:
                if self._inside:
                    self._take(bytes(self._inside))
                self._inside.clear()
                self._escaped = False
            elif byte == 0x7D:
                self._escaped = True
            else:
                self._inside.append(byte ^ 0x20 if self._escaped else byte)
                self._escaped = False

    def _take(self, frame: bytes) -> None:
        if len(frame) < 3 or sum(frame) & 0xFF or frame[0] != self.address:
            self.bad_frames += 1
            return
        self.frames += 1
        now = time.perf_counter()
        if self._last is not None and now - self._last > SILENCE:
            self.gaps.append(now - self._last)
        self._last = now
        command = frame[1]
        if self.faults.delay_s:
            time.sleep(self.faults.delay_s)
        if self.faults.mute:
            return
        if command in (0x10, 0x11, 0x12) and len(frame) == 15:
            self.servos.aim([v / DEGREE for v in struct.unpack("<6h", frame[2:14])])
            self.servos.powered = True
        elif command in (0x30, 0x31, 0x32) and len(frame) == 15:
            self.servos.positions()
            self.servos.powered = any(struct.unpack("<6h", frame[2:14]))
        elif command not in (0xA0, 0xA1, 0xA2):
            return
        self._reply(command & 0xF)

    def _reply(self, variant: int) -> None:
        where = np.rint(self.servos.positions() * DEGREE).astype(int)
        amperes = np.clip(self.servos.load() / 40, -1.5, 1.5)
        second = np.rint(amperes * AMPERE).astype(int)
        pairs = [value for both in zip(where, second, strict=True) for value in both]
        body = bytes([variant]) + struct.pack("<12h", *pairs)
        if variant == 2:
            body += struct.pack("<6h", *([0] * 6))
        else:
            for one, two in zip(self.touch[::2], self.touch[1::2], strict=True):
                body += (one | two << 12).to_bytes(3, "little")
        body += bytes([self.hot])
        check = -sum(body) & 0xFF
        if self.faults.garble:
            check ^= 0x55
        out = bytearray(b"~")
        for byte in body + bytes([check]):
            out += bytes([0x7D, byte ^ 0x20]) if byte in (0x7D, 0x7E) else bytes([byte])
        self._port.write(bytes(out) + b"~")

    def close(self) -> None:
        """Pull the adapter; the port is gone."""
        self._port.close()
