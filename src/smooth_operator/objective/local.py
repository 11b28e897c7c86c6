"""Eq. (1) near one pose: value, gradient and exact Hessian as one small program."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.hands.differential import PointKinematics
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.objective.loss import FrameGoal, Objective


@dataclass(frozen=True, eq=False)
class LocalObjective:
    """The same objective as ``Objective``, for single poses, with derivatives."""

    objective: Objective

    @cached_property
    def kinematics(self) -> PointKinematics:
        """The moving points that the vectors join, with derivatives."""
        names = tuple(LANDMARKS[i] for i in self.objective.moving)
        return PointKinematics(self.objective.hand.tree, names)

    @cached_property
    def incidence(self) -> Float[np.ndarray, "K P"]:
        """Vectors from the P moving points, but for a constant: v = incidence @ points + ..."""
        moving = self.objective.moving
        matrix = np.zeros((len(self.objective.layout.vectors), len(moving)))
        for k, (i, j) in enumerate(self.objective.layout.vectors):
            for landmark, sign in ((j, 1.0), (i, -1.0)):
                if landmark in moving:
                    matrix[k, moving.index(landmark)] = sign
        return matrix

    def expand(
        self, q: Float[Array, "c m"], goal: FrameGoal
    ) -> tuple[Float[Array, " c"], Float[Array, "c m"], Float[Array, "c m m"]]:
        """Costs, gradients and Hessians of a few candidates."""
        costs, gradients, hessians = jax.vmap(lambda one: self.derivatives(one, goal))(q)
        return costs, gradients, hessians

    def derivatives(
        self, q: Float[Array, " m"], goal: FrameGoal
    ) -> tuple[Float[Array, ""], Float[Array, " m"], Float[Array, "m m"]]:
        """Value, gradient and Hessian of Eq. (1) at a pose.

        The Hessian is exact but on the measure-zero kinks of smooth-L1.
        """
        objective = self.objective
        motion = self.kinematics(self._full(q))
        errors = self._errors(motion.points, goal)
        slope, bend = objective.slopes(errors, goal.weights)
        incidence = jnp.asarray(self.incidence, q.dtype)
        force = incidence.T @ slope  # (P, 3): dJ/dp
        relative = jnp.einsum("kf,fjc->kcj", incidence, motion.velocities)
        if bend.ndim == 2:
            flat = relative.reshape(-1, relative.shape[-1])
            hessian = (flat * bend.reshape(-1, 1)).T @ flat
        else:
            hessian = jnp.einsum("kcj,kcd,kdi->ji", relative, bend, relative)
        hessian = hessian + self.kinematics.curvature(motion, force)
        gradient = jnp.einsum("fc,fjc->j", force, motion.velocities)
        matrix = jnp.asarray(objective.hand.expansion[0][list(self.kinematics.order)], q.dtype)
        pull, stiffness = objective.regularisation_slopes(q, goal.previous, goal.velocity_weight)
        cost = objective.price([errors[:, c] for c in range(3)], goal.weights).sum()
        return (
            cost + self.regularisation(q, goal),
            gradient @ matrix + pull,
            matrix.T @ hessian @ matrix + stiffness * jnp.eye(len(q), dtype=q.dtype),
        )

    def regularisation(self, q: Float[Array, " m"], goal: FrameGoal) -> Float[Array, ""]:
        """Last two terms of Eq. (1) at a pose."""
        return self.objective.regularisation(q, goal.previous, goal.velocity_weight)

    def _full(self, q: Float[Array, " m"]) -> Float[Array, " n"]:
        matrix, offset = self.objective.hand.expansion
        return jnp.asarray(matrix, q.dtype) @ q + jnp.asarray(offset, q.dtype)

    def _errors(self, moving: Float[Array, "P 3"], goal: FrameGoal) -> Float[Array, "K 3"]:
        layout, known = self.objective.layout, self.objective.points
        at = {i: moving[p] for p, i in enumerate(self.objective.moving)}
        points = [
            at[i] if i in at else jnp.asarray(known[LANDMARKS[i]].position, moving.dtype)
            for i in layout.landmarks
        ]
        return layout.among(points) - goal.vectors
