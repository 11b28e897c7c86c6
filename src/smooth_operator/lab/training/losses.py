"""GeoRT's losses: no pair of human and robot pose is needed (Yin et al., "Geometric Retargeting").

All arrays have the batch last, as the unrolled kinematics wants it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from smooth_operator.baselines.geort import Weights, finger_joints, forward
from smooth_operator.hands.hand import Hand
from smooth_operator.lab.training.settings import BEND, GeortTraining

_FLOOR: Final = 1e-6  # [m]; a robot tip that moves less has no direction (it is at a limit)

LOSSES: Final = ("direction", "coverage", "curvature", "pinch")
"""Names of the losses, unweighted, in the order in which they are recorded."""


class Batch(NamedTuple):
    """Batch of one training step.

    Attributes:
        points: (F, 3, B) human fingertips, each finger's by itself [m]; for coverage.
        around: (F, 3, B) places at or near them [m]; for direction and curvature.
        steps: (F, 3, B) human steps from those places [m].
        reach: (F, 3, R) reachable robot fingertips [m].
        pinches: (F, 3, P) human fingertips of one moment each [m].
        pinched: (F - 1, P) which fingers pinch with the thumb there.
    """

    points: Float[Array, "F 3 B"]
    around: Float[Array, "F 3 B"]
    steps: Float[Array, "F 3 B"]
    reach: Float[Array, "F 3 R"]
    pinches: Float[Array, "F 3 P"]
    pinched: Bool[Array, "f P"]


@dataclass(frozen=True, eq=False)
class GeortLoss:
    """The losses for one hand.

    Attributes:
        hand: the robot hand.
        settings: their weights.
        centre: (F, 3) and
        scale: (F,): how fingertips enter the networks.
    """

    hand: Hand
    settings: GeortTraining
    centre: Float[np.ndarray, "F 3"]
    scale: Float[np.ndarray, " F"]

    @cached_property
    def _joints(self) -> tuple[tuple[int, ...], ...]:
        return finger_joints(self.hand)

    def tips(self, weights: Weights, points: Float[Array, "F 3 N"]) -> Float[Array, "F 3 N"]:
        """Fingertips of the robot for those of the human at ``points`` [m]."""
        hand = self.hand
        inputs = (points - self.centre[:, :, None]) / self.scale[:, None, None]
        unit = forward(weights, inputs.astype(jnp.float32))
        rows = [jnp.full_like(unit[0, 0], value) for value in hand.neutral]
        for finger, joints in enumerate(self._joints):
            for output, joint in enumerate(joints):
                low, high = (float(limit) for limit in hand.limits[joint])
                rows[joint] = (low + high) / 2 + (high - low) / 2 * unit[finger, output]
        placed = hand.tree.forward_kinematics(
            hand.full_configuration_rows(rows), hand.tip_names, within_limits=True
        )
        like = unit[0, 0]
        return jnp.stack(
            [jnp.stack([jnp.broadcast_to(c, like.shape) for c in point]) for point in placed]
        ).astype(like.dtype)

    def __call__(
        self, weights: Weights, batch: Batch, ramp: Array | float = 1.0
    ) -> tuple[Array, Float[Array, "4"]]:
        """The losses of a batch.

        Args:
            ramp: share of the weight of coverage that is in force.

        Returns:
            the weighted sum, and each loss by itself in the order of ``LOSSES``.
        """
        bend = batch.steps * (BEND / _length(batch.steps))
        # one pass through the networks for all that is asked
        terms = [
            batch.points,
            batch.around,
            batch.around + batch.steps,
            batch.around + bend,
            batch.around - bend,
            batch.pinches,
        ]
        cuts = list(np.cumsum([part.shape[-1] for part in terms])[:-1])
        covering, at, moved, ahead, behind, pinching = jnp.split(
            self.tips(weights, jnp.concatenate(terms, axis=-1)), cuts, axis=-1
        )
        losses = (
            _direction(batch.steps, moved - at),
            _coverage(covering, batch.reach),
            jnp.mean(jnp.sum((ahead + behind - 2 * at) ** 2, axis=1)) / BEND**2,
            _pinch(pinching, batch.pinched),
        )
        settings = self.settings
        total = (
            settings.direction * losses[0]
            + settings.coverage * ramp * losses[1]
            + settings.curvature * losses[2]
            + settings.pinch * losses[3]
        )
        return total, jnp.stack(losses)


def _length(vectors: Float[Array, "F 3 N"]) -> Float[Array, "F 1 N"]:
    return jnp.sqrt(jnp.sum(vectors**2, axis=1, keepdims=True) + _FLOOR**2)


def _direction(human: Float[Array, "F 3 B"], robot: Float[Array, "F 3 B"]) -> Array:
    """1 - cosine of human and robot step."""
    cosine = jnp.sum(human * robot, axis=1) / (_length(human) * _length(robot))[:, 0]
    return 1 - jnp.mean(cosine)


def _coverage(robot: Float[Array, "F 3 B"], reach: Float[Array, "F 3 R"]) -> Array:
    """Chamfer distance, both ways [m^2], summed over the fingers.

    Which point is nearest is looked up without a derivative; the distance to it has one.
    """
    total = jnp.zeros((), robot.dtype)
    for tips, goals in zip(robot, reach, strict=True):
        still = lax.stop_gradient(tips)
        product = still.T @ goals
        squares = jnp.sum(goals**2, axis=0)[None] - 2 * product
        nearest_goal = jnp.argmin(squares, axis=1)
        nearest_tip = jnp.argmin(jnp.sum(still**2, axis=0)[:, None] - 2 * product, axis=0)
        out = jnp.sum((tips - goals[:, nearest_goal]) ** 2, axis=0)
        back = jnp.sum((goals - tips[:, nearest_tip]) ** 2, axis=0)
        total = total + jnp.mean(out) + jnp.mean(back)
    return total


def _pinch(tips: Float[Array, "F 3 P"], pinched: Bool[Array, "f P"]) -> Array:
    """Mean squared distance of thumb tip and fingertip over the pinches [m^2]."""
    gaps = jnp.sum((tips[1:] - tips[:1]) ** 2, axis=1)
    return jnp.sum(jnp.where(pinched, gaps, 0)) / jnp.maximum(jnp.sum(pinched), 1)
