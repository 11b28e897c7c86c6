"""Eq. (1) near one pose: value, gradient and exact Hessian as one small program."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.hands.differential import PointKinematics
from smooth_operator.objective.loss import FrameGoal, Objective


@dataclass(frozen=True, eq=False)
class LocalObjective:
    """The same objective as :class:`Objective`, for single poses, with derivatives."""

    objective: Objective

    @cached_property
    def kinematics(self) -> PointKinematics:
        """Fingertips with derivatives."""
        hand = self.objective.hand
        return PointKinematics(hand.tree, hand.tip_names)

    @cached_property
    def incidence(self) -> Float[np.ndarray, "K F"]:
        """Keyvectors from tips: v = incidence @ tips - wrist terms."""
        pairs = self.objective.layout.pairs
        matrix = np.zeros((len(pairs), len(self.objective.hand.fingers)))
        for k, (i, j) in enumerate(pairs):
            matrix[k, j - 1] = 1
            if i > 0:
                matrix[k, i - 1] = -1
        return matrix

    def costs(self, q: Float[Array, "c m"], goal: FrameGoal) -> Float[Array, " c"]:
        """Eq. (1) of a few candidates."""
        return jax.vmap(lambda one: self._cost(one, goal))(q)

    def derivatives(
        self, q: Float[Array, " m"], goal: FrameGoal
    ) -> tuple[Float[Array, " m"], Float[Array, "m m"]]:
        """Gradient and Hessian of Eq. (1) at a pose.

        The Hessian is exact but on the measure-zero kinks of smooth-L1.
        """
        objective = self.objective
        motion = self.kinematics(self._expand(q))
        slope, bend = objective.slopes(self._errors(motion.points, goal))
        incidence = jnp.asarray(self.incidence, q.dtype)
        force = incidence.T @ (goal.weights[:, None] * slope)  # (F, 3): dJ/dp
        stretch = goal.weights[:, None] * bend  # (K, 3)
        relative = jnp.einsum("kf,fjc->kcj", incidence, motion.velocities)
        flat = relative.reshape(-1, relative.shape[-1])
        hessian = (flat * stretch.reshape(-1, 1)).T @ flat
        hessian = hessian + self.kinematics.curvature(motion, force)
        gradient = jnp.einsum("fc,fjc->j", force, motion.velocities)
        matrix = jnp.asarray(objective.hand.expansion[0][list(self.kinematics.order)], q.dtype)
        reg, vel = objective.config.pose_weight, goal.velocity_weight
        neutral = jnp.asarray(objective.hand.neutral, q.dtype)
        pull = 2 * reg * (q - neutral) + 2 * vel * (q - goal.previous)
        stiffness = 2 * (reg + vel) * jnp.eye(len(q), dtype=q.dtype)
        return gradient @ matrix + pull, matrix.T @ hessian @ matrix + stiffness

    def tracking(self, q: Float[Array, " m"], goal: FrameGoal) -> Float[Array, ""]:
        """First term of Eq. (1) at a pose."""
        error = self._errors(self.kinematics(self._expand(q)).points, goal)
        return (goal.weights[:, None] * self.objective.penalty(error)).sum()

    def _cost(self, q: Float[Array, " m"], goal: FrameGoal) -> Float[Array, ""]:
        config = self.objective.config
        neutral = jnp.asarray(self.objective.hand.neutral, q.dtype)
        return (
            self.tracking(q, goal)
            + config.pose_weight * ((q - neutral) ** 2).sum()
            + goal.velocity_weight * ((q - goal.previous) ** 2).sum()
        )

    def _expand(self, q: Float[Array, " m"]) -> Float[Array, " n"]:
        matrix, offset = self.objective.hand.expansion
        return jnp.asarray(matrix, q.dtype) @ q + jnp.asarray(offset, q.dtype)

    def _errors(self, tips: Float[Array, "F 3"], goal: FrameGoal) -> Float[Array, "K 3"]:
        layout = self.objective.layout
        wrist = jnp.asarray(self.objective.hand.wrist, tips.dtype)
        return layout.robot(tips, wrist) - goal.vectors
