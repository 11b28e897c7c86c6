"""Poses that a hand can reach."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.collision import penetration_depths
from smooth_operator.hands.hand import Hand

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
        count: number of poses.
        seed: seed of the random numbers.

    Returns:
        (count, m) positions of the actuated joints [rad].
    """
    rng, low, high = np.random.default_rng(seed), hand.limits[:, 0], hand.limits[:, 1]
    batches: list[np.ndarray] = []
    rest: list[np.ndarray] = []
    faults: list[np.ndarray] = []
    for _ in range(_TRIES):
        if sum(map(len, batches)) >= count:
            break
        poses = rng.uniform(low, high, (count, len(low)))
        fault = _fault(hand, poses)
        batches.append(poses[fault <= 0])
        rest.append(poses[fault > 0])
        faults.append(fault[fault > 0])
    order = np.argsort(np.concatenate(faults), kind="stable")
    chosen: np.ndarray = np.concatenate([*batches, np.concatenate(rest)[order]])[:count]
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
