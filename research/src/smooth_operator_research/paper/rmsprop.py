"""RMSProp within bounds, for many starts side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from smooth_operator.errors import ConfigError

ValueAndGradient: TypeAlias = Callable[[Array], tuple[Array, Array]]
"""(m, N) candidates, batch last, to their costs (N,) and gradients (m, N)."""


@dataclass(frozen=True)
class RmspropConfig:
    """Settings of RMSProp (Tieleman and Hinton 2012, lecture 6.5).

    Attributes:
        step: learning rate of the first iteration [rad].
        final: learning rate of the last one over that of the first; between them it falls
            geometrically. 1 is as in the lecture, which leaves a point that circles the minimum at
            the distance of a step.
        decay: of the running mean of squared gradients; the lecture's.
        epsilon: added to the root of it, against a division by nothing.
        max_evaluations: evaluations per frame.
        tolerance: change of the cost in one iteration that counts as none.
    """

    step: float = 0.01
    final: float = 0.01
    decay: float = 0.9
    epsilon: float = 1e-8
    max_evaluations: int = 100
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        if self.step <= 0 or not 0 < self.final <= 1 or not 0 <= self.decay < 1:
            raise ConfigError(
                "RMSProp needs step > 0, final in (0, 1] and decay in [0, 1), not "
                f"step={self.step}, final={self.final}, decay={self.decay}"
            )
        if self.max_evaluations < 2 or self.tolerance <= 0:
            raise ConfigError(
                "RMSProp needs max_evaluations >= 2 and tolerance > 0, not "
                f"max_evaluations={self.max_evaluations}, tolerance={self.tolerance}"
            )


class _Carry(NamedTuple):
    evaluations: Int[Array, ""]
    q: Float[Array, "m N"]
    square: Float[Array, "m N"]
    last: Float[Array, " N"]
    best: Float[Array, "m N"]
    lowest: Float[Array, " N"]
    done: Bool[Array, " N"]


def rmsprop_minimise(
    value_and_gradient: ValueAndGradient,
    starts: Float[Array, "m N"],
    limits: Float[np.ndarray, "m 2"],
    config: RmspropConfig,
    step: Float[Array, ""] | float | None = None,
    final: Float[Array, ""] | float | None = None,
) -> tuple[Float[Array, "m N"], Float[Array, " N"], Int[Array, ""]]:
    """Descend from every start; each step is clipped to the bounds.

    As with SLSQP here, a start's answer is the best point that it has seen, and it stops where an
    iteration changes its cost by less than the tolerance.

    Args:
        value_and_gradient: the objective.
        starts: (m, N) points within the bounds.
        limits: (m, 2) bounds.
        config: settings.
        step: learning rate, instead of the configured one; may be traced.
        final: likewise.

    Returns:
        (m, N) the answers, (N,) their costs, and how often the objective was evaluated by the
        start that took longest.
    """
    low, high = (jnp.asarray(limits[:, i, None], starts.dtype) for i in (0, 1))
    first = jnp.asarray(config.step if step is None else step, starts.dtype)
    share = jnp.asarray(config.final if final is None else final, starts.dtype)

    def onward(carry: _Carry) -> Array:
        return (carry.evaluations < config.max_evaluations) & ~carry.done.all()

    def iterate(carry: _Carry) -> _Carry:
        value, gradient = value_and_gradient(carry.q)
        better = (value < carry.lowest) & ~carry.done
        done = carry.done | (jnp.abs(value - carry.last) < config.tolerance)
        square = config.decay * carry.square + (1 - config.decay) * gradient**2
        rate = first * share ** (carry.evaluations / (config.max_evaluations - 1))
        move = rate * gradient / (jnp.sqrt(square) + config.epsilon)
        return _Carry(
            carry.evaluations + 1,
            jnp.where(done, carry.q, jnp.clip(carry.q - move, low, high)),
            square,
            value,
            jnp.where(better, carry.q, carry.best),
            jnp.where(better, value, carry.lowest),
            done,
        )

    many = starts.shape[1:]
    end = lax.while_loop(
        onward,
        iterate,
        _Carry(
            jnp.int32(0),
            starts,
            jnp.zeros_like(starts),
            jnp.full(many, jnp.inf, starts.dtype),
            starts,
            jnp.full(many, jnp.inf, starts.dtype),
            jnp.zeros(many, bool),
        ),
    )
    return end.best, end.lowest, end.evaluations
