"""Frames of the LinkerHands' models on a CAN bus.

Facts by the maker: the package ``linkerbot`` 0.5.4 (O6, L6, L20 lite, L25), and the repository
linker-bot/linkerhand-python-sdk, commit b371361, ``LinkerHand/core/can`` (all of them).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, TypeAlias

Frames: TypeAlias = Mapping[int, Sequence[int | None]]
"""Kind of a frame -> the motor of each of its values; None for a value without a motor."""

_SERVO_FAULTS: Final = ("voltage", "encoder", "too hot", "overcurrent", "", "overload")
_PHASE_FAULTS: Final = (
    *("overcurrent of phase B", "overcurrent of phase C", "overcurrent of phase A"),
    *("overload 1", "overload 2", "motor too hot", "controller too hot"),
)
_FINGER_FAULTS: Final = (
    *("rotor locked", "overcurrent", "stall", "voltage", "self-check", "too hot"),
    *("rotor locked (soft)", "motor does not answer"),
)
"""Bits of a fault, from the lowest: ``FaultCode`` of O6 and L20 lite, of L6, and of L25 in
``linkerbot``. The maker's texts of the others contradict each other."""


@dataclass(frozen=True)
class Model:
    """Frames of one model.

    Attributes:
        positions, speeds, limits, temperatures, faults, currents: frames of these values.
        bits: names of the bits of a fault, from the lowest; empty if they are not known.
        clear: the frame that clears faults; empty if there is none.
        touch: code of the touch matrix of a fingertip, and its rows and columns.
    """

    positions: Frames
    speeds: Frames
    limits: Frames
    temperatures: Frames = field(default_factory=dict)
    faults: Frames = field(default_factory=dict)
    currents: Frames = field(default_factory=dict)
    bits: tuple[str, ...] = field(default=(), kw_only=True)
    clear: bytes = field(default=b"", kw_only=True)
    touch: tuple[int, tuple[int, int]] = field(default=(0xC6, (12, 6)), kw_only=True)

    @property
    def motors(self) -> int:
        """Number of motors."""
        return sum(motor is not None for row in self.positions.values() for motor in row)


def _single(
    motors: int, currents: int = 0, bits: tuple[str, ...] = (), clear: bytes = b""
) -> Model:
    """A hand whose motors fit into one frame."""
    kinds = [kind for kind in (0x01, 0x05, 0x02, 0x33, 0x35, currents) if kind]
    return Model(*({kind: range(motors)} for kind in kinds), bits=bits, clear=clear)


def _ten(bits: tuple[str, ...] = ()) -> Model:
    def fives(first: int) -> Frames:
        return {first: range(5), first + 1: range(5, 10)}

    positions = {1: range(6), 4: range(6, 10)}
    return Model(positions, fives(5), fives(2), fives(0x33), fives(0x35), bits=bits)


def _by_finger(thumb: str, finger: str) -> Model:
    """A hand with one frame of six places for each finger.

    Args:
        thumb, finger: an ``x`` for each place with a motor: roll, yaw, three roots, tip.
    """
    numbers = iter(range(30))
    rows = [
        [next(numbers) if place == "x" else None for place in places]
        for places in (thumb, *[finger] * 4)
    ]

    def frames(first: int) -> Frames:
        return {first + k: row for k, row in enumerate(rows)}

    kinds = (0x41, 0x49, 0x51, 0x61, 0x59)
    clear = bytes([0x83, 1, 1, 1, 1, 1])
    return Model(*map(frames, kinds), bits=_FINGER_FAULTS, clear=clear)


_FIVE: Final = range(5)
MODELS: Final[Mapping[str, Model]] = {
    "o6": replace(_single(6, 0x36, bits=_SERVO_FAULTS), touch=(0xA4, (10, 4))),
    "l6": _single(6, 0x36, bits=_PHASE_FAULTS, clear=bytes([0x83, *[1] * 6])),
    "l7": _single(7),
    "l10": _ten(),
    "l20lite": _ten(_SERVO_FAULTS),
    "l20": Model(
        {1: _FIVE, 2: range(5, 10), 3: (10, None, None, None, None), 4: range(11, 16)},
        {5: _FIVE},
        {6: _FIVE},
        faults={7: _FIVE},
        clear=bytes([7, 1, 1, 1, 1, 1]),
    ),
    "l21": _by_finger("xxxx.x", ".xx..x"),
    "l25": _by_finger("xxxx.x", ".xxx.x"),
    "l25_16": _by_finger("xxx..x", "x.x..x"),
    "g20": _by_finger("xxx..x", "x.x..x"),
}
"""Name of a model -> its frames. Speeds, limits and faults of the L20 are those of fingers. The
L25 has 21 motors in linkerhand-python-sdk and 16, in other places, in ``linkerbot``: ``l25_16``."""
