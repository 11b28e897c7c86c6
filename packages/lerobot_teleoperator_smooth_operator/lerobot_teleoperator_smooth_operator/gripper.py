"""Opening of a parallel gripper, such as that of an SO-101, from a human hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import index

OPEN = 100.0
"""Value of an open gripper in LeRobot's units; a closed one is 0."""

_PLAY = 5.0
"""Change of the human's opening that the gripper does not follow. The noise of headsets, gloves and
cameras is about 1."""

_FIST, _STRAIGHT = 0.5, 0.9
"""Distance from knuckle to fingertip over the length of the finger, mean of four fingers."""

_THUMB_TIP = index("thumb_tip")
_FINGERS = np.array(
    [
        [index(f"{finger}_{part}") for part in ("mcp", "pip", "dip", "tip")]
        for finger in ("index", "middle", "ring", "pinky")
    ]
)


@dataclass(frozen=True)
class Jaw:
    """The joint that opens a gripper of the catalogue.

    Attributes:
        joint: its name.
        closed: its position when the gripper is closed [rad or m].
        open: its position when the gripper is open [rad or m].
    """

    joint: str
    closed: float
    open: float

    @classmethod
    def of(cls, hand: Hand) -> Jaw | None:
        """The jaw of a gripper; None for any other hand."""
        if not hand.spec.gripper:
            return None
        ends = hand.limits[0]
        tips = hand.tips(hand.full_configuration(ends[:, None]))
        gaps = np.linalg.norm(tips[:, 0] - tips[:, 1], axis=-1)
        closed, opened = ends[np.argsort(gaps)]
        return cls(hand.actuated_names[0], float(closed), float(opened))

    def opening(self, position: float) -> float:
        """Opening at a position, 0 (closed) to 1 (open)."""
        return (position - self.closed) / (self.open - self.closed)


class Gripper:
    """Follows the opening of a human hand with hysteresis, so that noise does not move the gripper.

    Args:
        by: ``pinch``: open (100) when thumb and index finger are the length of the index finger
            apart, closed (0) when they touch; or ``hand``: open with straight fingers, closed with
            a fist. For a pinch, the retargeted jaw of a gripper is better (``move``), since the
            method knows the gap that a tracker leaves between fingers that touch.
        touch_m: distance of the landmarks of both fingertips when they touch [m].

    Attributes:
        opening: opening of the gripper, 0 (closed) to 100 (open, as at the start).

    Raises:
        ValueError: ``by`` is unknown.
    """

    def __init__(self, by: str = "pinch", touch_m: float = 0.01) -> None:
        if by not in ("pinch", "hand"):
            raise ValueError(f"gripper must be pinch or hand, not {by!r}")
        self._by, self._touch = by, touch_m
        self.reset()

    def reset(self) -> None:
        """Open the gripper."""
        self.opening = OPEN
        self._held = OPEN - _PLAY

    def follow(self, landmarks: np.ndarray) -> float:
        """Computes the opening for (21, 3) landmarks [m]; without all landmarks it is unchanged."""
        if np.isfinite(landmarks).all():
            self.move(self._measured(landmarks))
        return self.opening

    def move(self, opening: float) -> float:
        """Computes the gripper's opening from that of a hand or jaw, 0 (closed) to 1 (open)."""
        target = OPEN * min(max(opening, 0.0), 1.0)
        self._held = min(max(self._held, target - _PLAY), target + _PLAY)
        # Both ends are reached: closed at _PLAY, open at OPEN - _PLAY.
        self.opening = OPEN * (self._held - _PLAY) / (OPEN - 2 * _PLAY)
        self.opening = min(max(self.opening, 0.0), OPEN)
        return self.opening

    def _measured(self, landmarks: np.ndarray) -> float:
        """Opening of the human hand, about 0 to 1."""
        fingers = landmarks[_FINGERS]
        lengths = np.linalg.norm(np.diff(fingers, axis=1), axis=-1).sum(axis=-1)
        if self._by == "hand":
            reach = np.linalg.norm(fingers[:, -1] - fingers[:, 0], axis=-1)
            ratio = float(np.mean(reach / np.maximum(lengths, self._touch)))
            return (ratio - _FIST) / (_STRAIGHT - _FIST)
        apart = float(np.linalg.norm(landmarks[_THUMB_TIP] - fingers[0, -1]))
        return (apart - self._touch) / max(float(lengths[0]) - self._touch, self._touch)
