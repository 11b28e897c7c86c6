"""A simulated LinkerHand L10 or L20 on a CAN bus: frames of a property byte and up to seven values.

Written from the published frame list; it shares no code with the driver. The identifiers are those
of the maker's SDK, whose enumeration of sides has LEFT = 0x28 and RIGHT = 0x27. The bus is
python-can's virtual one, which carries frames between two bus objects of one process.
"""

import threading
import time
from typing import Any, Final

import numpy as np
from hand_servos import Faults, Servos

LAYOUT: Final = {
    "l10": {0x01: [0, 1, 2, 3, 4, 5], 0x04: [6, 7, 8, 9]},
    "l20": {
        0x01: [0, 1, 2, 3, 4],
        0x02: [5, 6, 7, 8, 9],
        0x03: [10, None, None, None, None],
        0x04: [11, 12, 13, 14, 15],
    },
}
"""Property byte -> motors of its values; None is a value without motor."""


IDENTIFIERS: Final = {"left": 0x28, "right": 0x27}


class LinkerHand:
    """The hand on the bus: it takes position frames and answers each with where the motors are."""

    def __init__(self, channel: str, model: str, side: str = "right") -> None:
        import can

        self.model, self.identifier = model, IDENTIFIERS[side]
        self.layout = LAYOUT[model]
        motors = 10 if model == "l10" else 16
        self.servos = Servos([255.0] * motors, speed=2500.0, lower=0.0, upper=255.0)
        self.faults = Faults()
        self.fault_codes = [0] * motors
        self.temperatures = list(range(30, 30 + motors))
        self.settings: dict[int, list[int]] = {}
        """Property byte -> the last values that were set, of speed, torque and current."""
        self.frames = 0
        self._can: Any = can
        self.bus: Any = can.Bus(interface="virtual", channel=channel)
        self._closed = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while not self._closed:
            try:
                message = self.bus.recv(timeout=0.1)
            except Exception:
                return
            if message is None or message.arbitration_id != self.identifier or not message.data:
                continue
            self.frames += 1
            if self.faults.delay_s:
                time.sleep(self.faults.delay_s)
            answer = self.answer(message.data[0], list(message.data[1:]))
            if answer is not None and not self.faults.mute:
                self._send(message.data[0], answer)

    def answer(self, kind: int, values: list[int]) -> list[int] | None:
        """Answer to a frame of this kind; None for no answer."""
        if kind in self.layout:
            motors = self.layout[kind]
            if values:
                target = np.full(len(self.servos.target), np.nan)
                for motor, value in zip(motors, values, strict=False):
                    if motor is not None:
                        target[motor] = value
                self.servos.aim(target)
            where = self.servos.positions()
            return [0 if motor is None else round(float(where[motor])) for motor in motors]
        if values and kind != 0x07:
            self.settings[kind] = values
        if self.model == "l20":
            if kind in (0x05, 0x06):
                return self.settings.get(kind, [255] * 5)
            if kind == 0x07:
                if values == [1] * 5:
                    self.fault_codes = [0] * 16
                return self.fault_codes[:5]
            return None
        if kind in (0x02, 0x03, 0x05, 0x06):
            return self.settings.get(kind, [255] * 5)
        if kind in (0x33, 0x34):
            return self.temperatures[:5] if kind == 0x33 else self.temperatures[5:]
        if kind in (0x35, 0x36):
            return self.fault_codes[:5] if kind == 0x35 else self.fault_codes[5:]
        return None

    def _send(self, kind: int, values: list[int]) -> None:
        data = bytes([kind, *values])
        if self.faults.garble:
            data = bytes([kind, 7])  # a frame that is too short
        try:
            self.bus.send(
                self._can.Message(arbitration_id=self.identifier, data=data, is_extended_id=False)
            )
        except Exception:
            self._closed = True

    def close(self) -> None:
        self._closed = True
        self._thread.join(60.0)
        self.bus.shutdown()
