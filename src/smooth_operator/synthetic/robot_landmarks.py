"""Landmarks of a robot hand in the layout of a human hand."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS
from smooth_operator.retargeting.alignment import palm_alignment
from smooth_operator.synthetic.hand_anatomy import NUM_JOINTS, draw_anatomy, mirror, pose_hand


def human_landmarks(hand: Hand, q: Float[np.ndarray, "T m"]) -> Float[np.ndarray, "T 21 3"]:
    """Landmarks of a robot hand in the layout of a human hand, in the palm frame [m].

    A missing point of a robot finger is put on the line between its neighbours. A missing finger is
    taken from a flat synthetic hand that is aligned to the robot's palm. Methods do not use these
    points, unless the hand's description makes a joint follow them.

    Args:
        q: (T, m) positions of the actuated joints [rad].

    Returns:
        (T, 21, 3) landmarks [m], all finite.
    """
    flat = pose_hand(draw_anatomy(0.19, 0), np.zeros((1, NUM_JOINTS)))
    flat = flat if hand.spec.side == "right" else mirror(flat)
    human = palm_alignment(flat.landmarks[0], hand).apply(flat.landmarks[0])
    points = np.broadcast_to(human, (len(q), *human.shape)).copy()
    indices = [LANDMARKS.index(name) for name in hand.tree.names]
    points[:, indices] = hand.landmark_positions(q)
    for name in hand.fingers:
        first = BASES[FINGERS.index(name)]
        own = [i for i in range(first, first + 4) if i in indices]
        for i in set(range(first, first + 4)) - set(own):
            below, above = max(k for k in own if k < i), min(k for k in own if k > i)
            share = (i - below) / (above - below)
            points[:, i] = (1 - share) * points[:, below] + share * points[:, above]
    return points
