"""Algorithm 1: MPOPI with iCEM's elites as its adaptive importance sampler."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from smooth_operator.errors import ConfigError
from smooth_operator.solvers.normals import counter_normals, fixed_normals

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
            ``sobol`` (quasi-random) or ``pseudo``.
        base_seed: seed of fixed base normals.
    """

    samples: int = 8192
    elites: int = 128
    cycles: int = 20
    sigma: float = 0.2
    temperature: float = 0.1
    jitter: float = 1e-6
    draws: Literal["fresh", "sobol", "pseudo"] = "fresh"
    base_seed: int = 0

    def __post_init__(self) -> None:
        if self.samples < 1 or self.cycles < 1 or not 1 <= self.elites <= self.samples:
            raise ConfigError(
                "sampling needs samples >= elites >= 1 and cycles >= 1, not "
                f"samples={self.samples}, elites={self.elites}, cycles={self.cycles}"
            )
        if self.sigma <= 0 or self.temperature <= 0 or self.jitter <= 0:
            raise ConfigError(
                "sigma, temperature and jitter must be positive, not "
                f"sigma={self.sigma}, temperature={self.temperature}, jitter={self.jitter}"
            )
        if self.draws not in ("fresh", "sobol", "pseudo"):
            raise ConfigError(f"draws must be 'fresh', 'sobol' or 'pseudo', not {self.draws!r}")


def sample_minimise(
    cost: Cost,
    start: Float[Array, " m"],
    limits: Float[np.ndarray, "m 2"],
    key: Array,
    config: SamplingConfig,
) -> Float[Array, " m"]:
    """Minimise a cost within bounds by Algorithm 1.

    The last cycle of the algorithm as printed draws and scores candidates that nothing reads (its
    update is skipped by ``if l < L``). It is left out here; the result is the same.

    Args:
        cost: the cost, over batch-last candidates, only ever asked within the limits.
        start: (m,) initial mean.
        limits: (m, 2) bounds.
        key: JAX random key of this call; unused when the base normals are fixed.
        config: hyper-parameters.

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

    def candidates(
        index: UInt32[Array, " n"],
        words: UInt32[Array, "2"],
        mean: Float[Array, " m"],
        factor: Float[Array, "m m"],
    ) -> list[Float[Array, " n"]]:
        # line 4: u_n ~ N(mu', Sigma'), then within the limits
        if base is None:
            normals = counter_normals(index, words, size)
        else:
            normals = list(base if index is everyone else base[:, index])
        rows = []
        for i in range(size):
            row = mean[i] + factor[i, 0] * normals[0]
            for j in range(1, i + 1):
                row = row + factor[i, j] * normals[j]
            rows.append(jnp.clip(row, low[i], high[i]))
        return rows

    def cycle(
        carry: tuple[Float[Array, " m"], Float[Array, "m m"]], words: UInt32[Array, "2"]
    ) -> tuple[tuple[Float[Array, " m"], Float[Array, "m m"]], None]:
        mean, factor = carry
        costs = cost(candidates(everyone, words, mean, factor))  # lines 4-5
        best, index = jax.lax.top_k(-costs, config.elites)  # line 7
        elite = jnp.stack(candidates(index.astype(jnp.uint32), words, mean, factor))
        weights = jax.nn.softmax(best / config.temperature)  # lines 8-9; softmax subtracts J_min
        mean = elite @ weights  # line 10
        spread = elite - mean[:, None]
        cov = (spread * weights) @ spread.T + config.jitter * jnp.eye(size, dtype=dtype)  # line 11
        return (mean, jnp.linalg.cholesky(cov)), None

    mean = start.astype(dtype)  # lines 1-2
    factor = jnp.sqrt(config.sigma**2 + config.jitter) * jnp.eye(size, dtype=dtype)
    words = jax.random.bits(key, (config.cycles - 1, 2), jnp.uint32)
    (mean, _), _ = jax.lax.scan(cycle, (mean, factor), words)
    return jnp.clip(mean, low, high)  # line 14
