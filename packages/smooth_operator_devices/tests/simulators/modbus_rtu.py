"""Modbus RTU around a simulated device: number of the device, function, data, and a check.

Source: the Modbus specification, "MODBUS over Serial Line" V1.02.
"""

from collections.abc import Callable

from .common import Faults


def crc(data: bytes) -> bytes:
    """The check of Modbus RTU, low byte first."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value.to_bytes(2, "little")


class RtuDevice:
    """Base of the devices on a line; bytes in, bytes out.

    A subclass has its number ``node``, ``answer(function, data)``, and faults of the kinds
    ``WRONG``.
    """

    WRONG = ("checksum", "identifier", "short")
    node: int
    answer: Callable[[int, bytes], bytes]
    faults: Faults
    buffer = b""

    def receive(self, data: bytes) -> bytes:
        """Answer the requests in the bytes; an incomplete request waits for its rest."""
        self.buffer += data
        answers = b""
        while len(self.buffer) >= 8:
            length = 9 + self.buffer[6] if self.buffer[1] == 16 else 8
            if len(self.buffer) < length:
                break
            request = self.buffer[:length]
            if crc(request[:-2]) != request[-2:]:
                self.buffer = b""  # the pause that ends a frame is not seen here
                break
            self.buffer = self.buffer[length:]
            if request[0] == self.node and not self.faults.silent:
                answers += self._framed(self.answer(request[1], request[2:-2]))
        return answers

    def _framed(self, answer: bytes) -> bytes:
        wrong = self.faults.next_wrong()
        framed = bytes([self.node + 1 if wrong == "identifier" else self.node]) + answer
        framed += crc(framed)
        if wrong == "checksum":
            framed = framed[:-1] + bytes([framed[-1] ^ 0x55])
        return framed[:-2] if wrong == "short" else framed
