"""Poses that a hand can reach, and the human hand that would ask for each of them."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.collision import penetration_depths
from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import palm_alignment
from smooth_operator.human.anatomy import NUM_JOINTS, draw_anatomy
from smooth_operator.human.kinematics import mirror, pose_hand
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS

_TOUCH: Final = 1e-3  # deepest overlap of a pose that a real hand could take [m]
_PINCH: Final = 0.02  # closer than this, targets with pinches mean a pinch and not the pose [m]
_TRIES: Final = 40  # random poses per wanted one


def reachable_poses(hand: Hand, count: int, seed: int) -> Float[np.ndarray, "T m"]:
    """Random poses within the limits that a real hand could take, and that mean no pinch.

    Uniform in every actuated joint. Left out are poses in which parts of the hand lie more than a
    millimetre inside each other (as far as the model has shapes), and those in which the thumb's
    tip is within 20 mm of another: there, a method that closes pinches is right to go elsewhere. A
    hand that has too few such poses gets those that come nearest to it.

    Args:
        hand: the robot hand.
        count: how many.
        seed: of the random numbers.

    Returns:
        (count, m) positions of the actuated joints [rad].
    """
    rng, low, high = np.random.default_rng(seed), hand.limits[:, 0], hand.limits[:, 1]
    found: list[np.ndarray] = []
    rest: list[np.ndarray] = []
    faults: list[np.ndarray] = []
    for _ in range(_TRIES):
        if sum(map(len, found)) >= count:
            break
        poses = rng.uniform(low, high, (count, len(low)))
        fault = _fault(hand, poses)
        found.append(poses[fault <= 0])
        rest.append(poses[fault > 0])
        faults.append(fault[fault > 0])
    order = np.argsort(np.concatenate(faults), kind="stable")
    chosen: np.ndarray = np.concatenate([*found, np.concatenate(rest)[order]])[:count]
    return chosen


def _fault(hand: Hand, poses: Float[np.ndarray, "T m"]) -> Float[np.ndarray, " T"]:
    """(T,) by how much a pose breaks the two rules [m]; 0 where it keeps them."""
    every = hand.full_configuration(poses)
    tips = hand.tips(every)
    gaps = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1).min(axis=1)
    depths = penetration_depths(hand, every)
    inside = np.zeros(len(poses)) if depths is None else np.maximum(depths - _TOUCH, 0)
    fault: np.ndarray = inside + np.maximum(_PINCH - gaps, 0)
    return fault


def human_landmarks(hand: Hand, q: Float[np.ndarray, "T m"]) -> Float[np.ndarray, "T 21 3"]:
    """The robot's own landmarks as those of a human hand in the palm frame.

    A point that a robot finger lacks is put on the line between its neighbours, and a finger that
    the robot lacks is the built-in operator's, flat and aligned to the robot's palm: methods look
    at neither, unless the hand's own description makes a joint follow them.

    Args:
        hand: the robot hand.
        q: (T, m) positions of the actuated joints [rad].

    Returns:
        (T, 21, 3) [m], all finite.
    """
    flat = pose_hand(draw_anatomy(0.19, 0), np.zeros((1, NUM_JOINTS)))
    flat = flat if hand.spec.side == "right" else mirror(flat)
    human = palm_alignment(flat.landmarks[0], hand).apply(flat.landmarks[0])
    points = np.broadcast_to(human, (len(q), *human.shape)).copy()
    known = [LANDMARKS.index(name) for name in hand.tree.names]
    points[:, known] = hand.landmark_positions(q)
    for name in hand.fingers:
        first = BASES[FINGERS.index(name)]
        own = [i for i in range(first, first + 4) if i in known]
        for i in set(range(first, first + 4)) - set(own):
            below, above = max(k for k in own if k < i), min(k for k in own if k > i)
            share = (i - below) / (above - below)
            points[:, i] = (1 - share) * points[:, below] + share * points[:, above]
    return points
