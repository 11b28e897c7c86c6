"""Projected Newton descent within bounds: a second-order polish for a point in the right basin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError

Expansion: TypeAlias = Callable[[Array], tuple[Array, Array, Array]]
"""(c, m) candidates to their costs (c,), gradients (c, m) and Hessians (c, m, m)."""


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


class NewtonResult(NamedTuple):
    """Where the descent ended.

    Attributes:
        x: (m,) the best point found.
        cost: there.
        gradient: (m,) there.
    """

    x: Float[Array, " m"]
    cost: Float[Array, ""]
    gradient: Float[Array, " m"]


def newton_minimise(
    expand: Expansion,
    start: Float[Array, " m"],
    limits: Float[np.ndarray, "m 2"],
    config: NewtonConfig,
) -> NewtonResult:
    """Descend from a start within bounds.

    Variables at a bound that the gradient pushes outwards are held; the others take damped Newton
    steps, clipped to the bounds. The cost never rises.

    Args:
        expand: costs, gradients and Hessians of a few candidates.
        start: (m,) a point within the bounds.
        limits: (m, 2) bounds.
        config: settings; no iterations give the start back.
    """
    low, high = (jnp.asarray(limits[:, i], start.dtype) for i in (0, 1))
    size = len(limits)
    identity = jnp.eye(size, dtype=start.dtype)
    damping = jnp.asarray(config.damping, start.dtype)

    def step(_: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
        q, best, gradient, hessian = carry
        held = ((q <= low) & (gradient > 0)) | ((q >= high) & (gradient < 0))
        hessian_free = jnp.where(held[:, None] | held[None, :], identity, hessian)
        gradient_free = jnp.where(held, 0.0, gradient)
        factor = jnp.linalg.cholesky(hessian_free + damping[:, None, None] * identity)
        moves = jax.scipy.linalg.cho_solve(
            (factor, True), jnp.broadcast_to(gradient_free, (len(damping), size))[..., None]
        )[..., 0]
        candidates = jnp.clip(q - moves, low, high)
        costs, gradients, hessians = expand(candidates)
        # an indefinite Hessian has no factor: its candidate is not a number, and loses
        costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
        winner = jnp.argmin(costs)
        better = costs[winner] < best
        found = (candidates[winner], costs[winner], gradients[winner], hessians[winner])
        return tuple(jnp.where(better, new, old) for new, old in zip(found, carry, strict=True))

    if config.iterations == 0:
        costs, gradients, _ = expand(start[None])
        return NewtonResult(start, costs[0], gradients[0])
    # Without a gradient the first pass does not move: it only looks at the start. That way the
    # program holds the objective once, and compiles in half the time.
    nothing = (start, jnp.asarray(jnp.inf, start.dtype), jnp.zeros_like(start), identity)
    q, cost, gradient, _ = jax.lax.fori_loop(0, config.iterations + 1, step, nothing)
    return NewtonResult(q, cost, gradient)
