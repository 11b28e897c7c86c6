"""Posture: does the robot hand open and close with the human's hand, and move as much?

All metrics are computed from landmarks only and do not depend on the size of either hand. The
extension of a finger is the distance from its base to its tip, divided by its longest possible
value: for the human the sum of its bones, for the robot the length of the straight finger. The gain
of a finger is the ratio of these lengths, robot to human: a robot finger that is twice as long
moves its tip twice as far when it bends equally, but as far as the human's in a pinch. Therefore
the correct step lies between the human's step and gain times that step. A jump exceeds both, and a
stall is below both.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.metrics import summary
from smooth_operator.retargeting.palm import unit_vectors

FLAT: Final = 0.92
"""Smallest extension of all long fingers of a flat hand."""
FIST: Final = 0.6
"""Largest extension of all long fingers of a fist."""
JUMP: Final = 0.012
"""Excess of a robot's fingertip step over the human's step, and over gain times that step, that
counts as a jump [m]."""
LARGE_STEP: Final = 0.003
"""Smallest large step of a human fingertip in one frame [m]."""
STALLED: Final = 1 / 3
"""Fraction of a large human step below which the robot's step is a stall."""
CLOSED: Final = 0.65
OPENED: Final = 0.88
OPENING_TIME: Final = 0.25
"""Longest time in which the extension of a quickly opening human finger rises from ``CLOSED`` to
``OPENED`` [s]."""
SETTLED: Final = 0.04
SETTLED_FOR: Final = 0.1
"""A robot finger has settled when its extension has stayed within ``SETTLED`` of the human's for
this time [s]."""
LONGEST_SETTLING: Final = 0.8
"""Settling time of a finger that has not settled by then [s]."""
_TINY: Final = 1e-9


def human_extensions(fingers: Float[np.ndarray, "T L 4 3"]) -> Float[np.ndarray, "T L"]:
    """Extension of human fingers; 1 means straight.

    Args:
        fingers: (T, L, 4, 3) landmarks of L fingers, base to tip [m].
    """
    return np.asarray(_lengths(fingers) / np.maximum(_bone_lengths(fingers), _TINY))


def robot_extensions(
    fingers: Float[np.ndarray, "T L 4 3"], straight: Float[np.ndarray, " L"]
) -> Float[np.ndarray, "T L"]:
    """Extension of robot fingers with four points each [m]: their base-to-tip distance divided by
    the (L,) base-to-tip distance of the straight fingers [m]."""
    return np.asarray(_lengths(fingers) / straight)


def extension_error(
    human: Float[np.ndarray, "T L"], robot: Float[np.ndarray, "T L"]
) -> float | None:
    """Mean absolute difference between human and robot extensions; lower is better. None without
    data."""
    return summary.mean(np.abs(robot - human))


def flat_extension_lack(
    human: Float[np.ndarray, "T L"], robot: Float[np.ndarray, "T L"]
) -> float | None:
    """How much less the robot's fingers are extended than the human's while the human hand is flat,
    on average; lower is better. None if the human hand is never flat."""
    flat = (human > FLAT).all(axis=-1)  # NaN compares as False
    return summary.mean(np.maximum(human - robot, 0.0)[flat])


def fist_extension_excess(
    human: Float[np.ndarray, "T L"], robot: Float[np.ndarray, "T L"]
) -> float | None:
    """How much farther the robot's fingers are extended than the human's while the human hand makes
    a fist, on average; lower is better. None if the human hand never makes a fist."""
    fist = (human < FIST).all(axis=-1)
    return summary.mean(np.maximum(robot - human, 0.0)[fist])


def direction_errors(
    human: Float[np.ndarray, "T F 4 3"], robot: Float[np.ndarray, "T F 4 3"]
) -> Float[np.ndarray, "T F"]:
    """Angle between the base-to-tip vectors of the human hand, aligned to the palm, and those of
    the robot hand [degrees]."""
    h, r = (unit_vectors(x[:, :, 3] - x[:, :, 0], np) for x in (human, robot))
    return np.asarray(np.degrees(np.arccos(np.clip((h * r).sum(axis=-1), -1, 1))))


def curls(fingers: Float[np.ndarray, "T F 4 3"]) -> Float[np.ndarray, "T F"]:
    """Sum of the two angles between neighbouring bones of each finger [degrees].

    Args:
        fingers: (T, F, 4, 3) points of F fingers, base to tip [m].
    """
    bones = unit_vectors(np.diff(fingers, axis=2), np)
    cosines = (bones[:, :, 1:] * bones[:, :, :-1]).sum(axis=-1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1, 1))).sum(axis=-1))


def spreads(
    fingers: Float[np.ndarray, "T L 4 3"], across: Float[np.ndarray, "T 3"]
) -> Float[np.ndarray, "T N"]:
    """Sideways angle between neighbouring fingers, in the plane of the palm [degrees]; ``across``
    is the direction across the palm."""
    directions = unit_vectors(fingers[:, :, 3] - fingers[:, :, 0], np)
    sideways = (directions * unit_vectors(across, np)[:, None]).sum(axis=-1)
    return np.asarray(np.diff(np.degrees(np.arcsin(np.clip(sideways, -1, 1))), axis=1))


def steps(tips: Float[np.ndarray, "T F 3"]) -> Float[np.ndarray, "S F"]:
    """Distance that each fingertip moves from one frame to the next [m]."""
    return np.asarray(np.linalg.norm(np.diff(tips, axis=0), axis=-1))


def finger_gains(
    human: Float[np.ndarray, "T F 4 3"], straight: Float[np.ndarray, " F"]
) -> Float[np.ndarray, " F"]:
    """(F,) ratio of each robot finger's straight length [m] to that of the human finger, which is
    the sum of its median aligned bone lengths [m]; NaN if the human hand was never seen."""
    bones = _bone_lengths(human)
    seen = bones[np.isfinite(bones).all(axis=1)]
    if not len(seen):
        return np.full(len(straight), np.nan)
    return np.asarray(straight / np.maximum(np.median(seen, axis=0), _TINY))


def jumps_per_1000(
    human: Float[np.ndarray, "S F"], robot: Float[np.ndarray, "S F"], gains: Float[np.ndarray, " F"]
) -> float | None:
    """Number of frames per thousand in which a fingertip jumps (``JUMP``), from (S, F) steps [m]
    and the fingers' gains; lower is better. None without data."""
    longest = np.maximum(gains, 1.0) * human
    known = np.isfinite(longest).all(axis=-1)
    return summary.scaled(summary.mean((robot - longest > JUMP).any(axis=-1)[known]), 1e3)


def step_gains(
    human: Float[np.ndarray, "S F"], robot: Float[np.ndarray, "S F"]
) -> Float[np.ndarray, "S F"]:
    """Ratio of robot step to human step for large human steps (``LARGE_STEP``), otherwise NaN."""
    large = human > LARGE_STEP
    return np.where(large, robot / np.where(large, human, 1.0), np.nan)


def stalled_share(gains: Float[np.ndarray, "S F"]) -> float | None:
    """Fraction of large human steps of which the robot follows less than a third; best at 0."""
    return summary.mean((gains < STALLED)[np.isfinite(gains)])


def settling_times(
    human: Float[np.ndarray, "T L"],
    robot: Float[np.ndarray, "T L"],
    stamps: Float[np.ndarray, " T"],
) -> Float[np.ndarray, " n"]:
    """Settling time of a robot finger after each quick opening of the human's finger.

    An opening is a rise of the human's extension from under ``CLOSED`` to over ``OPENED`` in at
    most ``OPENING_TIME``. The time runs from the frame that is over ``OPENED`` to the first frame
    from which the robot's extension stays within ``SETTLED`` of the human's for ``SETTLED_FOR``.

    Args:
        human: (T, L) extensions.
        robot: (T, L) extensions.
        stamps: (T,) times [s].

    Returns:
        (n,) of all fingers' openings [s], at most ``LONGEST_SETTLING``; lower is better. Openings
        too close to the end of the run are excluded.
    """
    times = []
    for own, answer in zip(human.T, robot.T, strict=True):
        low = np.maximum.accumulate(np.where(own < CLOSED, stamps, -np.inf))
        rises = (own[1:] > OPENED) & ~(own[:-1] > OPENED) & (stamps[1:] - low[1:] <= OPENING_TIME)
        apart = ~(np.abs(answer - own) <= SETTLED)  # NaN counts as apart
        ends = np.where(apart, stamps, stamps[-1:])  # the next frame apart, or the last
        until = np.minimum.accumulate(ends[::-1])[::-1]
        settled = ~apart & (until - stamps >= SETTLED_FOR - _TINY)
        before = -np.inf
        for k in np.flatnonzero(rises) + 1:
            if low[k] < before:  # it has not been closed since the last opening
                continue
            before = stamps[k]
            first = stamps[k:][settled[k:]]
            if len(first):
                times.append(min(float(first[0] - stamps[k]), LONGEST_SETTLING))
            elif stamps[-1] - stamps[k] >= LONGEST_SETTLING:
                times.append(LONGEST_SETTLING)
    return np.array(times)


def common_shift(
    human: Float[np.ndarray, "T F 3"], robot: Float[np.ndarray, "T F 3"]
) -> float | None:
    """Length of the error of the aligned wrist-to-tip vectors, averaged first over fingers and then
    over frames [m]."""
    return summary.mean(np.linalg.norm((robot - human).mean(axis=1), axis=-1))


def _bone_lengths(fingers: Float[np.ndarray, "T L 4 3"]) -> Float[np.ndarray, "T L"]:
    return np.asarray(np.linalg.norm(np.diff(fingers, axis=2), axis=-1).sum(axis=-1))


def _lengths(fingers: Float[np.ndarray, "T L 4 3"]) -> Float[np.ndarray, "T L"]:
    return np.asarray(np.linalg.norm(fingers[:, :, 3] - fingers[:, :, 0], axis=-1))
