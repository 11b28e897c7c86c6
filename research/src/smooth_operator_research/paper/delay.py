"""Lag in milliseconds, finer than a frame at any frame rate."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

LONGEST_S: Final = 0.25
"""Longest delay that is looked for [s]; a result near it means that or more."""

EARLIEST_S: Final = 0.04
"""How far before the human the robot is looked for [s], so that a lag of nothing is no edge."""

_STEP_S: Final = 0.002
_SHORTEST_S: Final = 0.2  # of overlap; less correlates by chance


def sub_frame_lag(
    human: Float[np.ndarray, "T F 3"],
    robot: Float[np.ndarray, "T F 3"],
    stamps: Float[np.ndarray, " T"],
) -> tuple[float, float]:
    """The delay that best aligns human and robot fingertip velocity, and how well it does.

    ``lag`` counts whole frames, refines by a parabola and
    says 0 for all that is under half a frame; at 15 Hz that is 33 ms. Here cubic splines are laid
    through the commands and through the human's motion, and their velocities are shifted against
    each other in steps of 2 ms, to either side of nothing. What both splines smooth away is the
    same, so it moves neither. The stamps are those of the frames that commands answer: neither the
    time of computing nor that of holding a command till the next is in it.

    Args:
        human: (T, F, 3) human wrist to tip vectors [m], NaN where unknown.
        robot: (T, F, 3) robot wrist to tip vectors [m].
        stamps: (T,) strictly increasing times [s].

    Returns:
        The lag [ms], negative where the robot is ahead, and the Pearson correlation there; both NaN
        where there is too little motion or time to tell.
    """
    from scipy.interpolate import CubicSpline

    known = np.isfinite(human).all(axis=(1, 2)) & np.isfinite(robot).all(axis=(1, 2))
    nothing = float("nan"), float("nan")
    if known.sum() < 8:
        return nothing
    at = stamps[known]
    longest = min(LONGEST_S, (at[-1] - at[0]) / 3)
    ahead, behind = round(EARLIEST_S / _STEP_S), int(longest / _STEP_S)
    grid = np.arange(at[0], at[-1], _STEP_S)
    count = len(grid) - ahead - behind
    if count * _STEP_S < _SHORTEST_S:
        return nothing
    leader, follower = (CubicSpline(at, hand[known])(grid, 1) for hand in (human, robot))
    velocity = leader[ahead : ahead + count]
    delays = _STEP_S * np.arange(-ahead, behind + 1)
    c = np.array([_correlation(velocity, follower[k : k + count]) for k in range(len(delays))])
    if not np.isfinite(c).all():
        return nothing
    k = int(np.argmax(c))
    delay = float(delays[k])
    if 0 < k < len(c) - 1:
        bend = c[k - 1] - 2 * c[k] + c[k + 1]
        if bend < 0:
            delay += _STEP_S * float(0.5 * (c[k - 1] - c[k + 1]) / bend)
    return 1e3 * delay, float(c[k])


def _correlation(a: Float[np.ndarray, "S F 3"], b: Float[np.ndarray, "S F 3"]) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = np.sqrt((a * a).sum() * (b * b).sum())
    return float((a * b).sum() / size) if size > 1e-12 else float("nan")
