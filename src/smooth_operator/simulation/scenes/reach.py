"""Where a hand's fingertips can be: by it objects are placed, so that any hand has its scenes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import HandModelError
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.hand_directions import hand_directions

_POSES = 20_000


def reachable(hand: Hand) -> Float[np.ndarray, "s f 3"]:
    """(s, f, 3) fingertips in random poses: distal, radial and palmar from the wrist [m].

    The same poses every time, so that a hand's scene is always the same.
    """
    low, high = hand.limits.T
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    tips = hand.tips(hand.full_configuration(poses)) - hand.wrist
    return np.asarray(tips @ hand_directions(hand).T)


def opposition(
    hand: Hand, finger: str, gap: float, *, tolerance: float = 0.006
) -> Float[np.ndarray, "k 3"]:
    """(k, 3) midpoints between the thumb's tip and another's where they are ``gap`` apart [m].

    Raises:
        HandModelError: they hardly ever are: the hand can't hold a thing of that size so.
    """
    tips = reachable(hand)
    thumb, other = tips[:, 0], tips[:, hand.fingers.index(finger)]
    near = np.abs(np.linalg.norm(other - thumb, axis=1) - gap) < tolerance
    if near.sum() < 20:
        raise HandModelError(
            f"hand {hand.name!r}: thumb and {finger} can't take hold of something "
            f"{1e3 * gap:.0f} mm thick; choose another task or hand"
        )
    return np.asarray((thumb + other)[near] / 2)
