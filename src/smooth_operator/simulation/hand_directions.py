"""Orthogonal directions of a hand: distal, radial, palmar."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.human.flat_hand import human_palm_axes


def hand_directions(hand: Hand) -> Float[np.ndarray, "3 3"]:
    """Rows: distal, radial and palmar in the palm frame, at right angles to each other."""
    distal, radial, palmar = human_palm_axes(hand)
    distal = np.asarray(distal) / np.linalg.norm(distal)
    palmar = np.asarray(palmar) - (palmar @ distal) * distal
    palmar /= np.linalg.norm(palmar)
    side = np.cross(distal, palmar)
    return np.stack([distal, side * np.sign(side @ radial), palmar])
