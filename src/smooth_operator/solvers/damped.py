"""Projected Newton descent that looks at derivatives once a step.

As ``smooth_operator.solvers.newton``, but where derivatives cost many times what a value does:
only values are taken of the steps of several dampings that are tried side by side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.solvers.newton import NewtonConfig

STILL: Final = 3e-4
"""A step in which no variable moves further is the last: of the next, which converges
quadratically, nobody would see anything [rad]."""


def damped_newton(
    derivatives: Callable[[Array], tuple[Array, Array, Array]],
    values: Callable[[Array], Array],
    start: Float[Array, " m"],
    limits: Float[np.ndarray, "m 2"],
    config: NewtonConfig,
    still: float = STILL,
) -> Float[Array, " m"]:
    """Descend from a start within bounds; the cost never rises.

    Args:
        derivatives: (m,) to cost, (m,) gradient and (m, m) Hessian.
        values: (c, m) candidates to their (c,) costs.
        start: (m,) a point within the bounds.
        limits: (m, 2) bounds.
        config: settings; its iterations are the most that are made, none give the start back.
        still: see ``STILL``.

    Returns:
        (m,) the best point found.
    """
    low, high = (jnp.asarray(limits[:, i], start.dtype) for i in (0, 1))
    identity = jnp.eye(len(limits), dtype=start.dtype)
    damping = jnp.asarray(config.damping, start.dtype)[:, None, None]

    def step(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        count, q, _ = carry
        cost, gradient, hessian = derivatives(q)
        held = ((q <= low) & (gradient > 0)) | ((q >= high) & (gradient < 0))
        free = jnp.where(held[:, None] | held[None, :], identity, hessian)
        downhill = jnp.where(held, 0.0, gradient)
        factor = jnp.linalg.cholesky(free + damping * identity)
        right = jnp.broadcast_to(downhill, (len(damping), len(limits)))[..., None]
        moves = jax.scipy.linalg.cho_solve((factor, True), right)[..., 0]
        candidates = jnp.clip(q - moves, low, high)
        # an indefinite Hessian has no factor: its candidate is not a number, and loses
        costs = jnp.where(jnp.isfinite(moves).all(-1), values(candidates), jnp.inf)
        winner = jnp.argmin(costs)
        after = jnp.where(costs[winner] < cost, candidates[winner], q)
        return count + 1, after, jnp.abs(after - q).max() > still

    def goes_on(carry: tuple[Array, Array, Array]) -> Array:
        count, _, moved = carry
        return (count < config.iterations) & moved

    found: tuple[Array, Array, Array] = jax.lax.while_loop(
        goes_on, step, (jnp.int32(0), start, jnp.bool_(True))
    )
    return found[1]
