"""Base class for your own cost terms that are defined by their residuals."""

from __future__ import annotations

from abc import abstractmethod

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.retargeting.objective import FrameGoal, PointTerm, Quadratic


class LeastSquaresTerm(PointTerm):
    """Cost term that is half the sum of squared residuals of some points; the simplest kind of term
    to write."""

    @abstractmethod
    def residuals(self, points: Float[Array, "P 3"], goal: FrameGoal) -> Float[Array, " R"]:
        """Returns (R,) residuals at one pose, each multiplied by the square root of its weight."""

    def expand(
        self, points: Float[Array, "P 3"], jacobian: Float[Array, "P J 3"], goal: FrameGoal
    ) -> Quadratic:
        """Returns cost and derivatives, as ``PointTerm.expand`` does; JAX differentiates the
        residuals."""
        residuals, pull = jax.vjp(lambda p: self.residuals(p, goal), points)

        def along(speeds: Array) -> Array:
            _, rates = jax.jvp(lambda p: self.residuals(p, goal), (points,), (speeds,))
            return jnp.asarray(rates)

        return Quadratic(
            0.5 * (residuals * residuals).sum(),
            pull(residuals)[0],
            jax.vmap(along, in_axes=1, out_axes=1)(jacobian),
            jnp.ones_like(residuals),
        )
