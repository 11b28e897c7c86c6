"""A bank of Feetech bus servos, SCS0009 or STS3215, on one half-duplex serial line.

Sources, by the maker (Feetech):

- `ftservo-python-sdk` 2.0.1 (package index), `scservo_sdk/{scservo_def,scscl,sms_sts,
  protocol_packet_handler,group_sync_read,group_sync_write}.py`: packets, instructions, byte order,
  addresses, sign bits, bits of the error byte, limits of identifiers and lengths.
- "Communication Protocol User Manual" 191218-0923, as quoted byte for byte in public copies:
  examples of the instructions that are here (`test_simulators.py` has them).
- Memory table of the STS series (Feetech, public copy): initial values, status bits, torque switch
  (0 off, 1 on), torque limit 48 filled from 16 at power on, units, moving flag.
- github.com/ftservo/ftservo-wiki, commit a1c18bd4, `docs/en/reference/memory-scscl.md`: SCSCL,
  high byte first, lock 48.
- Data sheet ST-3215-C018 (2023-07-20), paragraphs 7 to 11, as quoted in a public repository:
  stalled above 80 % for 2 s is an overload; a new position command clears it.
- github.com/huggingface/lerobot, commit 7427f318, `motors/feetech/tables.py` (not the maker):
  model numbers 1284 and 777, addresses of the protections of the SCS series, and that the SCS0009
  does not answer a sync read.

Facts: a packet is FF FF, identifier, length, instruction or error byte, parameters, and the
complement of the sum. SCS words are sent high byte first, STS words low byte first. SCS0009: 0 to
1023 over 300°. STS3215: 0 to 4095 over 360°. Position and speed have their sign in bit 15, load in
bit 10, offset in bit 11. Load is the duty cycle in 0.1 %, voltage 0.1 V.
Broadcast (254) is never answered, except a sync read.

Not found: how an SCS0009 recovers from an overload (here as the STS3215: by a new goal), the values
of its status byte 65 (here as the STS3215), its initial values (here 20 %, 200 and 80 %, from a
user's reading of another SCS servo). Speed is one unit per step and second for both, which the
manual says for the STS only; here a goal speed of 0 is the largest speed. Registered writes and the
STS' current are not here: the driver does not use them.
"""

from __future__ import annotations

from dataclasses import dataclass

from .common import Faults, Motors

PING, READ, WRITE, SYNC_READ, SYNC_WRITE = 1, 2, 3, 0x82, 0x83
BROADCAST = 0xFE


@dataclass(frozen=True)
class Model:
    """What differs between the two series."""

    number: int
    steps: int
    little_endian: bool
    sync_read: bool
    lock: int
    protections: tuple[int, int, int]  # addresses: protective torque, time, overload torque
    time_unit: float  # seconds a unit of the protection time


MODELS = {
    "scs0009": Model(1284, 1024, False, False, 48, (37, 38, 39), 0.04),
    "sts3215": Model(777, 4096, True, True, 55, (34, 35, 36), 0.01),
}


def packet(identifier: int, kind: int, parameters: bytes = b"") -> bytes:
    """An instruction packet, or a status packet with an error byte for its kind."""
    body = bytes([identifier, len(parameters) + 2, kind]) + parameters
    return b"\xff\xff" + body + bytes([~sum(body) & 0xFF])


class Servo:
    """One servo: its memory table, and a motor."""

    def __init__(self, model: Model, identifier: int, motors: Motors, number: int) -> None:
        self.model = model
        self.motors = motors
        self.number = number
        self.error = 0  # error byte of every answer: voltage 1, angle 2, heat 4, current 8, load 32
        self.memory = bytearray(128)
        self.set_word(3, model.number)
        self.memory[5] = identifier
        self.memory[8] = 1
        self.set_word(11, model.steps - 1)
        self.memory[13] = 70
        self.set_word(16, 1000)
        for address, value in zip(model.protections, (20, 200, 80), strict=True):
            self.memory[address] = value
        self.saved = bytes(self.memory[:40])
        self.stalled_since: float | None = None
        self.power_on()

    def power_on(self) -> None:
        """Fill the memory as at power on: no torque, EPROM as it was saved, SRAM at defaults."""
        self.memory[:40] = self.saved
        self.memory[40:] = bytes(len(self.memory) - 40)
        self.memory[self.model.lock] = 1
        if self.model.lock == 55:
            self.set_word(48, self.word(16))
        self.error = 0
        self.stalled_since = None
        self.motors.set_power(False, [self.number])

    def word(self, address: int) -> int:
        order = "little" if self.model.little_endian else "big"
        return int.from_bytes(self.memory[address : address + 2], order)

    def set_word(self, address: int, value: int) -> None:
        order = "little" if self.model.little_endian else "big"
        self.memory[address : address + 2] = value.to_bytes(2, order)

    def read(self, address: int, count: int) -> bytes:
        self.refresh()
        return bytes(self.memory[address : address + count])

    def write(self, address: int, data: bytes) -> None:
        self.memory[address : address + len(data)] = data
        ends = address + len(data)
        if self.memory[self.model.lock] == 0:
            self.saved = bytes(self.memory[:40])
        if address <= 40 < ends:
            self.motors.set_power(self.memory[40] == 1, [self.number])
            self.motors.move([self.motors.positions[self.number]], [self.number])
        if address <= 46 < ends and address + len(data) > 47:
            speed = self.word(46) & 0x7FFF
            self.motors.set_speed(self.number, speed or 4 * self.model.steps)
        if address <= 42 < ends:
            self._go(self.word(42))

    def _go(self, goal: int) -> None:
        if goal & 0x8000:
            goal = -(goal & 0x7FFF)
        low, high = self.word(9), self.word(11)
        if high > low:
            goal = min(max(goal, low), high)
        self.motors.move([goal], [self.number])
        if self.error & 32:  # a new position command ends the overload
            self.error &= ~32
            self.stalled_since = None

    def refresh(self) -> None:
        """Bring what is measured into the memory."""
        motors, i = self.motors, self.number
        position = round(motors.positions[i])
        speed = round(motors.velocities[i])
        moving = bool(speed)
        stuck = i in motors.stuck and motors.powered[i] and motors.targets[i] != position
        now = motors._clock()
        duty = 1000 if stuck else 100 if moving else 0
        protective, delay, overload = (self.memory[a] for a in self.model.protections)
        if stuck and duty >= 10 * overload:
            self.stalled_since = now if self.stalled_since is None else self.stalled_since
            if now - self.stalled_since >= delay * self.model.time_unit:
                self.error |= 32
        elif not stuck:
            self.stalled_since = None
        if self.error & 32:
            duty = 10 * protective
        self.error = self.error & ~4 | (4 if motors.temperatures[i] > self.memory[13] else 0)
        negative = motors.targets[i] < position
        self.set_word(56, abs(position) | (0x8000 if position < 0 else 0))
        self.set_word(58, abs(speed) | (0x8000 if speed < 0 else 0))
        self.set_word(60, duty | (0x400 if negative else 0))
        self.memory[62] = self.memory[62] or 74
        self.memory[63] = round(motors.temperatures[i])
        self.memory[65] = self.error
        self.memory[66] = int(moving)


class FeetechBus:
    """A simulated line of Feetech servos; bytes in, bytes out; identifier -> model."""

    def __init__(self, servos: dict[int, str]) -> None:
        models = [MODELS[name] for name in servos.values()]
        self.faults = Faults("checksum", "identifier", "short")
        self.absent: set[int] = set()
        middle = [model.steps // 2 - (1 if model.steps == 1024 else 0) for model in models]
        self.motors = Motors(middle, 1.0)
        for i, model in enumerate(models):
            self.motors.set_speed(i, 4 * model.steps)
        self.servos = {
            identifier: Servo(model, identifier, self.motors, i)
            for i, (identifier, model) in enumerate(zip(servos, models, strict=True))
        }
        self.received: list[bytes] = []
        self._buffer = b""

    def reboot(self) -> None:
        """Switch all servos off and on: torque off, torque limits at their defaults."""
        for servo in self.servos.values():
            servo.power_on()

    def receive(self, data: bytes) -> bytes:
        """Answer the packets in the bytes; an incomplete packet waits for its rest."""
        self._buffer += data
        answers = b""
        while (start := self._buffer.find(b"\xff\xff")) >= 0:
            self._buffer = self._buffer[start:]
            while self._buffer[2:3] == b"\xff":  # a longer run of FF
                self._buffer = self._buffer[1:]
            if len(self._buffer) < 4 or len(self._buffer) < self._buffer[3] + 4:
                break
            length = self._buffer[3] + 4
            body = self._buffer[:length]
            if length < 6 or ~sum(body[2:-1]) & 0xFF != body[-1]:
                self._buffer = self._buffer[1:]
                continue
            self._buffer = self._buffer[length:]
            if not self.faults.silent:
                self.received.append(body)
                answers += self._instruction(body[2], body[4], body[5:-1])
        return answers

    def _instruction(self, identifier: int, kind: int, parameters: bytes) -> bytes:
        if kind == SYNC_WRITE:
            address, count = parameters[:2]
            for start in range(2, len(parameters), count + 1):
                servo = self.servos.get(parameters[start])
                if servo is not None and parameters[start] not in self.absent:
                    servo.write(address, parameters[start + 1 : start + 1 + count])
            return b""
        if kind == SYNC_READ:
            address, count = parameters[:2]
            return b"".join(
                self._status(i, self.servos[i].read(address, count))
                for i in parameters[2:]
                if i in self.servos and i not in self.absent and self.servos[i].model.sync_read
            )
        if identifier == BROADCAST:
            for i in self.servos:
                if i not in self.absent:
                    self._single(i, kind, parameters)
            return b""
        if identifier not in self.servos or identifier in self.absent:
            return b""
        answer = self._single(identifier, kind, parameters)
        return b"" if answer is None else self._status(identifier, answer)

    def _single(self, identifier: int, kind: int, parameters: bytes) -> bytes | None:
        servo = self.servos[identifier]
        if kind == PING:
            return b""
        if kind == READ and len(parameters) == 2:
            return servo.read(*parameters)
        if kind == WRITE and len(parameters) > 1:
            servo.write(parameters[0], parameters[1:])
            return b"" if servo.memory[8] else None
        return None

    def _status(self, identifier: int, data: bytes) -> bytes:
        servo = self.servos[identifier]
        servo.refresh()
        wrong = self.faults.next_wrong()
        if wrong == "identifier":
            identifier = (identifier + 1) % 253
        answer = packet(identifier, servo.error, data)
        if wrong == "checksum":
            answer = answer[:-1] + bytes([answer[-1] ^ 0x55])
        return answer[:-2] if wrong == "short" else answer
