"""Penalties l of Eq. (1) and of the velocity term, with first and second derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple, TypeAlias

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.geometry import AnyKind, array_namespace

Loss: TypeAlias = Literal["smooth_l1", "squared", "smooth_l1_norm"]
"""``smooth_l1``: weight times smooth-L1 of each component; ``squared``: weight times the square of
each; ``smooth_l1_norm``: smooth-L1 of the weight times the length of the error."""

TINY_AREA: Final = 1e-12
"""Added to the square of a length, so that its root has a derivative at 0 [m^2]."""


class PenaltySlopes(NamedTuple):
    """Derivatives of the cost of K errors with respect to each.

    Attributes:
        first: (K, 3) first derivative.
        second: (K, 3) second derivative where components don't mix, (K, 3, 3) where they do.
    """

    first: Float[Array, "K 3"]
    second: Float[Array, "K 3"] | Float[Array, "K 3 3"]


def smooth_l1(x: AnyKind, transition: float) -> AnyKind:
    """x^2 / (2 transition) up to the transition, |x| - transition / 2 beyond; NumPy or JAX."""
    xp = array_namespace(x)
    size = xp.abs(x)
    near = xp.minimum(size, transition)
    cost: AnyKind = near * (size - 0.5 * near) * (1 / transition)
    return cost


def smooth_l1_slopes(x: Array, transition: float) -> tuple[Array, Array]:
    """First and second derivative of ``smooth_l1``."""
    slope = jnp.clip(x / transition, -1, 1)
    return slope, (jnp.abs(slope) < 1) / transition


def vector_price(error: Sequence[Array], weight: Array, loss: Loss, transition: float) -> Array:
    """The weighted cost of the error of one vector.

    Args:
        error: its three components [m], arrays of a common shape.
        weight: lambda_k of Eq. (1), of a shape that fits.
        loss: name of the penalty.
        transition: transition of smooth-L1 [m].
    """
    if loss == "smooth_l1_norm":
        x, y, z = error
        return smooth_l1(weight * jnp.sqrt(x * x + y * y + z * z + TINY_AREA), transition)
    terms = [e * e if loss == "squared" else smooth_l1(e, transition) for e in error]
    return weight * (terms[0] + terms[1] + terms[2])


def vector_slopes(
    errors: Float[Array, "K 3"], weights: Float[Array, " K"], loss: Loss, transition: float
) -> PenaltySlopes:
    """Derivatives of ``vector_price`` for K vectors.

    The second is exact but on the measure-zero kinks of smooth-L1.

    Args:
        errors: (K, 3) errors [m].
        weights: (K,) lambda_k of Eq. (1).
        loss: name of the penalty.
        transition: transition of smooth-L1 [m].
    """
    if loss == "squared":
        double = 2 * weights[:, None]
        return PenaltySlopes(double * errors, double * jnp.ones_like(errors))
    if loss == "smooth_l1":
        slope, second = smooth_l1_slopes(errors, transition)
        return PenaltySlopes(weights[:, None] * slope, weights[:, None] * second)
    length = jnp.sqrt((errors * errors).sum(axis=-1) + TINY_AREA)
    unit = errors / length[:, None]
    slope, second = smooth_l1_slopes(weights * length, transition)
    along = unit[:, :, None] * unit[:, None, :]
    radial, tangential = weights**2 * second, weights * slope / length
    across = jnp.eye(3, dtype=errors.dtype) - along
    return PenaltySlopes(
        (weights * slope)[:, None] * unit,
        radial[:, None, None] * along + tangential[:, None, None] * across,
    )
