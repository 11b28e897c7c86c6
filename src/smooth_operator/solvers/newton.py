"""Projected Newton descent within bounds: a second-order polish for a point in the right basin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError

Derivatives: TypeAlias = Callable[[Array], tuple[Array, Array]]
"""(m,) to (gradient (m,), Hessian (m, m))."""
BatchCost: TypeAlias = Callable[[Array], Array]
"""(c, m) candidates to (c,) costs."""


@dataclass(frozen=True)
class NewtonConfig:
    """Settings of the polish.

    Attributes:
        iterations: Newton steps per call; 0 leaves the polish out.
        damping: values added to the Hessian's diagonal. A step is made for each and the best is
            taken (or none, if none descends), which replaces eigenvalue repair and line search by
            work that runs side by side.
    """

    iterations: int = 3
    damping: tuple[float, ...] = (0.0, 0.1, 1.0, 10.0)

    def __post_init__(self) -> None:
        if self.iterations < 0:
            raise ConfigError(f"iterations must not be negative, not {self.iterations}")
        if not self.damping or min(self.damping) < 0:
            raise ConfigError(f"damping needs one or more values >= 0, not {self.damping}")


def newton_minimise(
    derivatives: Derivatives,
    cost: BatchCost,
    start: Float[Array, " m"],
    limits: Float[np.ndarray, "m 2"],
    config: NewtonConfig,
) -> Float[Array, " m"]:
    """Descend from a start within bounds.

    Variables at a bound that the gradient pushes outwards are held; the others take damped Newton
    steps, clipped to the bounds. The cost never rises.

    Args:
        derivatives: gradient and Hessian at a point.
        cost: costs of candidates.
        start: (m,) a point within the bounds.
        limits: (m, 2) bounds.
        config: settings.

    Returns:
        (m,) the best point found.
    """
    low, high = (jnp.asarray(limits[:, i], start.dtype) for i in (0, 1))
    identity = jnp.eye(len(limits), dtype=start.dtype)
    damping = jnp.asarray(config.damping, start.dtype)

    def step(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        q, best = carry
        gradient, hessian = derivatives(q)
        held = ((q <= low) & (gradient > 0)) | ((q >= high) & (gradient < 0))
        hessian = jnp.where(held[:, None] | held[None, :], identity, hessian)
        gradient = jnp.where(held, 0.0, gradient)
        factor = jnp.linalg.cholesky(hessian + damping[:, None, None] * identity)
        moves = jax.scipy.linalg.cho_solve(
            (factor, True), jnp.broadcast_to(gradient, (len(damping), len(q)))[..., None]
        )[..., 0]
        candidates = jnp.clip(q - moves, low, high)
        costs = cost(candidates)
        # an indefinite Hessian has no factor: its candidate is not a number, and loses
        costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
        winner = jnp.argmin(costs)
        better = costs[winner] < best
        return (
            jnp.where(better, candidates[winner], q),
            jnp.where(better, costs[winner], best),
        )

    if config.iterations == 0:
        return start
    return jax.lax.fori_loop(0, config.iterations, step, (start, cost(start[None])[0]))[0]
