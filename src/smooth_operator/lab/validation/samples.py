"""Random poses of a hand and where they put its landmarks, computed once for several checks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS

_POSES: Final = 800


@dataclass(frozen=True, eq=False)
class Samples:
    """A hand in random poses, uniform within its limits; collisions are not looked at.

    Attributes:
        hand: the hand.
    """

    hand: Hand

    @cached_property
    def poses(self) -> Float[np.ndarray, "s m"]:
        """Positions of the actuated joints [rad]."""
        low, high = self.hand.limits[:, 0], self.hand.limits[:, 1]
        return np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))

    @cached_property
    def landmarks(self) -> Float[np.ndarray, "s k 3"]:
        """Landmarks in the palm frame [m], as the hand's tree orders them."""
        return self.hand.landmark_positions(self.poses)

    @cached_property
    def tips(self) -> Float[np.ndarray, "s f 3"]:
        """Fingertips in the palm frame [m], thumb first."""
        names = self.hand.tree.names
        return self.landmarks[:, [names.index(name) for name in self.hand.tip_names]]

    @cached_property
    def bases(self) -> Float[np.ndarray, "s f 3"]:
        """Finger bases in the palm frame [m], thumb first."""
        names = self.hand.tree.names
        bases = [LANDMARKS[BASES[FINGERS.index(finger)]] for finger in self.hand.fingers]
        return self.landmarks[:, [names.index(name) for name in bases]]


def movers(hand: Hand, landmark: str) -> tuple[int, ...]:
    """The joints, as indices into all joints, that move a landmark, palm to tip."""
    out: list[int] = []
    joint = hand.tree.keypoints[landmark].joint
    while joint >= 0:
        out.insert(0, hand.tree.joints[joint].source)
        joint = hand.tree.joints[joint].parent
    return tuple(out)
