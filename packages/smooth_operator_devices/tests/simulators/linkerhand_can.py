"""A LinkerHand on a CAN bus: O6, L6, L7, L10, L20 lite, L20, and L21, L25, G20.

Sources, by the maker (Linkerbot):

- `linkerbot` 0.5.4 (package index; `linkerbot-py` 0.5.1, its predecessor, has the same frames),
  `linkerbot/hand/{o6,l6,l20lite,l25}/*.py`: identifiers, frames, counts of values, fault bits,
  touch rows.
- github.com/linker-bot/linkerhand-python-sdk, commit b3713618 (2026-02-08),
  `LinkerHand/core/can/linker_hand_{o6,l6,l7,l10,l20,l21,l25,g20}_can.py` and
  `LinkerHand/linker_hand_api.py`: the same, and L7, L10, L20, L21, G20.
- github.com/linker-bot/linkerhand-cpp-sdk, commit a0100cf3 (2026-08-19), `include/core/Common.h`:
  sides.

Facts: classic CAN, 11-bit identifiers, 1 Mbit/s. **Left is 0x28, right is 0x27**, for commands and
answers alike (all three sources; a pair of variables in `linker_hand_l20_can.py` and
`linker_hand_l21_can.py` says the opposite and is used by nothing). The first byte is the kind. A
frame of the kind alone asks; a frame with values writes, and the hand answers with what is
measured. Values are 0 to 255: 255 is straight, or away from the palm.

Where the sources differ:

- L25: linkerhand-python-sdk puts abduction of the four fingers into the second place of a finger's
  frame (yaw) and a middle joint into the fourth; linkerbot puts abduction into the first place
  and has no middle joint. Both are here: "L25" and "L25 linkerbot".
- L20 lite: its frames are those of the L10.
- G20: the comment and the code of `linker_hand_g20_can.py` swap the first two places of the thumb.
  The code is followed.
- O6: linkerhand-python-sdk reads a current (0x36), linkerbot has none. The hand answers it.

Not found: the values after power on, the speed and torque they stand for, whether a hand keeps
torque after power on (here it does), whether 0x01 to 0x06 are answered when they write to an L21,
L25 or G20 (here they are, with the same kind), the unit of the fault answer to 0x84, what a hand
does with a frame of a wrong length (here nothing), and how far apart frames must be at least (the
maker's programs wait 0.3 to 5 ms).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import can
import numpy as np

from .common import Faults, Motors

IDENTIFIERS = {"left": 0x28, "right": 0x27}

_FIVE = ("thumb", "index", "middle", "ring", "pinky")
_SIX = ("thumb_flex", "thumb_abd", "index", "middle", "ring", "pinky")
_TEN = (
    "thumb_flex",
    "thumb_abd",
    "index_flex",
    "middle_flex",
    "ring_flex",
    "pinky_flex",
    "index_abd",
    "ring_abd",
    "pinky_abd",
    "thumb_yaw",
)
_TWENTY = (
    *(f"{finger}_root" for finger in _FIVE),
    *(f"{finger}_abd" for finger in _FIVE),
    "thumb_roll",
    *(f"{finger}_tip" for finger in _FIVE),
)

Layout = dict[int, tuple[int | None, ...]]  # kind of frame: the joint of each value


@dataclass(frozen=True)
class Model:
    """Joints of a hand, and the joints in each of its frames (None: reserved, sent as 0)."""

    joints: tuple[str, ...]
    positions: Layout
    torques: Layout = field(default_factory=dict)
    speeds: Layout = field(default_factory=dict)
    temperatures: Layout = field(default_factory=dict)
    faults: Layout = field(default_factory=dict)
    currents: Layout = field(default_factory=dict)
    clear: int | None = None  # kind that clears faults
    clears_by_fault_frame: bool = False  # a write of a fault frame clears, too
    touch_row: int = 6  # values of a row of the touch matrix
    touch_rows: int = 12
    touch_code: int = 0xC6


def _run(first: int, count: int) -> tuple[int, ...]:
    return tuple(range(first, first + count))


def _six(**changes: object) -> Model:
    six = _run(0, 6)
    return Model(
        _SIX,
        positions={0x01: six},
        torques={0x02: six},
        speeds={0x05: six},
        temperatures={0x33: six},
        faults={0x35: six},
        currents={0x36: six},
        **changes,  # type: ignore[arg-type]
    )


def _by_finger(thumb: tuple[str | None, ...], finger: tuple[str | None, ...]) -> Model:
    """A hand whose frames hold the six places of one finger, or one place of five fingers."""
    names = [
        None if part is None else f"{name}_{part}"
        for name in _FIVE
        for part in (thumb if name == "thumb" else finger)
    ]
    joints = tuple(name for name in names if name is not None)
    places = [None if name is None else joints.index(name) for name in names]

    def frames(by_finger: int, by_place: int) -> Layout:
        return {
            **{by_finger + f: tuple(places[6 * f : 6 * f + 6]) for f in range(5)},
            **{by_place + p: tuple(places[p::6]) for p in range(6)},
        }

    return Model(
        joints,
        positions=frames(0x41, 0x01),
        speeds=frames(0x49, 0x09),
        torques=frames(0x51, 0x11),
        faults=frames(0x59, 0x19),
        temperatures=frames(0x61, 0x21),
        clear=0x83,
        clears_by_fault_frame=True,
    )


_L10 = Model(
    _TEN,
    positions={0x01: _run(0, 6), 0x04: _run(6, 4)},
    torques={0x02: _run(0, 5), 0x03: _run(5, 5)},
    speeds={0x05: _run(0, 5), 0x06: _run(5, 5)},
    temperatures={0x33: _run(0, 5), 0x34: _run(5, 5)},
    faults={0x35: _run(0, 5), 0x36: _run(5, 5)},
)
_SEVEN = _run(0, 7)
MODELS = {
    "O6": _six(touch_row=4, touch_rows=10, touch_code=0xA4),
    "L6": _six(clear=0x83),
    "L7": Model(
        (*_SIX, "thumb_roll"),
        positions={0x01: _SEVEN},
        torques={0x02: _SEVEN},
        speeds={0x05: _SEVEN},
        temperatures={0x33: _SEVEN},
        faults={0x35: _SEVEN},
    ),
    "L10": _L10,
    "L20 lite": _L10,
    "L20": Model(
        _TWENTY,
        positions={
            0x01: _run(0, 5),
            0x02: _run(5, 5),
            0x03: (10, None, None, None, None),
            0x04: _run(11, 5),
        },
        speeds={0x05: _run(0, 5)},  # one value a finger
        currents={0x06: _run(0, 5)},
        faults={0x07: _run(0, 5)},
        clears_by_fault_frame=True,
    ),
    "L21": _by_finger(
        ("roll", "abd", "root", "middle", None, "tip"), (None, "abd", "root", None, None, "tip")
    ),
    "L25": _by_finger(
        ("roll", "abd", "root", "middle", None, "tip"), (None, "abd", "root", "middle", None, "tip")
    ),
    "L25 linkerbot": _by_finger(
        ("abd", "yaw", "root", None, None, "tip"), ("abd", None, "root", None, None, "tip")
    ),
    "G20": _by_finger(
        ("yaw", "abd", "root", None, None, "tip"), ("abd", None, "root", None, None, "tip")
    ),
}


class LinkerHand:
    """A simulated LinkerHand; values 0 to 255."""

    def __init__(self, model: str, side: str) -> None:
        self.model = MODELS[model]
        self.side = side
        self.identifier = IDENTIFIERS[side]
        count = len(self.model.joints)
        self.faults = Faults("identifier", "short")
        self.motors = Motors(np.full(count, 255.0), 400.0)
        self.touch = {
            finger: np.zeros((self.model.touch_rows, self.model.touch_row), dtype=np.uint8)
            for finger in _FIVE
        }
        self.received: list[bytes] = []
        self.reboot()

    def reboot(self) -> None:
        """Switch the hand off and on: speeds, torques and faults are the defaults again."""
        count = len(self.model.joints)
        self.speeds = np.full(count, 255, dtype=int)
        self.torques = np.full(count, 255, dtype=int)
        self.fault_bits = np.zeros(count, dtype=int)
        self.motors.place(self.motors.positions)
        self.motors.set_power(True)
        for joint in range(count):
            self.motors.set_speed(joint, 400.0)

    def raise_fault(self, joint: str, bits: int) -> None:
        """Set fault bits of a joint: it stands still until the fault is cleared."""
        number = self.model.joints.index(joint)
        self.fault_bits[number] |= bits
        self.motors.set_power(False, [number])

    def answer(self, frame: can.Message) -> list[can.Message]:
        """The frames that the hand sends back."""
        if self.faults.silent or frame.is_extended_id or frame.is_fd:
            return []
        if frame.arbitration_id != self.identifier or not frame.data:
            return []
        self.received.append(bytes(frame.data))
        payloads = self._answers(frame.data[0], bytes(frame.data[1:]))
        return [self._message(payload) for payload in payloads]

    def _message(self, payload: bytes) -> can.Message:
        identifier = self.identifier
        wrong = self.faults.next_wrong()
        if wrong == "short":
            payload = payload[:-1]
        if wrong == "identifier":
            identifier = next(i for i in IDENTIFIERS.values() if i != identifier)
        return can.Message(arbitration_id=identifier, data=payload, is_extended_id=False)

    def _answers(self, kind: int, values: bytes) -> list[bytes]:
        model = self.model
        if kind in model.positions:
            places = model.positions[kind]
            if values and not self._write(places, values, self._move):
                return []
            return [self._frame(kind, places, np.clip(self.motors.positions.round(), 0, 255))]
        for frames, settings in ((model.torques, self.torques), (model.speeds, self.speeds)):
            if kind in frames:
                if values and not self._write(frames[kind], values, settings.__setitem__):
                    return []
                for joint, speed in enumerate(self.speeds):
                    self.motors.set_speed(joint, 400.0 * speed / 255)
                return [self._frame(kind, frames[kind], settings)]
        if kind == model.clear and values:
            self._clear(range(len(model.joints)))
            return [bytes([kind]) + values]
        if kind in model.faults:
            if values and model.clears_by_fault_frame:
                self._clear(joint for joint in model.faults[kind] if joint is not None)
            return [self._frame(kind, model.faults[kind], self.fault_bits)]
        if kind in model.temperatures:
            return [self._frame(kind, model.temperatures[kind], self.motors.temperatures)]
        if kind in model.currents:
            return [self._frame(kind, model.currents[kind], self.motors.currents * 255 / 1400)]
        if 0xB1 <= kind <= 0xB5 and values == bytes([model.touch_code]):
            matrix = self.touch[_FIVE[kind - 0xB1]]
            return [bytes([kind, row << 4, *matrix[row]]) for row in range(len(matrix))]
        return []

    def _write(self, places: tuple[int | None, ...], values: bytes, store) -> bool:  # type: ignore[no-untyped-def]
        if len(values) != len(places):
            return False
        for joint, value in zip(places, values, strict=True):
            if joint is not None:
                store(joint, value)
        return True

    def _move(self, joint: int, value: int) -> None:
        self.motors.move([value], [joint])

    def _clear(self, joints) -> None:  # type: ignore[no-untyped-def]
        for joint in joints:
            self.fault_bits[joint] = 0
            self.motors.set_power(True, [joint])

    def _frame(self, kind: int, places: tuple[int | None, ...], values: np.ndarray) -> bytes:
        return bytes([kind, *(0 if place is None else int(values[place]) for place in places)])
