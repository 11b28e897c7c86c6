"""An Aero Hand Open on its serial line: 16 bytes a frame, no checksum.

Sources, by the maker (TetherIA):

- github.com/TetherIA/aero-open-firmware, commit d7bd82e8 (2025-10-27), `main/firmware_v0.1.0.ino`
  and `main/Homing.cpp`: what the hand does with each frame, its answers, its defaults at power on,
  and the text it prints then.
- `aero-open-sdk` 0.1.0.dev1 (package index), `aero_open_sdk/aero_hand.py` and
  `aero_hand_constants.py`: units, ranges of the seven actuators.

Facts: 921600 baud. A frame is an operation, 0, and seven words, low byte first. Order: thumb
abduction, thumb flexion, thumb tendon, index, middle, ring, pinky. Positions are 0 to 65535 over
each actuator's range (0 = extended). Answered are 0x22 positions, 0x24 currents (6.5 mA), 0x25
temperatures (°C), 0x31 and 0x32 (actuator, value that holds). 0x31 and 0x32 of an actuator that
does not exist answer FF FF 00 00. Speed is clamped to 32766, torque to 1023. Commands 0x11 and 0x12
are not answered, unknown operations are consumed. The hand counts bytes: a frame that lost a byte
shifts all that follow.

The SDK and the firmware differ: the SDK has 0x21 (all), which the firmware does not know; the
torque limit reaches 1000 in the SDK and 1023 in the firmware. After power on the hand prints text
on the same line, and its length is no multiple of 16 bytes.

Not found: what the hand does with bytes that arrive while it homes (the firmware intends to drop
them, and so does this), how fast an actuator turns at the default speed (here its whole range in
half a second), and where torque control (0x12) goes (here to the closed end for a torque above 0).
Only what the driver uses is here: no homing by command, trim or speeds.
"""

from __future__ import annotations

import struct

import numpy as np

from .common import Faults, Motors

_FULL_SPEED = 2 * 65535.0  # units per second at a speed of 32766


def frame(operation: int, *words: int) -> bytes:
    """A frame of 16 bytes; missing words are 0."""
    return struct.pack("<2B7H", operation, 0, *words, *[0] * (7 - len(words)))


class AeroHand:
    """A simulated Aero Hand Open; bytes in, bytes out; positions 0 to 65535."""

    def __init__(self, side: str) -> None:
        self.side = side
        self.faults = Faults("short", "operation")
        self.motors = Motors(np.zeros(7), _FULL_SPEED)
        self.received: list[bytes] = []
        self.homing = False
        self._unasked = b""
        self._start()

    def _start(self) -> None:
        self.speeds = [32766] * 7
        self.torques = [1023] * 7
        self.torque_mode = False
        self._buffer = b""
        for actuator in range(7):
            self.motors.set_speed(actuator, _FULL_SPEED)
        self.motors.set_power(True)

    def reboot(self) -> None:
        """Switch the hand off and on: default speeds and torques, and text on the line."""
        self._start()
        self.motors.place(self.motors.positions)
        self._unasked += self.boot_text

    @property
    def boot_text(self) -> bytes:
        """What the hand prints at power on."""
        lines = [f"[BOOT] Hand Type: {self.side.upper()}_HAND", "", "[Init] Pinging servos..."]
        lines += [f"  ID {i}: OK" for i in range(7)]
        text = "\r\n".join(lines) + "\r\n"
        way = 1 if self.side == "left" else -1
        text += "".join(f"Servo {i} dir={-way if i == 2 else way}\n" for i in range(7))
        return text.encode()

    def poll(self) -> bytes:
        """Bytes that the hand sends by itself: text at power on."""
        if self.faults.silent:
            return b""
        sent, self._unasked = self._unasked, b""
        return sent

    def receive(self, data: bytes) -> bytes:
        """Answer every 16 bytes."""
        answers = self.poll()
        if self.faults.silent or self.homing:
            self._buffer = b""
            return answers
        self._buffer += data
        while len(self._buffer) >= 16:
            one, self._buffer = self._buffer[:16], self._buffer[16:]
            self.received.append(one)
            answers += self._answer(one[0], struct.unpack("<7H", one[2:]))
        return answers

    def _answer(self, operation: int, words: tuple[int, ...]) -> bytes:
        motors = self.motors
        if operation == 0x11:
            self.torque_mode = False
            motors.move(words)
        elif operation == 0x12:
            self.torque_mode = True
            motors.move(np.where(np.array(words) > 0, 65535, motors.positions))
        elif operation in (0x31, 0x32):
            return self._send(operation, *self._limit(operation, words[0], words[1]))
        elif operation == 0x22:
            return self._send(operation, *np.clip(motors.positions.round(), 0, 65535))
        elif operation == 0x24:
            signs = np.sign(motors.targets - motors.positions)
            return self._send(operation, *(signs * motors.currents / 6.5).round())
        elif operation == 0x25:
            return self._send(operation, *motors.temperatures)
        return b""

    def _limit(self, operation: int, actuator: int, value: int) -> tuple[int, int]:
        if actuator >= 7:
            return 0xFFFF, 0
        if operation == 0x31:
            self.speeds[actuator] = min(value, 32766)
            self.motors.set_speed(actuator, _FULL_SPEED * self.speeds[actuator] / 32766)
            return actuator, self.speeds[actuator]
        self.torques[actuator] = min(value, 1023)
        return actuator, self.torques[actuator]

    def _send(self, operation: int, *words: float) -> bytes:
        wrong = self.faults.next_wrong()
        answer = frame(
            operation ^ 0x07 if wrong == "operation" else operation,
            *(int(word) & 0xFFFF for word in words),
        )
        return answer[:-3] if wrong == "short" else answer
