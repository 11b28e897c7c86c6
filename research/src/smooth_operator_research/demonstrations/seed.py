"""A first guess: a demonstration of one hand for another, by fingertip inverse kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes import scene_for
from smooth_operator_research.demonstrations.demonstration import Demonstration

FINGERS: Final = ("thumb", "index", "middle")
"""The fingers that do the tasks."""

_REST: Final = 0.2  # of a radian from the pose before, against a millimetre of the tips


def transferred(demonstration: Demonstration, hand: Hand) -> Demonstration:
    """The key poses of another hand, whose fingertips are where the first hand's are.

    Where, that is, against the object: each hand has its own scene, in which the object lies within
    its reach. Fingers besides thumb, index and middle stay in the neutral pose.

    Args:
        demonstration: of a hand that can do the task.
        hand: the other one.

    Raises:
        HandModelError: the other hand's size does not allow the task.
    """
    first = demonstration.robot
    here, there = (scene_for(demonstration.task, one) for one in (first, hand))
    fingers = [name for name in FINGERS if name in hand.fingers and name in first.fingers]
    own = [first.fingers.index(name) for name in fingers]
    tips = first.tips(first.full_configuration(demonstration.poses))[:, own]
    at, turn = here.mount.palm
    against_object = at + tips @ turn.T - here.start[0]
    at, turn = there.mount.palm
    goals = (against_object + there.start[0] - at) @ turn
    poses = [hand.neutral]
    for goal in goals[1:]:
        poses.append(_reach(hand, fingers, goal, poses[-1]))
    return Demonstration(
        demonstration.task, hand.name, hand.spec.side, demonstration.times, np.array(poses)
    )


def _reach(
    hand: Hand,
    fingers: Sequence[str],
    goal: Float[np.ndarray, "f 3"],
    start: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """The pose near ``start`` whose fingertips are nearest to a goal."""
    index = [hand.fingers.index(name) for name in fingers]

    def residuals(pose: Float[np.ndarray, " m"]) -> Float[np.ndarray, " r"]:
        tips = hand.tips(hand.full_configuration(pose))[index] - goal
        return np.concatenate([1e3 * tips.ravel(), _REST * (pose - start)])

    return np.asarray(least_squares(residuals, start, bounds=hand.limits.T).x)
