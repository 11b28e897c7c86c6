"""Consistency: does the robot move in the same direction as the human, smoothly and without
delay?"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from smooth_operator.metrics import summary

HUMAN_STILL: Final = 2e-4
"""Largest motion of a resting human fingertip in one frame [m]."""
ROBOT_STILL: Final = 1e-9
"""Largest motion of a resting robot fingertip in one frame [m]."""
JOINTS_STILL: Final = 1e-5
"""Largest motion of any joint of a frozen robot in one frame [rad]."""
REST_RANGE: Final = 0.008
REST_TIME: Final = 0.6
"""A human fingertip rests while none of its coordinates, from the wrist, covers more than
``REST_RANGE`` [m] in ``REST_TIME`` [s]."""
LEAST_RESTING: Final = 50
"""Fewest fingertip steps at rest that are measured."""
_NOWHERE: Final = 1e3  # a coordinate that no hand has [m]
MAX_LAG_FRAMES: Final = 14
"""Longest delay that ``lag`` searches [frames]."""
MIN_LAG_OVERLAP: Final = 5
"""Smallest number of velocity frames for a delay; fewer frames correlate by chance."""


def motion_preservation(
    human: Float[np.ndarray, "T F 3"], robot: Float[np.ndarray, "T F 3"]
) -> float | None:
    """Mean cosine between human and robot steps of the (T, F, 3) vectors from wrist to tip [m];
    best at 1. None if the two hands never move at the same time.

    Source: the paper's consistency metrics. Steps in which either hand rests (``HUMAN_STILL``,
    ``ROBOT_STILL``) have no meaningful direction and are excluded.
    """
    dh, dr = np.diff(human, axis=0), np.diff(robot, axis=0)
    lh, lr = np.linalg.norm(dh, axis=-1), np.linalg.norm(dr, axis=-1)
    moving = (lh > HUMAN_STILL) & (lr > ROBOT_STILL)  # NaN compares as False
    return summary.mean(np.sum(dh * dr, axis=-1)[moving] / (lh * lr)[moving])


def shake_at_rest(
    human: Float[np.ndarray, "T F 3"],
    robot: Float[np.ndarray, "T F 3"],
    stamps: Float[np.ndarray, " T"],
) -> float | None:
    """Ratio of robot to human root-mean-square fingertip steps while the human's fingertip rests.

    1 means that all of the tracker's shake reaches the robot, 0 that none does; lower is better.

    Args:
        human: (T, F, 3) human wrist to tip vectors [m], NaN where unknown.
        robot: (T, F, 3) robot wrist to tip vectors [m].
        stamps: (T,) times [s].

    Returns:
        None if the human's fingertips hardly ever rest, or rest without any motion.
    """
    if len(stamps) < 2:
        return None
    size = 2 * round(0.5 * REST_TIME / float(np.median(np.diff(stamps)))) + 1
    known = np.where(np.isfinite(human), human, _NOWHERE)
    top, bottom = maximum_filter1d(known, size, axis=0), minimum_filter1d(known, size, axis=0)
    resting = ((top - bottom).max(axis=2) < REST_RANGE) & (top.max(axis=2) < _NOWHERE)
    steps = resting[1:] & resting[:-1]
    if steps.sum() < LEAST_RESTING:
        return None
    own, answer = (np.square(np.diff(x, axis=0)[steps]).mean() for x in (human, robot))
    return float(np.sqrt(answer / own)) if own > 0 else None


def flatness(tips: Float[np.ndarray, "T F 3"]) -> float | None:
    """Mean |p(t+1) + p(t-1) - 2 p(t)|^2 over frames and fingertips [m^2]; lower is better.
    None for fewer than three frames.

    Source: the paper's consistency metrics. It grows with the fourth power of the frame's duration:
    compare at one rate only, or use ``fingertip_acceleration``.
    """
    return summary.mean(np.sum(_second_difference(tips) ** 2, axis=-1))


def fingertip_acceleration(
    tips: Float[np.ndarray, "T F 3"], stamps: Float[np.ndarray, " T"]
) -> float | None:
    """Mean magnitude of fingertip acceleration [m/s^2], from the real timestamps [s]; lower is
    better. None for fewer than three frames.

    Unlike ``flatness``, it does not depend on the frame rate. It is exact for motion of constant
    acceleration, evenly sampled or not.
    """
    return summary.mean(np.linalg.norm(second_derivative(tips, stamps), axis=-1))


def lag(
    human: Float[np.ndarray, "T F 3"],
    robot: Float[np.ndarray, "T F 3"],
    stamps: Float[np.ndarray, " T"],
) -> tuple[float | None, float | None]:
    """Returns the delay that best aligns human and robot fingertip velocities, and their
    correlation at that delay.

    The velocity correlation is taken at each whole delay from 0 to ``MAX_LAG_FRAMES``; a parabola
    through the best one and its neighbours refines it, except at either end: a result of exactly
    ``MAX_LAG_FRAMES`` means "that or more". Frames are converted to time by the median frame
    duration, so lost frames make the lag less exact.

    Args:
        human: (T, F, 3) human wrist to tip vectors [m], NaN where unknown.
        robot: (T, F, 3) robot wrist to tip vectors [m].
        stamps: (T,) times [s].

    Returns:
        The lag [ms] (lower is better) and the Pearson correlation at the best whole delay (best at
        1); both None for fewer than ``MIN_LAG_OVERLAP`` + 1 frames, or if either hand rests.
    """
    vh, vr = np.diff(human, axis=0), np.diff(robot, axis=0)
    steps = len(vh)
    delays = range(min(MAX_LAG_FRAMES, steps - MIN_LAG_OVERLAP) + 1)
    c = np.array([_correlation(vh[: steps - d], vr[d:]) for d in delays])
    if not np.isfinite(c).any():
        return None, None
    k = int(np.nanargmax(c))
    frames = float(k)
    if 0 < k < MAX_LAG_FRAMES and k + 1 < len(c):
        bend = c[k - 1] - 2 * c[k] + c[k + 1]
        if bend < 0:  # False for NaN neighbours and for a plateau
            frames += 0.5 * (c[k - 1] - c[k + 1]) / bend
    return float(frames * 1e3 * np.median(np.diff(stamps))), float(c[k])


def frozen_share(
    human: Float[np.ndarray, "T F 3"], joint_positions: Float[np.ndarray, "T n"]
) -> float | None:
    """Fraction of the frames in which the human moves but no robot joint does; lower is better.
    None if the human never moves.

    The human moves if any fingertip moves further than ``HUMAN_STILL`` in a frame; the robot is
    frozen if no joint moves further than ``JOINTS_STILL``.
    """
    moving = (np.linalg.norm(np.diff(human, axis=0), axis=-1) > HUMAN_STILL).any(axis=-1)
    frozen = np.all(np.abs(np.diff(joint_positions, axis=0)) <= JOINTS_STILL, axis=-1)
    return summary.mean(np.asarray(frozen)[moving])


def second_derivative(
    values: Float[np.ndarray, "T ..."], stamps: Float[np.ndarray, " T"]
) -> Float[np.ndarray, "S ..."]:
    """(T - 2, ...) second derivative over time [unit/s^2] at the inner frames of unevenly sampled
    values; empty for fewer than three frames."""
    h = np.diff(stamps).reshape(-1, *[1] * (values.ndim - 1))
    slope = np.diff(values, axis=0) / h
    return np.asarray(2.0 * np.diff(slope, axis=0) / (h[1:] + h[:-1]))


def _second_difference(values: Float[np.ndarray, "T ..."]) -> Float[np.ndarray, "S ..."]:
    return np.asarray(values[2:] + values[:-2] - 2.0 * values[1:-1])


def _correlation(a: Float[np.ndarray, "..."], b: Float[np.ndarray, "..."]) -> float:
    finite = np.isfinite(a) & np.isfinite(b)
    a, b = a[finite], b[finite]
    if a.size < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return float("nan")
    return float(np.corrcoef(a, b)[0, 1])
