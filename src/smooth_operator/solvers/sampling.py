"""Algorithm 1: MPOPI with iCEM's elites as its adaptive importance sampler."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, UInt32

from smooth_operator.errors import ConfigError
from smooth_operator.solvers.normals import (
    counter_normal_matrix,
    counter_normals,
    fixed_normals,
    random_words,
)

MOST_SAMPLES: Final = 1 << 20
MOST_CYCLES: Final = 10_000
"""Upper bounds against typing errors: larger values exceed the memory or take minutes."""

Cost: TypeAlias = Callable[[Sequence[Array]], Array]
"""m arrays of a common shape (one per variable, batch last) to costs of that shape."""


@dataclass(frozen=True)
class SamplingConfig:
    """Hyper-parameters of Algorithm 1; the defaults are the paper's table.

    Attributes:
        samples: N, candidates per cycle.
        elites: M, candidates that shape the next cycle.
        cycles: L.
        sigma: initial standard deviation [rad].
        temperature: lambda of the softmax over elites.
        jitter: epsilon, added to the diagonal of the covariance.
        draws: ``fresh`` normals in every cycle, as published, or the same base normals always:
            ``quasi`` (low discrepancy) or ``pseudo``.
        base_seed: seed of fixed base normals.
    """

    samples: int = 8192
    elites: int = 128
    cycles: int = 20
    sigma: float = 0.2
    temperature: float = 0.1
    jitter: float = 1e-6
    draws: Literal["fresh", "quasi", "pseudo"] = "fresh"
    base_seed: int = 0

    def __post_init__(self) -> None:
        if self.samples < 1 or self.cycles < 1 or not 1 <= self.elites <= self.samples:
            raise ConfigError(
                "sampling needs samples >= elites >= 1 and cycles >= 1, not "
                f"samples={self.samples}, elites={self.elites}, cycles={self.cycles}"
            )
        if self.samples > MOST_SAMPLES or self.cycles > MOST_CYCLES:
            raise ConfigError(
                f"sampling takes at most {MOST_SAMPLES} samples and {MOST_CYCLES} cycles, not "
                f"samples={self.samples}, cycles={self.cycles}; the paper has 8192 and 20"
            )
        if self.sigma <= 0 or self.temperature <= 0 or self.jitter <= 0:
            raise ConfigError(
                "sigma, temperature and jitter must be positive, not "
                f"sigma={self.sigma}, temperature={self.temperature}, jitter={self.jitter}"
            )
        if self.draws not in ("fresh", "quasi", "pseudo"):
            raise ConfigError(f"draws must be 'fresh', 'quasi' or 'pseudo', not {self.draws!r}")


def sample_minimise(
    cost: Cost,
    start: Float[Array, " m"],
    limits: Float[np.ndarray, "m 2"],
    key: UInt32[Array, "2"],
    config: SamplingConfig,
    sigma: Float[Array, ""] | float | None = None,
    cycles: Int[Array, ""] | int | None = None,
) -> Float[Array, " m"]:
    """Minimise a cost within bounds by Algorithm 1.

    The last cycle of the algorithm as printed draws and scores candidates that nothing reads (its
    update is skipped by ``if l < L``). It is left out here; the result is the same.

    Args:
        cost: the cost, over batch-last candidates, only ever asked within the limits.
        start: (m,) initial mean.
        limits: (m, 2) bounds.
        key: two random words; unused when the base normals are fixed.
        config: hyper-parameters.
        sigma: initial standard deviation [rad], instead of the configured one; may be traced.
        cycles: L, instead of the configured one and no more than that; may be traced.

    Returns:
        (m,) the final mean, clipped to the bounds.
    """
    size, dtype = len(limits), jnp.float32
    low, high = (jnp.asarray(limits[:, i], dtype) for i in (0, 1))
    everyone = jnp.arange(config.samples, dtype=jnp.uint32)
    base = (
        None
        if config.draws == "fresh"
        else jnp.asarray(fixed_normals(size, config.samples, config.draws, config.base_seed))
    )

    def normals_of(index: Array, words: UInt32[Array, "2"]) -> Array:
        if base is None:
            return counter_normal_matrix(index.astype(jnp.uint32), words, size)
        return base if index is everyone else base[:, index]

    # Line 4: u_n ~ N(mu', Sigma'), within the limits.
    def draw(index: Array, words: UInt32[Array, "2"], mean: Array, factor: Array) -> Array:
        spread = factor @ normals_of(index, words)
        return jnp.clip(mean[:, None] + spread, low[:, None], high[:, None])

    # The same for all candidates, written out, so that drawing, kinematics and cost fuse into one
    # loop that stores nothing; the elite are drawn again from their indices. Where the normals are
    # stored anyway, a matrix product is as good and compiles faster.
    def draw_all(words: UInt32[Array, "2"], mean: Array, factor: Array) -> list[Array]:
        if base is not None:
            return list(draw(everyone, words, mean, factor))
        normals = counter_normals(everyone, words, size)
        rows = []
        for i in range(size):
            row = mean[i] + factor[i, 0] * normals[0]
            for j in range(1, i + 1):
                row = row + factor[i, j] * normals[j]
            rows.append(lax.clamp(low[i], row, high[i]))
        return rows

    def cycle(carry: tuple[Array, Array], words: Array) -> tuple[tuple[Array, Array], None]:
        mean, factor = carry
        costs = cost(draw_all(words, mean, factor))  # lines 4-5
        # Line 7, best first. Behind a barrier: if XLA sees best[0], it sorts all candidates.
        chosen = lax.top_k(-costs, config.elites)
        best, index = lax.optimization_barrier(chosen)  # type: ignore[no-untyped-call]
        elite = draw(index, words, mean, factor)
        # Lines 8-9. J_min is the first; the sum of the weights divides last, where it is cheap.
        weights = jnp.exp((best - best[0]) / config.temperature)
        sums = jnp.concatenate([elite, ones]) @ weights
        mean = sums[:-1] / sums[-1]  # line 10
        spread = (elite - mean[:, None]) * jnp.sqrt(weights / sums[-1])
        cov = spread @ spread.T + epsilon  # line 11
        return (mean, lax.linalg.cholesky(cov, symmetrize_input=False)), None

    ones = jnp.ones((1, config.elites), dtype)
    epsilon = config.jitter * jnp.eye(size, dtype=dtype)
    mean = start.astype(dtype)  # lines 1-2
    width = config.sigma if sigma is None else sigma
    factor = jnp.sqrt(width**2 + config.jitter) * jnp.eye(size, dtype=dtype)
    words = random_words(key, config.cycles - 1)
    if cycles is None:
        (mean, _), _ = lax.scan(cycle, (mean, factor), words)
    else:
        mean, _ = lax.fori_loop(
            0, cycles - 1, lambda i, carry: cycle(carry, words[i])[0], (mean, factor)
        )
    return jnp.clip(mean, low, high)  # line 14
