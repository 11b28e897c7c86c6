"""A simulated Allegro Hand V4 or V5 on a CAN bus: motors that take torque and report angles.

Written from the maker's user manuals; it shares no code with the driver. The identifier on the wire
is the message number times four. Each joint is an inertia with friction, so a driver that loses its
controller or reverses a sign is seen to fail.
"""

import math
import struct
import threading
import time
from typing import Any

import numpy as np
from simulators.common import Faults

LSB = {"v4": math.radians(333.3 / 65536), "v5": math.radians(0.088)}
TORQUE = {"v4": 1 / 1200, "v5": 1 / 1430}
"""Newton metres per unit of the torque frame."""


class AllegroHand:
    """The hand on the bus, with a thread for its physics and its periodic reports.

    While it is controlled its time goes on by a period with each answer to a report, so that a busy
    machine is slow motion, and no delay in the controller's loop. Without an answer for a second it
    goes on with the machine's clock: then nobody controls it.

    Attributes:
        now: its time [s].
    """

    def __init__(self, channel: str, version: str = "v5", *, left: bool = False) -> None:
        import can

        self.version, self.left = version, left
        self.position = np.zeros(16)
        self.position[12] = 0.6
        self.velocity = np.zeros(16)
        self.torque = np.zeros(16, int)
        self.largest_torque = 0
        self.friction = 0.025
        self.servo_on = False
        self.switched: list[bool] = []
        self.period_s = 0.0
        self.faults = Faults("short")
        self.stuck: set[int] = set()
        self.error: tuple[int, int] | None = None
        self.torques: list[tuple[int, ...]] = []  # of a finger, in the order of their frames
        self.now = time.perf_counter()
        self._answered = True
        self._can: Any = can
        self.bus: Any = can.Bus(interface="virtual", channel=channel)
        self._closed = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        last = time.perf_counter()
        try:
            while not self._closed:
                message = self.bus.recv(timeout=0.002)
                if message is not None:
                    self._take(message)
                waited = time.perf_counter() - last
                if self.servo_on and self._answered and self.period_s:
                    step = self.period_s
                elif waited > (1.0 if self.servo_on else self.period_s or 0.001):
                    step = waited
                else:
                    continue
                last += waited
                self._answered = False
                self._move(step)
                self.now += step
                if self.period_s:
                    self._report()
        except Exception:
            if not self._closed:
                raise

    def _take(self, message: Any) -> None:
        number = message.arbitration_id >> 2
        if self.faults.silent:
            return
        if number == 0x40 or number == 0x41:
            self.servo_on = number == 0x40
            self.switched.append(self.servo_on)
        elif 0x60 <= number <= 0x63 and not message.is_remote_frame:
            values = struct.unpack("<4h", message.data)
            self.torques.append(values)
            self.largest_torque = max(self.largest_torque, *(abs(v) for v in values))
            self.torque[4 * (number - 0x60) : 4 * (number - 0x60) + 4] = values
            self._answered |= number == 0x63
        elif number == 0x81:
            self.period_s = struct.unpack("<3h", message.data)[0] / 1000
        elif message.is_remote_frame and number == 0x80:
            if self.version == "v4":
                status = int(self.servo_on) | (2 if self.error else 0)
                self._send(0x80, struct.pack("<HHBBB", 0x0401, 0x0102, self.left, 35, status))
            else:
                self._send(0x80, struct.pack("<HHBBB", 0x0501, 0x0103, 0, 0, 1))
        elif message.is_remote_frame and number == 0x88:
            text = f"5TB{'L' if self.left else 'R'}0042" if self.version == "v5" else "LR000042"
            self._send(0x88, text.encode())
        elif message.is_remote_frame and 0x38 <= number <= 0x3B:
            self._send(number, bytes([36, 37, 38, 39]))

    def _move(self, seconds: float) -> None:
        """Inertia 1e-3 kg m^2, and friction."""
        steps = max(1, int(seconds / 0.001))
        dt = min(seconds, 0.1) / steps
        for _ in range(steps):
            torque = self.torque * TORQUE[self.version] if self.servo_on else np.zeros(16)
            self.velocity += (torque - self.friction * self.velocity) / 1e-3 * dt
            for joint in self.stuck:
                self.velocity[joint] = 0.0
            self.position += self.velocity * dt
            ends = (-0.6, 2.0)
            out = (self.position < ends[0]) | (self.position > ends[1])
            self.position = np.clip(self.position, *ends)
            self.velocity[out] = 0.0

    def _report(self) -> None:
        if self.faults.silent:
            return
        short = self.faults.next_wrong() == "short"
        counts = np.rint(self.position / LSB[self.version]).astype(int)
        for finger in range(4):
            data = struct.pack("<4h", *counts[4 * finger : 4 * finger + 4])
            self._send(0x20 + finger, data[:5] if short else data)
        if self.error is not None and self.version == "v5":
            self._send(0xEE, bytes(self.error))

    def _send(self, number: int, data: bytes) -> None:
        self.bus.send(
            self._can.Message(arbitration_id=number << 2, data=data, is_extended_id=False)
        )

    def close(self) -> None:
        self._closed = True
        self._thread.join(60.0)
        self.bus.shutdown()
