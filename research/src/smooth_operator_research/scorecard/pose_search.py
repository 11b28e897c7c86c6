"""Search of the pose of a hand with the least cost, without collisions of its parts."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Final, NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.hands.capsules import chosen_pairs, parts_apart
from smooth_operator.hands.collision import owners
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, TIPS
from smooth_operator.retargeting.palm import unit_vectors
from smooth_operator_research.scorecard.link_surfaces import (
    PosedBodies,
    SurfacePoints,
    surface_points,
)

OVERLAP: Final = 0.001
"""Largest overlap of two parts of the hand [m]."""
TIP: Final = 0.015
"""Length of a finger's tip [m]: the part of its last link that touches."""
_NAIL: Final = -0.5  # cosine between a normal and the direction of bending, of the nail's edge
_NUDGE: Final = 0.1  # step of a joint that shows in which direction it moves the tip [rad]
_WEIGHT: Final = 10.0  # cost of an overlap beyond the limit, over a distance
_RANDOM: Final = 200  # random poses for each start
_TRIALS: Final = 4  # trials of a start in a round, over the number of starts
_ROUNDS: Final = 24
_PATIENCE: Final = 6  # rounds in which the best cost has to fall by 2 %
_WIDTH: Final = 0.2  # first standard deviation of the trials, over a joint's range
_SHRINK: Final = 0.82  # of the standard deviation in each round


class Cost(Protocol):
    """Cost of poses [m] at (T, m) positions of the actuated joints [rad]."""

    def __call__(self, q: Float[np.ndarray, "T m"], /) -> Float[np.ndarray, " T"]:
        """Returns the (T,) costs."""


def best_pose(
    hand: Hand, fingers: Iterable[str], cost: Cost, overlap: Cost, stop: float, starts: int
) -> tuple[Float[np.ndarray, " m"], float]:
    """The pose of least cost that moves some fingers from the straight pose.

    The best of 200 random poses per start begin a local search: rounds of normally distributed
    trials that become narrower. The random numbers are the same in each run.

    Args:
        fingers: names of the fingers that move.
        cost: the cost, without collisions [m].
        overlap: overlap beyond what is allowed [m]; it adds ten times itself to the cost.
        stop: cost at which the search ends [m].
        starts: number of poses that are improved.

    Returns:
        (m,) the pose [rad] and its cost [m].
    """
    rng, base = np.random.default_rng(0), hand.straight_pose.q
    free = np.flatnonzero(moving_joints(hand, fingers))
    low, high = hand.limits[free].T
    poses = np.tile(base, (_RANDOM * starts, 1))
    poses[1:, free] = rng.uniform(low, high, (len(poses) - 1, len(free)))
    best = poses[np.argsort(cost(poses), kind="stable")[:starts]]
    values = cost(best) + _WEIGHT * overlap(best)
    width, least = _WIDTH, list[float]()
    for _ in range(_ROUNDS):
        least.append(float(values.min()))
        if least[-1] <= stop or (len(least) > _PATIENCE and least[-1] > 0.98 * least[-_PATIENCE]):
            break
        trials = np.repeat(best[:, None], _TRIALS * starts, axis=1)
        moves = width * (high - low) * rng.normal(size=(*trials.shape[:2], len(free)))
        trials[:, :, free] = np.clip(trials[:, :, free] + moves, low, high)
        flat = trials.reshape(-1, trials.shape[-1])
        costs = (cost(flat) + _WEIGHT * overlap(flat)).reshape(trials.shape[:2])
        nearest, rows = costs.argmin(axis=1), np.arange(starts)
        better = costs[rows, nearest] < values
        best = np.where(better[:, None], trials[rows, nearest], best)
        values = np.where(better, costs[rows, nearest], values)
        width *= _SHRINK
    chosen = int(values.argmin())
    return best[chosen], float(values[chosen])


def moving_joints(hand: Hand, fingers: Iterable[str]) -> Bool[np.ndarray, " m"]:
    """(m,) mask of the actuated joints that move some fingers."""
    moved = np.zeros(len(hand.joint_names), bool)
    for finger in fingers:
        joint = hand.tree.keypoints[LANDMARKS[TIPS[FINGERS.index(finger)]]].joint
        while joint >= 0:
            moved[hand.tree.joints[joint].source] = True
            joint = hand.tree.joints[joint].parent
    return np.asarray((hand.transmission.matrix[moved] != 0).any(axis=0))


def excess_overlap(
    hand: Hand, fingers: Iterable[str], touching: Iterable[tuple[int, int]], deep: float
) -> Cost:
    """Overlap of the parts of some fingers with all other parts, beyond what is allowed.

    Args:
        fingers: names of the fingers.
        touching: pairs of parts that may touch each other.
        deep: overlap of these that is allowed [m].

    Returns:
        a function from (T, m) poses [rad] to the (T,) largest overlap beyond its limit [m].
    """
    every = parts_apart(hand)
    part = hand.model.body_weldid[[capsule.body for capsule in every.capsules]]
    owner = owners(hand)[part]
    own = np.isin(owner[every.pairs], [FINGERS.index(name) for name in fingers]).any(axis=1)
    pairs = chosen_pairs(hand, list(every.capsules), every.pairs[own])
    two = np.sort(part[every.pairs[own]], axis=1)
    allowed = np.isin(two @ (1 << 16, 1), [min(p) * (1 << 16) + max(p) for p in touching])
    limits = np.where(allowed, deep, OVERLAP)

    def overlap(q: Float[np.ndarray, "T m"]) -> Float[np.ndarray, " T"]:
        if not len(limits):
            return np.zeros(len(q))
        depths = [each for _, each in pairs.depths(hand.full_configuration(q))]
        return np.asarray(np.maximum(np.concatenate(depths) - limits, 0.0).max(axis=1))

    return overlap


class HandSurface(NamedTuple):
    """Surface of a hand with straight fingers.

    Attributes:
        surface: points on all links.
        points: (N, 3) their positions in the palm frame [m].
        normals: (N, 3) their normals in the palm frame.
        owners: (N,) index of each point's finger in ``FINGERS``, or ``PALM``.
    """

    surface: SurfacePoints
    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    owners: Int[np.ndarray, " N"]


@lru_cache(maxsize=2)
def straight_surface(hand: Hand) -> HandSurface:
    """The surface of a hand with straight fingers."""
    surface = surface_points(hand, [int(body) for body in np.flatnonzero(hand.bodies)])
    q = hand.full_configuration(hand.straight_pose.q)[None]
    (points,), (normals,) = PosedBodies(hand, surface.bodies.tolist())(q, surface)
    return HandSurface(surface, points, normals, owners(hand)[surface.bodies])


def finger_tip(hand: Hand, finger: str) -> SurfacePoints:
    """Points on the outermost link of a finger that has a shape, within ``TIP`` of its tip and not
    on the side of the nail."""
    model, every = hand.model, straight_surface(hand)
    spec = hand.spec.fingers[hand.fingers.index(finger)]
    parts, link = model.body_weldid[every.surface.bodies], model.body(spec.tip.body).id
    link = model.body_weldid[link]
    while link and not (parts == link).any():
        link = model.body_weldid[model.body_parentid[link]]
    tip, way = _flexion(hand, finger)
    far = np.where(parts == link, np.linalg.norm(every.points - tip, axis=1), np.inf)
    near = far <= max(TIP, float(far.min()) + TIP / 2)
    return every.surface.only(near & (every.normals @ way > _NAIL))


def _flexion(hand: Hand, finger: str) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """(3,) tip of a straight finger [m], and (3,) direction in which its last joint bends it: to
    the end of the range where tip and base are nearest to each other."""
    q, first = hand.straight_pose.q, BASES[FINGERS.index(finger)]
    base, tip = (hand.tree.names.index(LANDMARKS[i]) for i in (first, first + 3))
    joint = hand.tree.joints[hand.tree.keypoints[LANDMARKS[first + 3]].joint].source
    driver = int(np.argmax(np.abs(hand.transmission.matrix[joint])))
    poses = np.tile(q, (3, 1))
    poses[1:, driver] = hand.limits[driver]
    points = hand.landmark_positions(poses)
    lengths = np.linalg.norm(points[:, tip] - points[:, base], axis=1)
    end = 1 + int(np.argmin(lengths[1:]))
    poses[end, driver] = q[driver] + np.clip(poses[end, driver] - q[driver], -_NUDGE, _NUDGE)
    moved = hand.landmark_positions(poses[end])[tip] - points[0, tip]
    return points[0, tip], unit_vectors(moved, np)
