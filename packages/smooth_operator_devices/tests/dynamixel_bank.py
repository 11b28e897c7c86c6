"""A bank of Dynamixel X servos on a serial line: protocol 2.0 on the wire.

Written from the published protocol, apart from the driver and from ROBOTIS' SDK: packets, stuffing
and checksum are computed here. The servos move with a limited speed and force.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from simulators.common import Faults, SerialLine

MODEL = 1240  # XC330-M288


def crc16(data: bytes) -> int:
    """CRC-16 with polynomial 0x8005, not reflected, from 0."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = ((value << 1) ^ 0x8005) & 0xFFFF if value & 0x8000 else (value << 1) & 0xFFFF
    return value


def packet(number: int, parameters: bytes, error: int = 0) -> bytes:
    """A status packet."""
    body = bytes([0x55, error]) + parameters
    stuffed = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = b"\xff\xff\xfd\x00" + bytes([number]) + (len(stuffed) + 2).to_bytes(2, "little")
    return head + stuffed + crc16(head + stuffed).to_bytes(2, "little")


@dataclass
class Servo:
    """One servo: its control table, and a motor that follows it."""

    number: int
    position: float = 2048.0
    stop: float = 1e9  # an object, beyond which it does not get [steps]
    speed: float = 3000.0  # steps per second
    error: int = 0
    table: bytearray = field(default_factory=lambda: bytearray(160))
    moved: float = field(default_factory=time.perf_counter)
    heard: float = field(default_factory=time.perf_counter)

    limits_at_power: list[int] = field(default_factory=list)
    """Goal current at each switching on of the torque."""

    def __post_init__(self) -> None:
        self.put(0, 2, MODEL)
        self.put(7, 1, self.number)
        self.put(11, 1, 3)  # position, as delivered
        self.put(38, 2, 1750)
        self.put(146, 1, 33)
        self.restart()

    def restart(self) -> None:
        """Leave what a restart does in the memory that is not kept without power."""
        self.put(64, 1, 0)
        for address, value in ((80, 0), (82, 0), (84, 900), (102, self.get(38, 2))):
            self.put(address, 2, value)
        self.table[98] = 0

    def get(self, address: int, size: int) -> int:
        return int.from_bytes(self.table[address : address + size], "little", signed=size > 1)

    def put(self, address: int, size: int, value: int) -> None:
        self.table[address : address + size] = int(value).to_bytes(size, "little", signed=value < 0)

    @property
    def torque(self) -> bool:
        return bool(self.get(64, 1))

    def move(self) -> None:
        """Bring the motor to now."""
        now = time.perf_counter()
        seconds, self.moved = now - self.moved, now
        watchdog = self.table[98]
        if 0 < watchdog < 128 and now - self.heard > 0.02 * watchdog:
            self.table[98] = 255
        current = 0
        if self.error:
            self.put(64, 1, 0)
        before = self.position
        if self.torque and self.table[98] != 255:
            ahead = self.get(116, 4) - self.position
            step = max(-self.speed * seconds, min(self.speed * seconds, ahead))
            self.position = min(self.position + step, self.stop)
            left = self.get(116, 4) - self.position
            limit = self.get(102, 2)
            current = int(max(-limit, min(limit, 4.0 * left)))
        self.put(126, 2, current)
        self.put(128, 4, int((self.position - before) / max(seconds, 1e-6) / 15.63))
        self.put(132, 4, round(self.position))
        self.put(70, 1, self.error)

    def write(self, address: int, data: bytes) -> int:
        """Answer of the servo to a write: 0, or an error."""
        if address == 11 and self.torque:
            return 7  # access
        if self.table[98] == 255 and address in (102, 116):
            return 4  # data range, until the watchdog is cleared
        if address == 102 and int.from_bytes(data, "little", signed=True) > self.get(38, 2):
            return 6  # data limit
        self.table[address : address + len(data)] = data
        if address == 64 and data[0]:
            self.limits_at_power.append(self.get(102, 2))
            self.put(116, 4, round(self.position))
        return 0


class ServoBank:
    """Servos on a serial line; ``path`` is the port. Faults are switched on by attributes.

    Attributes:
        line: the line, which can be unplugged.
        silent: ids that do not answer.
        faults: what goes wrong on the bus.
        fast: whether they know the fast sync read.
        goals: id -> goal of every write of goals [steps].
        aimed: called with each of them, before the servos move.
    """

    def __init__(self, numbers: list[int]) -> None:
        self.servos = {number: Servo(number) for number in numbers}
        self.silent: set[int] = set()
        self.faults, self.fast = Faults("checksum"), True
        self.goals: list[dict[int, int]] = []
        self.aimed: Callable[[dict[int, int]], object] = bool
        self.bad = 0  # instructions with a wrong checksum
        self._buffer = b""
        self.line = SerialLine(self)
        self.path = self.line.port

    def unplug(self) -> None:
        """End the line."""
        self.line.close()

    def poll(self) -> bytes:
        """Move the servos; they send nothing by themselves."""
        for servo in self.servos.values():
            servo.move()
        return b""

    def receive(self, data: bytes) -> bytes:
        """Answer the packets in the bytes; an incomplete packet waits for its rest."""
        self._buffer += data
        answers = b""
        while (start := self._buffer.find(b"\xff\xff\xfd\x00")) >= 0:
            rest = self._buffer[start:]
            if len(rest) < 7 or len(rest) < 7 + int.from_bytes(rest[5:7], "little"):
                break
            length = 7 + int.from_bytes(rest[5:7], "little")
            whole, self._buffer = rest[:length], rest[length:]
            if crc16(whole[:-2]) != int.from_bytes(whole[-2:], "little"):
                self.bad += 1
                continue
            body = whole[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            answer = self._answer(whole[4], body[0], body[1:])
            answers += b"" if self.faults.silent else answer
        self.poll()
        return answers

    def _answer(self, number: int, instruction: int, data: bytes) -> bytes:
        for servo in self.servos.values():
            servo.move()
            if number in (servo.number, 254):
                servo.heard = time.perf_counter()
        address, size = (int.from_bytes(data[k : k + 2], "little") for k in (0, 2))
        if instruction in (0x82, 0x8A):
            if instruction == 0x8A and not self.fast:
                return b""
            return self._sync_read(list(data[4:]), address, size, instruction == 0x8A)
        if instruction == 0x83:
            goals = {}
            for k in range(4, len(data), size + 1):
                value = data[k + 1 : k + 1 + size]
                if data[k] in self.servos and data[k] not in self.silent:
                    self.servos[data[k]].write(address, value)
                    goals[data[k]] = int.from_bytes(value, "little", signed=True)
            if address == 116:
                self.goals.append(goals)
                self.aimed(goals)
            return b""
        if number not in self.servos or number in self.silent:
            return b""
        servo = self.servos[number]
        alert = 0x80 if servo.error else 0
        if instruction == 1:
            model = bytes(servo.table[:2])
            return self._sent(packet(number, model + b"\x32", alert))
        if instruction == 2:
            return self._sent(packet(number, bytes(servo.table[address : address + size]), alert))
        if instruction == 3:
            return self._sent(packet(number, b"", servo.write(address, data[2:]) | alert))
        return self._sent(packet(number, b"", 2))

    def _sync_read(self, numbers: list[int], address: int, size: int, fast: bool) -> bytes:
        there = [n for n in numbers if n in self.servos and n not in self.silent]
        if not fast:
            rows = [(n, bytes(self.servos[n].table[address : address + size])) for n in there]
            alerts = [0x80 if self.servos[n].error else 0 for n in there]
            return b"".join(
                self._sent(packet(n, row, alert))
                for (n, row), alert in zip(rows, alerts, strict=True)
            )
        if there != numbers:
            return b""
        # One packet: (error, id, data, checksum so far) of each; the first error is the packet's.
        parts = b""
        for k, n in enumerate(there):
            error = bytes([0x80 if self.servos[n].error else 0])
            row = bytes([n]) + bytes(self.servos[n].table[address : address + size])
            parts += (b"" if k == 0 else error) + row + b"\0\0"
        body = bytes([0x55, 0]) + parts[:-2]
        head = b"\xff\xff\xfd\x00\xfe" + (len(body) + 2).to_bytes(2, "little")
        return self._sent(head + body + crc16(head + body).to_bytes(2, "little"))

    def _sent(self, answer: bytes) -> bytes:
        if self.faults.next_wrong():
            return answer[:-1] + bytes([answer[-1] ^ 0x5A])
        return answer
