"""Batched starts around the last solution, and their softmax."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from smooth_operator.geometry import AnyKind, array_namespace
from smooth_operator.solvers.normals import counter_normal_matrix


def scattered_starts(
    last: Float[Array, " m"],
    limits: Float[np.ndarray, "m 2"],
    key: UInt32[Array, "2"],
    count: int,
    spread: float,
) -> Float[Array, "m N"]:
    """N starts: the last answer itself, and normals about it, within the bounds.

    Args:
        last: (m,) answer to the last frame [rad].
        limits: (m, 2) bounds.
        key: two random words, the frame's own.
        count: N.
        spread: standard deviation [rad].
    """
    normals = counter_normal_matrix(jnp.arange(count, dtype=jnp.uint32), key, len(limits))
    moved = last[:, None] + spread * normals * (jnp.arange(count) > 0)
    low, high = (jnp.asarray(limits[:, i, None], last.dtype) for i in (0, 1))
    return jnp.clip(moved, low, high)


def soft_mean(
    outputs: Float[AnyKind, "m N"], costs: Float[AnyKind, " N"], temperature: float
) -> Float[AnyKind, " m"]:
    """Mean of the outputs, weighted by the softmax of -cost / temperature.

    An output whose cost is not finite has no weight; where none is finite, the answer is not.
    """
    xp = array_namespace(costs)
    known = xp.isfinite(costs)
    costs = xp.where(known, costs, xp.inf)
    weights = xp.where(known, xp.exp(-(costs - costs.min()) / temperature), 0.0)
    outputs = xp.where(weights > 0, outputs, 0.0)
    mean: AnyKind = (outputs * weights).sum(axis=-1) / weights.sum()
    return mean
