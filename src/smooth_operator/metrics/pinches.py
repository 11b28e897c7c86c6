"""Pinches: do the robot's thumb and finger touch when the human's do, without penetrating too deep?

Landmarks of a fingertip lie inside the finger, where two touching pads are 6 to 10 mm apart. So the
surfaces of the last links are measured (``smooth_operator.hands.surfaces``).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

PINCH_DISTANCE: Final = 0.012
"""Distance between the human's thumb tip and fingertip below which the human pinches [m], measured
after alignment, on the robot's scale."""
TOUCH_DISTANCE: Final = 0.001
"""Distance of two surfaces below which they touch [m]."""
LEAST_PINCHED: Final = 10
"""Smallest number of pinches (one per frame and finger) for which a fraction is reported."""
DEEP: Final = 0.002
"""Largest acceptable penetration depth of two surfaces [m]."""


def pinched_frames(tips: Float[np.ndarray, "T F 3"]) -> Bool[np.ndarray, "T f"]:
    """(T, F - 1) True where the human pinches with that finger.

    Args:
        tips: (T, F, 3) aligned human fingertips, thumb first [m].
    """
    gaps = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1)
    return np.asarray(gaps < PINCH_DISTANCE)  # NaN compares as False


def touching_share(distances: Float[np.ndarray, "..."]) -> float | None:
    """Fraction of pinches in which the robot's surfaces touch; best at 1. None for fewer than
    ``LEAST_PINCHED`` pinches.

    Args:
        distances: distance of the surfaces in each pinch [m]; NaN where there is none.
    """
    return _share_below(distances, TOUCH_DISTANCE)


def deep_share(distances: Float[np.ndarray, "..."]) -> float | None:
    """Fraction of pinches in which the robot's surfaces penetrate too deep; best at 0."""
    return _share_below(distances, -DEEP)


def _share_below(distances: Float[np.ndarray, "..."], limit: float) -> float | None:
    known = distances[np.isfinite(distances)]
    return float((known < limit).mean()) if len(known) >= LEAST_PINCHED else None
