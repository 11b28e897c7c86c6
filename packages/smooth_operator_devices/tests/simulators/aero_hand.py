"""An Aero Hand Open on its serial line: 16 bytes a frame, no checksum.

Sources, by the maker (TetherIA):

- github.com/TetherIA/aero-open-firmware, commit d7bd82e8 (2025-10-27), `main/firmware_v0.1.0.ino`
  and `main/Homing.cpp`: what the hand does with each frame, its answers, its defaults at power on,
  the text it prints then, and its positions, which it reads every 10 ms.
- `aero-open-sdk` 0.1.0.dev1 (package index), `aero_open_sdk/aero_hand.py` and
  `aero_hand_constants.py`: units, ranges of the seven actuators, time for homing (175 s).

Facts: 921600 baud. A frame is an operation, 0, and seven words, low byte first. Order: thumb
abduction, thumb flexion, thumb tendon, index, middle, ring, pinky. Positions are 0 to 65535 over
each actuator's range (0 = extended). Answered are 0x01 (homing, when it is done, with zeros), 0x02,
0x03 (trim: actuator, extended count), 0x22 positions, 0x23 speeds (0.732 rpm), 0x24 currents
(6.5 mA), 0x25 temperatures (°C), 0x31 and 0x32 (actuator, value that holds). 0x31 and 0x32 of an
actuator that does not exist answer FF FF 00 00. Speed is clamped to 32766, torque to 1023. Commands
0x11 and 0x12 are not answered, unknown operations are consumed. The hand counts bytes: a frame that
lost a byte shifts all that follow. If one servo does not answer, all values stay as they were.

The SDK and the firmware differ: the SDK has 0x21 (all), which the firmware does not know; the
torque limit reaches 1000 in the SDK and 1023 in the firmware. After power on the hand prints text
on the same line, and its length is no multiple of 16 bytes.

Not found: what the hand does with bytes that arrive while it homes (the firmware intends to drop
them, and so does this), how fast an actuator turns at the default speed (here its whole range in
half a second), and where torque control (0x12) goes (here to the closed end for a torque above 0).
"""

from __future__ import annotations

import struct
import time

import numpy as np

from .common import Clock, Faults, Motors

LOW = np.array([0.0, 0.0, -15.2789, 0.0, 0.0, 0.0, 0.0])  # degrees of the motors
HIGH = np.array([100.0, 104.125, 247.15, 288.1603, 288.1603, 288.1603, 288.1603])
_EXTENDED = {
    "left": [3186, 2048, 0, 4095, 4095, 4095, 4095],
    "right": [910, 2048, 4095, 0, 0, 0, 0],
}
_GRASPED = {
    "left": [2048, 865, 2980, 817, 817, 817, 817],
    "right": [2048, 3231, 1115, 3278, 3278, 3278, 3278],
}
_FULL_SPEED = 2 * 65535.0  # units per second at a speed of 32766


def frame(operation: int, *words: int) -> bytes:
    """A frame of 16 bytes; missing words are 0."""
    return struct.pack("<2B7H", operation, 0, *words, *[0] * (7 - len(words)))


class AeroHand:
    """A simulated Aero Hand Open; bytes in, bytes out.

    hand = AeroHand("right")                      # or with clock=ManualClock()
    with SerialLine(hand) as line: ...            # the driver opens `line.port`
    hand.faults.silent = True; line.unplug(); line.plug(); hand.reboot()
    hand.faults.answer_wrongly("short")           # or "operation"
    hand.dead.add(3); hand.motors.stuck.add(4); hand.motors.temperatures[5] = 75
    hand.motors.positions, hand.speeds, hand.torques    # state; positions 0 to 65535
    """

    def __init__(
        self, side: str, *, homing_time: float = 60.0, clock: Clock = time.monotonic
    ) -> None:
        self.side = side
        self.homing_time = homing_time
        self.faults = Faults("short", "operation")
        self.dead: set[int] = set()  # servos that do not answer the hand's own controller
        self.motors = Motors(np.zeros(7), _FULL_SPEED, clock=clock)
        self.received: list[bytes] = []
        self.extended = list(_EXTENDED[side])
        self._clock = clock
        self._unasked = b""
        self._start()

    def _start(self) -> None:
        self.speeds = [32766] * 7
        self.torques = [1023] * 7
        self.torque_mode = False
        self._buffer = b""
        self._homed_at: float | None = None
        self._measured = np.zeros((4, 7), dtype=int)
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
        lines += [f"  ID {i}: {'NO REPLY' if i in self.dead else 'OK'}" for i in range(7)]
        directions = [
            1 if grasped < extended else -1
            for grasped, extended in zip(_GRASPED[self.side], _EXTENDED[self.side], strict=True)
        ]
        text = "\r\n".join(lines) + "\r\n"
        text += "".join(f"Servo {i} dir={way}\n" for i, way in enumerate(directions))
        return text.encode()

    @property
    def homing(self) -> bool:
        """Whether the hand homes now, and is deaf."""
        return self._homed_at is not None and self._clock() < self._homed_at

    def poll(self) -> bytes:
        """Bytes that the hand sends by itself: text at power on, and the end of homing."""
        if self.faults.silent:
            return b""
        sent, self._unasked = self._unasked, b""
        if self._homed_at is not None and not self.homing:
            self._homed_at = None
            sent += frame(0x01)
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
        if operation == 0x01:
            self.motors.place(np.zeros(7))
            self.extended = list(_EXTENDED[self.side])
            self._homed_at = self._clock() + self.homing_time
            return b""
        if operation == 0x11:
            self.torque_mode = False
            self.motors.move(words)
            return b""
        if operation == 0x12:
            self.torque_mode = True
            ends = np.where(np.array(words) > 0, 65535, self.motors.positions)
            self.motors.move(ends)
            return b""
        if operation == 0x03:
            return self._trim(words[0], words[1])
        if operation in (0x31, 0x32):
            return self._send(operation, *self._limit(operation, words[0], words[1]))
        if 0x22 <= operation <= 0x25:
            self._measure()
            row = self._measured[operation - 0x22]
            return self._send(operation, *(int(value) & 0xFFFF for value in row))
        return b""

    def _trim(self, actuator: int, degrees: int) -> bytes:
        if actuator >= 7:
            return b""
        signed = degrees - 0x10000 if degrees & 0x8000 else degrees
        count = self.extended[actuator] + int(signed * 11.375)
        self.extended[actuator] = min(max(count, 0), 4095)
        return self._send(0x03, actuator, self.extended[actuator])

    def _limit(self, operation: int, actuator: int, value: int) -> tuple[int, int]:
        if actuator >= 7:
            return 0xFFFF, 0
        if operation == 0x31:
            self.speeds[actuator] = min(value, 32766)
            self.motors.set_speed(actuator, _FULL_SPEED * self.speeds[actuator] / 32766)
            return actuator, self.speeds[actuator]
        self.torques[actuator] = min(value, 1023)
        return actuator, self.torques[actuator]

    def _measure(self) -> None:
        if self.dead:  # the firmware keeps all old values if one servo of the group is silent
            return
        motors = self.motors
        rpm = motors.velocities / 65535 * (HIGH - LOW) / 6
        self._measured[0] = np.clip(motors.positions.round(), 0, 65535)
        self._measured[1] = (rpm / 0.732).round()
        self._measured[2] = (
            np.sign(motors.targets - motors.positions) * motors.currents / 6.5
        ).round()
        self._measured[3] = motors.temperatures

    def _send(self, operation: int, *words: int) -> bytes:
        wrong = self.faults.next_wrong()
        answer = frame(operation ^ 0x07 if wrong == "operation" else operation, *words)
        return answer[:-3] if wrong == "short" else answer
