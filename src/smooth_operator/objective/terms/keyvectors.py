"""First term of Eq. (1): the robot's keyvectors follow their targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.hands.kinematics import Vector
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.penalties import Loss, vector_price, vector_slopes
from smooth_operator.objective.terms.robot_vectors import RobotVectors
from smooth_operator.objective.terms.term import PointTerm, Quadratic


@dataclass(frozen=True, eq=False)
class Keyvectors(PointTerm):
    """Sum over k of lambda_k l(v_R - v_H).

    Attributes:
        vectors: the robot's.
        loss: the penalty l.
        transition: where smooth-L1 turns from quadratic to linear [m].
    """

    vectors: RobotVectors
    loss: Loss
    transition: float

    def points(self) -> tuple[str, ...]:
        """Landmarks that the vectors join and a joint moves."""
        return self.vectors.names

    def price(self, error: Sequence[Array], weight: Array) -> Array:
        """lambda_k l(v_R - v_H): the cost of one vector's error.

        Args:
            error: its three components [m], arrays of a common shape.
            weight: lambda_k, of a shape that fits.
        """
        return vector_price(error, weight, self.loss, self.transition)

    def cost(self, points: Sequence[Vector], goal: FrameGoal) -> Array:
        """See ``PointTerm``; written out, so that a compiler fuses it with the kinematics."""
        hand, layout = self.vectors.hand, self.vectors.layout
        at: dict[int | None, Sequence[Array | float]] = {None: (0.0, 0.0, 0.0)}
        for i in layout.landmarks:
            at[i] = tuple(map(float, hand.tree.keypoints[LANDMARKS[i]].position))
        at |= dict(zip(self.vectors.moving, cast(Sequence[Sequence[Array]], points), strict=True))
        total: Array = jnp.zeros((), goal.vectors.dtype)
        for k, (start, end) in enumerate(layout.vectors):
            error = [jnp.asarray(at[end][c] - at[start][c]) - goal.vectors[k, c] for c in range(3)]
            total = total + self.price(error, goal.weights[k])
        return total

    def expand(
        self, points: Float[Array, "P 3"], jacobian: Float[Array, "P J 3"], goal: FrameGoal
    ) -> Quadratic:
        """See ``PointTerm``; exact but on the kinks of smooth-L1."""
        errors, lambdas = self.vectors.at(points) - goal.vectors, jnp.asarray(goal.weights)
        slopes = vector_slopes(errors, lambdas, self.loss, self.transition)
        rows, weights = self.vectors.jacobian(jacobian), slopes.second
        if weights.ndim == 2:  # components that don't mix
            rows, weights = rows.reshape(-1, rows.shape[-1]), weights.reshape(-1)
        return Quadratic(
            self.price([errors[:, c] for c in range(3)], lambdas).sum(),
            self.vectors.spread(slopes.first),
            rows,
            weights,
        )
