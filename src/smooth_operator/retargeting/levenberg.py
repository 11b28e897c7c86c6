"""Levenberg's method within bounds: Newton steps with several damping values in parallel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from smooth_operator.retargeting.sbr.gpu_kernels import kernels_available, solve_positive_definite

ValueGradHess: TypeAlias = Callable[[Array], tuple[Array, Array, Array]]
"""Function from a point (m,) to its cost (), gradient (m,) and Hessian (m, m)."""

STILL: Final = 3e-3
"""``damped_newton`` stops after a step in which no variable moves further than this [rad]. Because
it converges quadratically, the next step would be negligible."""

AT_FIRST: Final = 3.0
"""Damping of the first step of ``damped_newton``."""
DAMPINGS: Final = (0.0, 0.2, 2.0)
"""Damping values of the candidates, in units of the damping of the previous step."""
GROWTH: Final = 20.0
"""Factor on the damping after a step in which no candidate lowers the cost."""
LEAST: Final = 0.01
"""Smallest damping. Each joint's pull to the neutral pose has five times this curvature."""
MOST: Final = 1e5
"""Damping at which a step hardly moves, so the descent ends."""

_AT_BOUND: Final = 1e-6
"""Distance from a bound below which a variable counts as being at the bound [rad], because solvers
return 1e-15 for 0."""


def _solve_small(
    matrices: Float[Array, "c m m"], right: Float[Array, "c m"]
) -> Float[Array, "c m"]:
    """Solves ``matrix @ x = right`` for a few small positive definite matrices; NaN for other
    matrices. Uses LAPACK on a CPU and one kernel on a GPU."""
    if kernels_available():
        return solve_positive_definite(matrices, right)
    factor = jnp.linalg.cholesky(matrices)
    return jax.scipy.linalg.cho_solve((factor, True), right[..., None])[..., 0]


def newton_candidates(
    q: Float[Array, " m"],
    gradient: Float[Array, " m"],
    hessian: Float[Array, "m m"],
    limits: Float[np.ndarray, "m 2"] | Float[Array, "m 2"],
    dampings: Float[Array, " c"] | tuple[float, ...],
) -> Float[Array, "c m"]:
    """Returns the (c, m) ends of damped Newton steps, one per damping, clipped to (m, 2) bounds.

    Variables at a bound that the gradient pushes outwards are held fixed. An indefinite damped
    Hessian has no Cholesky factor, so its candidate and its cost are NaN.
    """

    low, high = (jnp.asarray(limits[:, i], q.dtype) for i in (0, 1))
    identity = jnp.eye(len(limits), dtype=q.dtype)
    damping = jnp.asarray(dampings, q.dtype)[:, None, None]
    under, over = q <= low + _AT_BOUND, q >= high - _AT_BOUND
    held = (under & (gradient > 0)) | (over & (gradient < 0))
    matrices = jnp.where(held[:, None] | held[None, :], identity, hessian) + damping * identity
    right = jnp.broadcast_to(jnp.where(held, 0.0, gradient), (len(damping), len(limits)))
    return jnp.clip(q - _solve_small(matrices, right), low, high)


def best_of(costs: Float[Array, " c"]) -> tuple[Array, Array]:
    """Returns the index and value of the lowest finite cost; without one, the value is infinite."""
    costs = jnp.where(jnp.isfinite(costs), costs, jnp.inf)
    winner = jnp.argmin(costs)
    return winner, costs[winner]


def damped_newton(
    value_grad_hess: ValueGradHess,
    start: Float[Array, " m"],
    limits: Float[np.ndarray, "m 2"] | Float[Array, "m 2"],
    iterations: int,
    still: float = STILL,
) -> tuple[Float[Array, " m"], Float[Array, ""], Int[Array, ""]]:
    """Minimises a cost within bounds; computes derivatives once per step. The cost never increases.

    This is Levenberg's method with several damping values in parallel. Where parts of the hand
    touch, the quadratic model changes from step to step, and so does the best damping.

    Args:
        value_grad_hess: (m,) to cost, (m,) gradient and (m, m) Hessian.
        start: (m,) a point within the bounds.
        limits: (m, 2) bounds.
        iterations: maximum number of steps.
        still: see ``STILL``.

    Returns:
        (m,) the best point found, its cost, and the number of iterations.
    """

    def step(carry: tuple[Array, ...]) -> tuple[Array, ...]:
        count, q, _, damping, _ = carry
        cost, gradient, hessian = value_grad_hess(q)
        dampings = damping * np.array(DAMPINGS, np.float32)
        candidates = newton_candidates(q, gradient, hessian, limits, dampings)
        # the compiler drops the derivatives of the candidates
        winner, lowest = best_of(jax.vmap(lambda one: value_grad_hess(one)[0])(candidates))
        descends = lowest < cost
        after = jnp.where(descends, candidates[winner], q)
        damping = jnp.where(descends, jnp.maximum(dampings[winner], LEAST), GROWTH * damping)
        goes_on = jnp.where(descends, jnp.abs(after - q).max() > still, damping < MOST)
        return count + 1, after, jnp.minimum(lowest, cost), damping, goes_on

    worst, damping = (jnp.asarray(value, start.dtype) for value in (jnp.inf, AT_FIRST))
    last: tuple[Array, ...] = jax.lax.while_loop(
        lambda carry: (carry[0] < iterations) & carry[-1],
        step,
        (jnp.int32(0), start, worst, damping, jnp.bool_(True)),
    )
    return last[1], last[2], last[0]
