"""The Smooth Operator paper's own definitions of three metrics, where they differ from this
package's (``sound``).

- Each frame, the human hand is fitted (rotation, translation, scale) to the robot's *own pose* with
  the wrist, the palm landmarks, and the last joint and the tip of each finger: 14 landmarks on the
  paper's hand, whose palm landmarks are the bases of thumb, index and pinky. The retargeters align
  the two hands with the palm landmarks only. The fit absorbs part of the error that should be
  measured.
- The headline cosine similarity and scale ratio are medians over frames and thumb vectors, which
  hide frames with large errors.
- Motion preservation keeps still frames and adds 1e-8 m^2 to the product of the step lengths, so
  that a perfect copy of slow or densely sampled motion scores below 1.

Flatness, workspace utilisation and latency are the same in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.geometry import umeyama
from smooth_operator.landmarks import FINGERS, TIPS, WRIST
from smooth_operator.metrics import summary

_EPSILON: Final = 1e-8  # [m] or [m^2], as published


def cosine_similarity(
    human: Float[np.ndarray, "T K 3"], robot: Float[np.ndarray, "T K 3"]
) -> float | None:
    """Median over frames and keyvectors of v_H . v_R / (|v_H| |v_R| + 1e-8); best at 1."""
    return summary.median(_cosines(human, robot))


def scale_ratio(
    human: Float[np.ndarray, "T K 3"], robot: Float[np.ndarray, "T K 3"]
) -> float | None:
    """Median over frames and keyvectors of |v_R| / (|v_H| + 1e-8); best at 1."""
    length = np.linalg.norm(human, axis=-1)
    return summary.median(np.linalg.norm(robot, axis=-1) / (length + _EPSILON))


def motion_preservation(
    human_tips: Float[np.ndarray, "T F 3"], robot_tips: Float[np.ndarray, "T F 3"]
) -> float | None:
    """Mean of dp_H . dp_R / (|dp_H| |dp_R| + 1e-8) over all frames and fingertips; best at 1."""
    return summary.mean(_cosines(np.diff(human_tips, axis=0), np.diff(robot_tips, axis=0)))


def fit_landmarks(fingers: Sequence[str], palm: Sequence[int]) -> tuple[int, ...]:
    """Indices of the landmarks that the published fit uses: wrist, palm landmarks, last joint and
    tip of each finger, in the order of the schema."""
    tips = [TIPS[FINGERS.index(name)] for name in fingers]
    return tuple(sorted({WRIST, *palm, *tips, *(tip - 1 for tip in tips)}))


def fit_to_robot(
    human: Float[np.ndarray, "T N 3"],
    robot: Float[np.ndarray, "T N 3"],
    using: Sequence[int] | None = None,
) -> Float[np.ndarray, "T N 3"]:
    """Fits the human landmarks to the robot's in each frame, by a least-squares similarity.

    Source: Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns" (1991), Eqs. (40)-(43), over those of the chosen landmarks that both have.

    Args:
        human: (T, N, 3) human landmarks in any frame [m], NaN where unknown.
        robot: (T, N, 3) robot landmarks [m], NaN where the robot has none.
        using: indices of the landmarks that the fit may use, see ``fit_landmarks``; None for
            all.

    Returns:
        (T, N, 3) all human landmarks in the robot's frame [m]; NaN in frames with fewer than three
        common landmarks or with collinear ones.
    """
    finite = np.isfinite(human).all(axis=-1) & np.isfinite(robot).all(axis=-1)
    if using is not None:
        finite &= np.isin(np.arange(finite.shape[1]), using)
    source, target = (np.where(finite[..., None], points, 0.0) for points in (human, robot))
    fit = umeyama(source, target, weights=finite.astype(np.float64))
    return np.where((fit.condition > 1e-9)[:, None, None], fit.apply(human), np.nan)


def _cosines(a: Float[np.ndarray, "T K 3"], b: Float[np.ndarray, "T K 3"]) -> np.ndarray:
    product = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.asarray(np.clip(np.sum(a * b, axis=-1) / (product + _EPSILON), -1.0, 1.0))
