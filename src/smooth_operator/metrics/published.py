"""The definitions behind the paper's own figures, where they differ from the sound ones.

- The human hand is fitted anew each frame (rotation, translation, scale) to the robot's *own
  pose* with every landmark that both have; the retargeters are driven
  through three. The fit absorbs part of the error that is to be measured.
- The headline cosine similarity and scale ratio are medians over frames and thumb vectors, which
  hide the frames that went wrong.
- Motion preservation keeps still frames and adds 1e-8 m^2 to the product of the step lengths, so
  that a perfect copy of slow or densely sampled motion scores below 1.

Flatness, workspace utilisation and latency are the same in both.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.geometry import umeyama
from smooth_operator.metrics import summary

_EPSILON: Final = 1e-8  # [m] or [m^2], as published


def cosine_similarity(
    human: Float[np.ndarray, "T K 3"], robot: Float[np.ndarray, "T K 3"]
) -> float | None:
    """Median over frames and keyvectors of v_H . v_R / (|v_H| |v_R| + 1e-8); towards 1.

    Args:
        human: (T, K, 3) human keyvectors [m], NaN where unknown.
        robot: (T, K, 3) robot keyvectors [m].
    """
    return summary.median(_cosines(human, robot))


def scale_ratio(
    human: Float[np.ndarray, "T K 3"], robot: Float[np.ndarray, "T K 3"]
) -> float | None:
    """Median over frames and keyvectors of |v_R| / (|v_H| + 1e-8); towards 1.

    Args:
        human: (T, K, 3) human keyvectors [m], NaN where unknown.
        robot: (T, K, 3) robot keyvectors [m].
    """
    length = np.linalg.norm(human, axis=-1)
    return summary.median(np.linalg.norm(robot, axis=-1) / (length + _EPSILON))


def motion_preservation(
    human_tips: Float[np.ndarray, "T F 3"], robot_tips: Float[np.ndarray, "T F 3"]
) -> float | None:
    """Mean over frames and tips of dp_H . dp_R / (|dp_H| |dp_R| + 1e-8), nothing left out; up.

    Args:
        human_tips: (T, F, 3) fitted human fingertips [m], NaN where unknown.
        robot_tips: (T, F, 3) robot fingertips [m].
    """
    return summary.mean(_cosines(np.diff(human_tips, axis=0), np.diff(robot_tips, axis=0)))


def fit_to_robot(
    human: Float[np.ndarray, "T N 3"], robot: Float[np.ndarray, "T N 3"]
) -> Float[np.ndarray, "T N 3"]:
    """Human landmarks after the least-squares similarity onto the robot's, frame by frame.

    Source: Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns" (1991), Eqs. (40)-(43), over the landmarks that both have.

    Args:
        human: (T, N, 3) human landmarks in any frame [m], NaN where unknown.
        robot: (T, N, 3) robot landmarks [m], NaN where there is none.

    Returns:
        (T, N, 3) all human landmarks in the robot's frame [m]; NaN in frames with fewer than three
        common landmarks or with collinear ones.
    """
    known = np.isfinite(human).all(axis=-1) & np.isfinite(robot).all(axis=-1)
    source, target = (np.where(known[..., None], points, 0.0) for points in (human, robot))
    fit = umeyama(source, target, weights=known.astype(np.float64))
    return np.where((fit.condition > 1e-9)[:, None, None], fit.apply(human), np.nan)


def _cosines(a: Float[np.ndarray, "T K 3"], b: Float[np.ndarray, "T K 3"]) -> np.ndarray:
    product = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.asarray(np.clip(np.sum(a * b, axis=-1) / (product + _EPSILON), -1.0, 1.0))
