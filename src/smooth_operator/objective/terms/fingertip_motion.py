"""Fingertips move as the human's do, whatever their error is."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.hands.hand import Hand
from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.terms.term import PointTerm, Quadratic


@dataclass(frozen=True, eq=False)
class FingertipMotion(PointTerm):
    """Sum over fingertips of mu_i / (2 beta) |p_i - p_i(last answer) - the human's step|^2, with
    the goal's mu_i (``motion_weights``) and places of arrival (``tips``).

    Attributes:
        hand: the robot hand.
        transition: beta, that of the keyvectors' smooth-L1, so that weights compare [m].
    """

    hand: Hand
    transition: float

    def points(self) -> tuple[str, ...]:
        """Fingertips, thumb first."""
        return self.hand.tip_names

    def tips(self, q: Float[Array, " m"]) -> Float[Array, "F 3"]:
        """Fingertips at a pose within the limits [m]."""
        tree = self.hand.tree
        points = tree.forward_kinematics(
            self.hand.full_configuration_rows(list(q)), self.points(), within_limits=True
        )
        return jnp.stack([jnp.stack([jnp.asarray(c, q.dtype) for c in point]) for point in points])

    def expand(
        self, points: Float[Array, "F 3"], jacobian: Float[Array, "F J 3"], goal: FrameGoal
    ) -> Quadratic:
        """See ``PointTerm``; exact."""
        if goal.tips is None or goal.motion_weights is None:
            raise ValueError(
                "the term of fingertip motion needs a goal with tips and their weights"
            )
        weights = jnp.repeat(goal.motion_weights / self.transition, 3)
        error = points - goal.tips
        return Quadratic(
            0.5 * (weights * (error * error).reshape(-1)).sum(),
            weights.reshape(error.shape) * error,
            jnp.swapaxes(jacobian, 1, 2).reshape(-1, jacobian.shape[1]),
            weights,
        )
