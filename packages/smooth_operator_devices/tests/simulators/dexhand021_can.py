"""A DexHand021 (DexRobot) on CAN-FD: six boards of two motors.

Sources, by the maker (DexRobot):

- github.com/DexRobot/pyzlg_dexhand, commit 316575ac (2025-01-26), `pyzlg_dexhand/dexhand_protocol/
  {__init__,commands,messages}.py`, `dexhand_interface.py`, `config/config.yaml`, `README.md`, and
  `tests/test_dexhand_protocol.py` (frames, one of them captured from a hand).
- github.com/DexRobot/dexhand_sdk_cpp, commit 3827b1f1 (2026-05-14), `include/commondef.h`: control
  modes, error bits, boards.

Facts: 1 Mbit/s, 5 Mbit/s for data. Identifier = kind + board: 0x100 motion command, 0x00
configuration, 0x180 feedback, 0x80 answer to a configuration, 0x600 error. Boards: left 1 to 6,
right 7 to 12. Motors of the boards: (th_dip, th_mcp), (th_rot, ff_spr), (ff_dip, ff_mcp), then
middle, ring and little finger. A command is mode, enable bits and two i16, low byte first; in mode
0x44 (cascaded), the only one here, the unit is 0.01°. Feedback: current [mA], speed [rpm], Hall
counts of each motor, two angles in 0.01° (16 bytes); touch of a fingertip to byte 42, encoders to
byte 46. Speed, counts and encoders, which the driver does not use, are 0 here. A good answer to a
configuration repeats its first two bytes and adds 00 01. An error frame of a hand had 64 bytes: EE,
motor, bits. A finger that something holds may go into the error state, and then ignores commands
until 03 A4.

Not found: whether boards send feedback before they are configured (here they do not), how long a
motor must stall (here 0.5 s), how long feedback frames are on the wire (here 48 bytes with touch
and encoders, and 16 for the palm's board, which has no fingertip; CAN-FD has no frames of 42 or 46
bytes), whether classic frames are heard (here they are not), the error frames EF and FF, and the
modes 0x66 and 0x77 of the newer SDK.
"""

from __future__ import annotations

import struct
import time

import can
import numpy as np

from .common import Faults, Motors

BASES = {"left": 0x01, "right": 0x07}
JOINTS = (
    *("th_dip", "th_mcp", "th_rot", "ff_spr", "ff_dip", "ff_mcp"),
    *("mf_dip", "mf_mcp", "rf_dip", "rf_mcp", "lf_dip", "lf_mcp"),
)
FREE, CASCADED = 0x00, 0x44
OVERLOAD, STALL = 1, 4  # bits of motor 1; of motor 2 they are 4 bits higher


class DexHand021:
    """A simulated DexHand021, in degrees."""

    def __init__(self, side: str) -> None:
        self.side = side
        self.base = BASES[side]
        self.faults = Faults("identifier", "short")
        self.motors = Motors(np.zeros(12), 240.0)  # degrees, degrees per second
        self.dead_boards: set[int] = set()
        self.touch = [{"normal": 0.0, "tangential": 0.0, "direction": 0} for _ in range(6)]
        self.received: list[tuple[int, bytes]] = []
        self._clock = time.monotonic
        self.reboot()

    def reboot(self) -> None:
        """Switch the hand off and on: no torque, no feedback, no errors."""
        self.modes = [FREE] * 12
        self.errors = [0] * 12
        self.feedback: list[tuple[int, float] | None] = [None] * 6  # mode, period in seconds
        self._due = [0.0] * 6
        self._stalled: dict[int, float] = {}
        self._errors_to_send: list[int] = []
        self.motors.place(self.motors.positions)
        self.motors.set_power(False)

    def raise_error(self, joint: str, bits: int) -> None:
        """Put a motor into the error state: it stands still, and its board says so once."""
        motor = JOINTS.index(joint)
        self.errors[motor] |= bits
        self.motors.set_power(False, [motor])
        self._errors_to_send.append(motor // 2)

    def answer(self, frame: can.Message) -> list[can.Message]:
        """The frames that a frame of the host brings at once."""
        board = (frame.arbitration_id & 0x7F) - self.base
        if self.faults.silent or not frame.is_fd or frame.is_extended_id:
            return []
        if not 0 <= board < 6 or board in self.dead_boards:
            return []
        data = bytes(frame.data)
        kind = frame.arbitration_id & 0xF80
        if kind not in (0x100, 0x00):
            return []
        self.received.append((frame.arbitration_id, data))
        if kind == 0x100:
            return self._command(board, data)
        return self._configure(board, data)

    def poll(self) -> list[can.Message]:
        """The frames that the hand sends by itself: errors and feedback."""
        if self.faults.silent:
            return []
        self._find_stalls()
        frames = [self._error(board) for board in self._errors_to_send]
        self._errors_to_send = []
        now = self._clock()
        for board, setting in enumerate(self.feedback):
            if setting is None or board in self.dead_boards:
                continue
            mode, period = setting
            if mode == 1 and now >= self._due[board]:
                self._due[board] = now + period
                frames.append(self._frame(0x180, board, self._payload(board)))
        return frames

    def _command(self, board: int, data: bytes) -> list[can.Message]:
        if len(data) < 6:
            return []
        mode, enabled, *values = struct.unpack("<BBhh", data[:6])
        for i, value in enumerate(values):
            motor = 2 * board + i
            if not enabled & 1 << i or self.errors[motor]:
                continue
            self.modes[motor] = mode
            self.motors.set_power(mode != FREE, [motor])
            if mode == CASCADED:
                self.motors.move([value / 100], [motor])
        return []

    def _configure(self, board: int, data: bytes) -> list[can.Message]:
        if data[:2] == b"\x03\xa4":
            for motor in (2 * board, 2 * board + 1):
                self.errors[motor] = 0
                self._stalled.pop(motor, None)
                self.motors.move([self.motors.positions[motor]], [motor])
                self.motors.set_power(self.modes[motor] != FREE, [motor])
        elif data[:2] == b"\x03\x74" and len(data) >= 5:
            self.feedback[board] = (data[2], data[3] / 100) if data[4] else None
            self._due[board] = self._clock()
        else:
            return []
        return [self._frame(0x80, board, data[:2] + b"\x00\x01")]

    def _find_stalls(self) -> None:
        positions, now = self.motors.positions, self._clock()
        for motor in range(12):
            away = not np.isclose(self.motors.targets[motor], positions[motor])
            if motor in self.motors.stuck and away and self.motors.powered[motor]:
                if now - self._stalled.setdefault(motor, now) >= 0.5:
                    self.raise_error(JOINTS[motor], STALL)
            else:
                self._stalled.pop(motor, None)

    def _error(self, board: int) -> can.Message:
        first, second = self.errors[2 * board : 2 * board + 2]
        which = (1 if first else 0) | (2 if second else 0)
        return self._frame(0x600, board, bytes([0xEE, which, first | second << 4]).ljust(64, b"\0"))

    def _payload(self, board: int) -> bytes:
        motors = self.motors
        pair = slice(2 * board, 2 * board + 2)
        first, second = np.rint(motors.currents[pair]).astype(int)
        angles = np.rint(100 * motors.positions[pair]).astype(int)
        payload = struct.pack("<8h", first, 0, 0, second, 0, 0, *angles)
        if board == 1:
            return payload
        touch = self.touch[board]
        payload += struct.pack(
            "<fIfIHII",
            touch["normal"],
            0,
            touch["tangential"],
            0,
            int(touch["direction"]),
            0,
            round(motors.temperatures[2 * board]),
        )
        return payload + bytes(4)

    def _frame(self, kind: int, board: int, payload: bytes) -> can.Message:
        wrong = self.faults.next_wrong()
        identifier = kind + self.base + board
        if wrong == "short":
            payload = payload[:3]
        if wrong == "identifier":
            identifier += 6 if self.side == "left" else -6
        length = next(n for n in (*range(9), 12, 16, 20, 24, 32, 48, 64) if n >= len(payload))
        return can.Message(
            arbitration_id=identifier,
            data=payload.ljust(length, b"\0"),
            is_extended_id=False,
            is_fd=True,
            bitrate_switch=True,
        )
