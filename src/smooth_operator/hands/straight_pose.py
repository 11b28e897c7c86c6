"""Pose of a robot hand with straight fingers, and the fingers' lengths."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, TIPS

_STEPS: Final = 33
_ROUNDS: Final = 3
_GAIN: Final = 1e-6  # smallest gain in reach that moves a joint off neutral [m]


class StraightPose(NamedTuple):
    """A hand with its fingers straight.

    Attributes:
        q: (m,) the pose [rad].
        reach: (F,) distances from base to tip [m].
        rays: (F, 3) vectors from base to tip, palm frame [m].
    """

    q: Float[np.ndarray, " m"]
    reach: Float[np.ndarray, " F"]
    rays: Float[np.ndarray, "F 3"]


def straight_pose(hand: Hand) -> StraightPose:
    """The pose in which all fingers reach furthest from their bases, nearest to neutral.

    A coordinate search over the joints' ranges, repeated ``_ROUNDS`` times. A joint that does not
    extend the reach, such as a spread, stays at neutral.
    """
    q = hand.neutral.copy()
    for _ in range(_ROUNDS):
        for joint, (low, high) in enumerate(hand.limits):
            trial = np.tile(q, (_STEPS + 1, 1))
            trial[1:, joint] = np.linspace(low, high, _STEPS)
            total = np.linalg.norm(_rays(hand, trial), axis=-1).sum(axis=-1)
            best = int(np.argmax(total))
            if total[best] > total[0] + _GAIN:
                q = trial[best]
    directions = _rays(hand, q)
    return StraightPose(q, np.linalg.norm(directions, axis=-1), directions)


def open_rays(hand: Hand) -> Float[np.ndarray, "F 3"]:
    """(F, 3) vectors from base to tip of the open hand, palm frame [m].

    Its joints are at zero, or as near as their limits allow: there makers put the open hand. At the
    neutral pose, and so at ``straight_pose``, many hands have bent knuckles.
    """
    return _rays(hand, np.clip(0.0, *hand.limits.T))


def _rays(hand: Hand, q: Float[np.ndarray, "*n m"]) -> Float[np.ndarray, "*n F 3"]:
    names, points = hand.tree.names, hand.landmark_positions(q)
    fingers = [FINGERS.index(name) for name in hand.fingers]
    tips = [names.index(LANDMARKS[TIPS[i]]) for i in fingers]
    bases = [names.index(LANDMARKS[BASES[i]]) for i in fingers]
    return np.asarray(points[..., tips, :] - points[..., bases, :])
