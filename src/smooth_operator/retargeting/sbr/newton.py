"""Projected Newton descent within bounds, which finds the minimum of a basin.

It computes derivatives at all candidates of a step. ``damped_newton`` (``levenberg.py``) is for
objectives whose derivatives are much more expensive than their value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.retargeting.levenberg import ValueGradHess, best_of, newton_candidates
from smooth_operator.settings import LARGEST, check_numbers


@dataclass(frozen=True)
class NewtonConfig:
    """Settings of the Newton steps that follow the sampling.

    Attributes:
        iterations: number of Newton steps; 0 leaves them out.
        damping: values that are added to the Hessian's diagonal. Each gives a candidate, and the
            best one is used if it lowers the cost. These parallel candidates replace a line search
            and the repair of eigenvalues.
    """

    iterations: int = 3
    damping: tuple[float, ...] = (0.0, 0.1, 1.0, 10.0)

    def __post_init__(self) -> None:
        check_numbers(self)
        if not self.damping or not all(0 <= each <= LARGEST for each in self.damping):
            raise ConfigError(f"damping needs one or more values >= 0, not {self.damping}")


class NewtonResult(NamedTuple):
    """Result of ``newton_minimise``.

    Attributes:
        x: (m,) the best point.
        cost: its cost.
        gradient: (m,) gradient at the point.
    """

    x: Float[Array, " m"]
    cost: Float[Array, ""]
    gradient: Float[Array, " m"]


def newton_minimise(
    value_grad_hess: ValueGradHess,
    start: Float[Array, " m"],
    limits: Float[np.ndarray, "m 2"] | Float[Array, "m 2"],
    config: NewtonConfig,
) -> NewtonResult:
    """Minimises a cost within bounds by Newton steps. The cost never increases.

    Args:
        value_grad_hess: cost, gradient and Hessian of one candidate.
        start: (m,) a point within the bounds.
        limits: (m, 2) bounds.
        config: settings; without iterations, the result is the start.
    """

    def step(_: Array, last: tuple[Array, ...]) -> tuple[Array, ...]:
        q, lowest, gradient, hessian = last
        candidates = newton_candidates(q, gradient, hessian, limits, config.damping)
        costs, gradients, hessians = jax.vmap(value_grad_hess)(candidates)
        winner, cost = best_of(costs)
        following = (candidates[winner], cost, gradients[winner], hessians[winner])
        better = cost < lowest
        return tuple(jnp.where(better, new, old) for new, old in zip(following, last, strict=True))

    if config.iterations == 0:
        cost, gradient, _ = value_grad_hess(start)
        return NewtonResult(start, cost, gradient)
    # With a zero gradient, the first pass only evaluates the start. The program then contains the
    # objective once, which halves the time to compile it.
    identity = jnp.eye(len(limits), dtype=start.dtype)
    nothing = (start, jnp.asarray(jnp.inf, start.dtype), jnp.zeros_like(start), identity)
    q, cost, gradient, _ = jax.lax.fori_loop(0, config.iterations + 1, step, nothing)
    return NewtonResult(q, cost, gradient)
