"""Opening of a parallel gripper, such as that of an SO-101, from the landmarks of a human hand."""

from __future__ import annotations

import numpy as np

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


class Gripper:
    """Follows the opening of a human hand with hysteresis, so that noise does not move the gripper.

    Args:
        by: ``pinch``: open (100) when thumb and index finger are the length of the index finger
            apart, closed (0) when they touch; or ``hand``: open with straight fingers, closed with
            a fist.
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
            human = OPEN * min(max(self._measured(landmarks), 0.0), 1.0)
            self._held = min(max(self._held, human - _PLAY), human + _PLAY)
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
