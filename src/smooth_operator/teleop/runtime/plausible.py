"""Plausibility of a frame: size of the hand, side, and time in seconds."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.io.anatomy import PALM_RANGE_M, Doubt, HandCheck
from smooth_operator.landmarks import BASES, WRIST
from smooth_operator.teleop.sources.live import LATEST_STAMP_S, Arrival
from smooth_operator.types import HandFrame, Side

REACH_M = 0.5
"""Largest distance of a landmark from the wrist, along any axis [m]."""
_FAR = (
    f"a landmark more than {REACH_M:g} m from the wrist is no human's; landmarks must be in metres"
)

CURL = -0.6
"""Smallest curl of a hand, as a share of its fingers' length.

In four real recordings and the synthetic operator, fingers bent back to their limit reach -0.51. A
mirrored hand has the negative curl: it is refused at its first frame near a fist, or else by
``SessionCheck``, whose rule is stricter and needs several frames.
"""

_PALM: Final = "a palm outside {} to {} m is no human's; landmarks must be in metres".format(
    *PALM_RANGE_M
)
_MIDDLE: Final = BASES[2]


@np.errstate(all="ignore")  # numbers of any size may come
def implausible(frame: HandFrame) -> str | None:
    """Reason why a frame can't be a human hand of its side; None if it can.

    Missing landmarks are not judged, since not every method needs them. The reasons are few and
    without figures, so that frames can be counted by reason.
    """
    if frame.stamp is not None and not abs(frame.stamp) < LATEST_STAMP_S:
        return "a stamp that is no time in seconds"
    p = frame.landmarks
    if (np.abs(p[frame.valid] - p[WRIST]) > REACH_M).any():
        return _FAR
    palm = float(np.linalg.norm(p[_MIDDLE] - p[WRIST]))
    if not np.isfinite(palm):
        return None
    if not PALM_RANGE_M[0] <= palm <= PALM_RANGE_M[1]:
        return _PALM
    curl = finger_curl(p, frame.side)
    if curl < CURL:
        other = "left" if frame.side == "right" else "right"
        return f"the fingers bend to the back of the hand: is it a {other} hand?"
    return None


class SessionCheck:
    """Checks that a tracker's frames have the right side and order of landmarks.

    Each start of a tracker is checked separately: over its first frames, and then occasionally.

    Args:
        side: side of the robot hand.
    """

    def __init__(self, side: Side) -> None:
        self._side = side
        self._session: int | None = None
        self._check = HandCheck(side)

    def doubt(self, arrival: Arrival) -> Doubt | None:
        """The doubt about the frames up to this one; None if there is none."""
        if arrival.session != self._session:
            self._session, self._check = arrival.session, HandCheck(self._side)
        frame = arrival.frame
        assert frame.valid is not None  # filled in by HandFrame
        return self._check.see(frame.landmarks, frame.valid)


def finger_curl(landmarks: Float[np.ndarray, "21 3"], side: Side) -> float:
    """Distance of the fingertips in front of the palm, as a share of the fingers' length.

    It judges a single frame, while ``chirality`` of ``smooth_operator.io.anatomy`` needs several.

    Args:
        landmarks: positions in the project's order, in any right-handed frame.

    Returns:
        mean over the four fingers: 0 for a flat hand, towards 1 for a fist, negative for fingers
        bent back; NaN with a missing landmark.
    """
    wrist, bases, tips = landmarks[0], landmarks[5::4], landmarks[8::4]
    normal = np.cross(bases[0] - wrist, bases[3] - wrist) * (1.0 if side == "right" else -1.0)
    length = np.linalg.norm(normal)
    if not length > 1e-9:
        return float("nan")
    bones = np.linalg.norm(np.diff(landmarks[5:].reshape(4, 4, 3), axis=1), axis=-1).sum(axis=1)
    return float(((tips - bases) @ normal / length / np.maximum(bones, 1e-9)).mean())
