"""Finds the joints that bend or spread a finger, from the circle on which each moves the tip."""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.hands.hand import Hand

SHORTER: Final = 1e-3
"""Least difference by which a finger counts as shorter than in another pose [m]."""

_MOVES: Final = 1e-3  # least way of a fingertip by a joint of its finger [m]
_PARALLEL: Final = 0.9  # cosine between the axes of two joints
_POSES: Final = 101


class Bend(NamedTuple):
    """A joint beyond the knuckle of a long finger that can bend the finger backwards past straight.

    Attributes:
        finger: the finger's row among the hand's.
        joint: number of the joint.
        longest: joint position in which the finger is longest [rad].
        length: the finger's length from the knuckle at the limit next to ``longest`` [m]; other
            joints as in the straight hand.
        centre: (3,) the knuckle, from the wrist [m].
    """

    finger: int
    joint: int
    longest: float
    length: float
    centre: Float[np.ndarray, "3"]


@lru_cache(maxsize=8)
def bends_past_straight(hand: Hand) -> list[Bend]:
    """Joints that bend a finger back past straight, which shortens it by over a millimetre."""
    bends = []
    for f, (name, circles) in enumerate(zip(hand.fingers, _circles(hand), strict=True)):
        parallel = [one for one in circles if abs(one.axis @ circles[-1].axis) > _PARALLEL]
        if len(parallel) < 2 or name == "thumb":  # the thumb's other joint moves about
            continue
        centre = parallel[0].centre
        for one in parallel[1:]:
            length = np.linalg.norm(one.tips - centre, axis=-1)
            longest = int(np.argmax(length))
            if longest < _POSES // 2 and length[longest] - length[0] > SHORTER:
                angle = float(one.angles[longest])
                bends.append(Bend(f, one.joint, angle, float(length[0]), centre))
    return bends


def spread_joints(hand: Hand) -> Bool[np.ndarray, " m"]:
    """(m,) mask of the actuated joints that move a long finger sideways: their axis is
    perpendicular to that of the joint that folds the finger most."""
    spread, (thumb, *fingers) = np.zeros(len(hand.limits), bool), _circles(hand)
    for circles in filter(None, fingers):
        fold = max(circles, key=lambda one: np.ptp(np.linalg.norm(one.tips, axis=-1)))
        spread[[one.joint for one in circles if abs(one.axis @ fold.axis) < _PARALLEL]] = True
    spread[[one.joint for one in thumb]] = False
    return spread


class _Circle(NamedTuple):
    """Circle of a fingertip about an actuated joint of the straight hand: radius [m], centre from
    the robot's wrist [m], unit axis, number of the joint, its (N,) positions [rad], and the (N, 3)
    fingertips at these from the wrist [m]."""

    radius: float
    centre: np.ndarray
    axis: np.ndarray
    joint: int
    angles: np.ndarray
    tips: np.ndarray


@lru_cache(maxsize=8)
def _circles(hand: Hand) -> tuple[list[_Circle], ...]:
    """For each finger, the circles of its tip about the joints that move it, the largest first."""
    circles: tuple[list[_Circle], ...] = tuple([] for _ in hand.fingers)
    for joint, (low, high) in enumerate(hand.limits):
        q = np.tile(hand.straight_pose.q, (_POSES, 1))
        q[:, joint] = angles = np.linspace(low, high, _POSES)
        every = hand.tips(hand.full_configuration(q)) - hand.wrist
        for own, tips in zip(circles, np.swapaxes(every, 0, 1), strict=True):
            if np.ptp(tips, axis=0).max() > _MOVES:
                own.append(_Circle(*_circle(tips), joint, angles, tips))
    for own in circles:
        own.sort(key=lambda one: -one.radius)
    return circles


def _circle(points: Float[np.ndarray, "N 3"]) -> tuple[float, np.ndarray, np.ndarray]:
    """Radius, centre and axis of the circle on which points lie."""
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle)[2]
    flat = (points - middle) @ axes[:2].T
    rows = np.column_stack([2 * flat, np.ones(len(flat))])
    solution = np.linalg.lstsq(rows, (flat**2).sum(axis=-1), rcond=None)[0]
    radius = float(np.sqrt(solution[2] + solution[:2] @ solution[:2]))
    return radius, middle + solution[:2] @ axes[:2], axes[2]
