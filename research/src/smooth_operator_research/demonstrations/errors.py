"""By how much joints are off when a retargeter follows an operator exactly, errors included."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import palm_alignment
from smooth_operator.human.tracker_noise import NoiseState, remove_noise
from smooth_operator.landmarks import FINGERS, NUM_LANDMARKS, TIPS
from smooth_operator.methods.smooth import SmoothConfig
from smooth_operator.synthetic.tracker import TrackerStream
from smooth_operator_research.demonstrations.demonstration import PERIOD_S, Demonstration
from smooth_operator_research.demonstrations.landmarks import DemonstrationLandmarks
from smooth_operator_research.demonstrations.perturbation import Perturbation

_DAMPING: Final = 0.006  # of the inverse kinematics; joints move tips by 0.02 to 0.1 [m/rad]
_STEP: Final = 1e-4  # of numerical derivatives [rad]
_EVERY: Final = 5  # frames that share their derivatives
_BLOCK: Final = 200  # frames


def tip_errors(
    demonstration: Demonstration, world: Perturbation, filtered: bool = False
) -> Float[np.ndarray, "t f 3"]:
    """How far from the demonstration's the fingertips are that the operator shows.

    The operator's bones differ from the robot's, and the tracker adds noise to the palm's landmarks
    too; so the alignment to the robot's palm, frame by frame, turns and scales the whole hand.

    Args:
        demonstration: what the operator does.
        world: who the operator is, and the tracker; the object does not matter.
        filtered: see ``joint_errors``.

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
    found = _filtered(seen[last], tuple(index)) if filtered else seen[last][:, index]
    return np.asarray(found - (human if filtered else human[last])[:, index])


def joint_errors(
    demonstration: Demonstration, world: Perturbation, filtered: bool = False
) -> Float[np.ndarray, "t m"]:
    """By how much each actuated joint is off if each fingertip goes where the operator's is.

    Args:
        demonstration: what the operator does.
        world: see ``tip_errors``.
        filtered: as ``smooth`` removes a tracker's noise, which leaves less of it and adds lag.

    Returns:
        (t, m) for each period of the demonstration [rad].
    """
    error = tip_errors(demonstration, world, filtered)
    inverse = _inverse(demonstration)[np.arange(len(error)) // _EVERY]
    return np.asarray(np.einsum("tmr,tr->tm", inverse, error.reshape(len(error), -1)))


def _filtered(
    seen: Float[np.ndarray, "t 21 3"], index: tuple[int, ...]
) -> Float[np.ndarray, "t f 3"]:
    """Some of the landmarks after the removal of noise; frames that were dropped come again."""
    count = -(-len(seen) // _BLOCK) * _BLOCK  # of few lengths, since each is compiled
    padded = np.concatenate([seen, np.repeat(seen[-1:], count - len(seen), axis=0)])
    return np.asarray(_removed(padded, index))[: len(seen)]


@partial(jax.jit, static_argnums=1)
def _removed(seen: Array, index: tuple[int, ...]) -> Array:
    config = SmoothConfig().tracker_noise

    def frame(state: NoiseState, inputs: tuple[Array, Array]) -> tuple[NoiseState, Array]:
        landmarks, first = inputs
        return remove_noise(state, landmarks, index, PERIOD_S, config, first)

    first = jnp.arange(len(seen)) == 0
    return jax.lax.scan(frame, NoiseState.unseen(len(index)), (seen.astype(jnp.float32), first))[1]


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
