"""Pinches: do the robot's thumb and finger touch where the human's do, without going too deep?

Landmarks of a fingertip lie inside the finger, where two touching pads are 6 to 10 mm apart. So the
surfaces of the last links are measured (``smooth_operator.hands.surfaces``).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.metrics import summary

PINCH_DISTANCE: Final = 0.012
"""Distance of the human's thumb tip and fingertip below which the human pinches [m]. It counts
after alignment, on the robot's scale."""
TOUCH_DISTANCE: Final = 0.001
"""Distance of two surfaces below which they touch [m]."""
DEEP: Final = 0.002
"""Depth beyond which two surfaces are too deep in each other [m]."""


def pinched_frames(tips: Float[np.ndarray, "T F 3"]) -> Bool[np.ndarray, "T f"]:
    """(T, F - 1) True where the human pinches with a finger.

    Args:
        tips: (T, F, 3) aligned human fingertips, thumb first [m].
    """
    gaps = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1)
    return np.asarray(gaps < PINCH_DISTANCE)  # NaN compares as False


def touching_share(distances: Float[np.ndarray, "..."]) -> float | None:
    """Share of pinches in which the robot's surfaces touch; towards 1. None without a pinch.

    Args:
        distances: distance of the surfaces in each pinch [m]; NaN where there is none.
    """
    return summary.mean((distances < TOUCH_DISTANCE)[np.isfinite(distances)])


def deep_share(distances: Float[np.ndarray, "..."]) -> float | None:
    """Share of pinches in which the surfaces are too deep in each other; towards 0."""
    return summary.mean((distances < -DEEP)[np.isfinite(distances)])
