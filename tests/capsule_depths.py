"""How deep the capsules of a hand are in each other, for tests."""

import numpy as np

from smooth_operator.hands.capsules import CapsulePairs, segments_apart
from smooth_operator.hands.hand import Hand


def ends_of(pairs: CapsulePairs, hand: Hand, q: np.ndarray) -> np.ndarray:
    """(..., 2 C, 3) ends of the capsules at poses of the actuated joints."""
    points = np.asarray(pairs.tree.positions(hand.full_configuration(q)))
    return points[..., [pairs.tree.names.index(name) for name in pairs.names], :]


def depths(pairs: CapsulePairs, ends: np.ndarray) -> np.ndarray:
    """(..., P) depth of each pair [m]."""
    one, other = ((ends[..., 2 * c, :], ends[..., 2 * c + 1, :]) for c in pairs.pairs.T)
    apart, _, _ = segments_apart(one, other)
    return pairs.reach - np.linalg.norm(apart, axis=-1)
