"""By how much joints are off when a retargeter follows an operator exactly, errors included."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import palm_alignment
from smooth_operator.landmarks import FINGERS, NUM_LANDMARKS, TIPS
from smooth_operator.simulation.tasks.demonstration import PERIOD_S, Demonstration
from smooth_operator.simulation.tasks.demonstration_landmarks import DemonstrationLandmarks
from smooth_operator.simulation.tasks.perturbation import Perturbation
from smooth_operator.synthetic.tracker import TrackerStream

_DAMPING: Final = 0.006  # of the inverse kinematics; joints move tips by 0.02 to 0.1 [m/rad]
_STEP: Final = 1e-4  # of numerical derivatives [rad]
_EVERY: Final = 5  # frames that share their derivatives


def tip_errors(demonstration: Demonstration, world: Perturbation) -> Float[np.ndarray, "t f 3"]:
    """How far from the demonstration's the fingertips are that the operator shows.

    The operator's bones differ from the robot's, and the tracker adds noise to the palm's landmarks
    too; so the alignment to the robot's palm, frame by frame, turns and scales the whole hand.

    Args:
        demonstration: what the operator does.
        world: who the operator is, and the tracker; the object does not matter.

    Returns:
        (t, f, 3) for each period of the demonstration and robot finger [m], in the palm frame.
    """
    hand = demonstration.robot
    human, index = _human(demonstration)
    shown = np.stack([world.operator(frame) for frame in human])
    ticks = TrackerStream(world.tracker, 1.0 / PERIOD_S).next(len(shown))
    if ticks.noise is not None:
        shown = shown + ticks.noise[:, :NUM_LANDMARKS]
    seen = np.asarray(palm_alignment(shown, hand).apply(shown))
    last = np.maximum.accumulate(np.where(ticks.arrives, np.arange(len(seen)), 0))
    return np.asarray((seen[:, index] - human[:, index])[last])


def joint_errors(
    demonstration: Demonstration, world: Perturbation, smoothing: float = 0.0
) -> Float[np.ndarray, "t m"]:
    """By how much each actuated joint is off if each fingertip goes where the operator's is.

    Args:
        demonstration: what the operator does.
        world: see ``tip_errors``.
        smoothing: standard deviation of the Gaussian over time with which the errors are averaged
            [s]: what a retargeter that filters noise leaves of them. 0 leaves them as they are.

    Returns:
        (t, m) for each period of the demonstration [rad].
    """
    error = tip_errors(demonstration, world)
    if smoothing > 0.0:
        error = gaussian_filter1d(error, smoothing / PERIOD_S, axis=0, mode="nearest")
    inverse = _inverse(demonstration)[np.arange(len(error)) // _EVERY]
    return np.asarray(np.einsum("tmr,tr->tm", inverse, error.reshape(len(error), -1)))


@lru_cache(maxsize=4)
def _human(demonstration: Demonstration) -> tuple[Float[np.ndarray, "t 21 3"], list[int]]:
    """(t, 21, 3) its landmarks [m], and which of them are the robot's fingertips."""
    source, count = DemonstrationLandmarks(demonstration), _periods(demonstration)
    frames = np.stack([source.at(k * PERIOD_S) for k in range(count)])
    return frames, [TIPS[FINGERS.index(name)] for name in demonstration.robot.fingers]


@lru_cache(maxsize=4)
def _inverse(demonstration: Demonstration) -> Float[np.ndarray, "k m r"]:
    """Damped inverse of the fingertips' derivatives, every few frames [rad/m]."""
    hand, count = demonstration.robot, _periods(demonstration)
    poses = np.stack([demonstration.pose(k * PERIOD_S) for k in range(0, count, _EVERY)])
    slope = _slopes(hand, poses)
    square = slope @ slope.swapaxes(1, 2) + _DAMPING**2 * np.eye(slope.shape[1])
    return np.asarray(np.linalg.solve(square, slope).swapaxes(1, 2))


def _slopes(hand: Hand, poses: Float[np.ndarray, "k m"]) -> Float[np.ndarray, "k r m"]:
    moved = poses[:, None] + _STEP * np.eye(poses.shape[1])
    tips = hand.tips(hand.full_configuration(moved)).reshape(*moved.shape[:2], -1)
    here = hand.tips(hand.full_configuration(poses)).reshape(len(poses), 1, -1)
    return np.asarray((tips - here).swapaxes(1, 2) / _STEP)


def _periods(demonstration: Demonstration) -> int:
    return int(np.ceil(demonstration.times[-1] / PERIOD_S))
