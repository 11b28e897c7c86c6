"""Accuracy: do the robot's keyvectors have the same direction and length as the human's?"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.metrics import summary

# Floors that keep coincident points finite without moving any other value.
_AREA_FLOOR: Final = 1e-12  # [m^2]
_LENGTH_FLOOR: Final = 1e-9  # [m]


def cosines(
    human: Float[np.ndarray, "T K 3"], robot: Float[np.ndarray, "T K 3"]
) -> Float[np.ndarray, "T K"]:
    """(T, K) cosine similarity of human and robot keyvectors [m], v_H . v_R / (|v_H| |v_R|); best
    at 1, NaN where the human vector is unknown.

    Source: the paper's accuracy metrics (supplement, sim-to-real analysis).
    """
    product = np.linalg.norm(human, axis=-1) * np.linalg.norm(robot, axis=-1)
    return np.asarray(np.sum(human * robot, axis=-1) / np.maximum(product, _AREA_FLOOR))


def length_ratios(
    human: Float[np.ndarray, "T K 3"], robot: Float[np.ndarray, "T K 3"]
) -> Float[np.ndarray, "T K"]:
    """(T, K) length ratio of robot to human keyvectors [m], |v_R| / |v_H|; best at 1, NaN where the
    human vector is unknown.

    Source: the paper's accuracy metrics. A very short human vector (a pinch) makes the ratio large,
    which affects a mean over frames but not a median.
    """
    length = np.linalg.norm(human, axis=-1)
    return np.asarray(np.linalg.norm(robot, axis=-1) / np.maximum(length, _LENGTH_FLOOR))


def cosine_similarity(
    human: Float[np.ndarray, "T K 3"], robot: Float[np.ndarray, "T K 3"]
) -> float | None:
    """Mean of ``cosines`` over frames and keyvectors; best at 1, None without data."""
    return summary.mean(cosines(human, robot))


def scale_ratio(
    human: Float[np.ndarray, "T K 3"], robot: Float[np.ndarray, "T K 3"]
) -> float | None:
    """Mean of ``length_ratios`` over frames and keyvectors; best at 1, None without data."""
    return summary.mean(length_ratios(human, robot))
