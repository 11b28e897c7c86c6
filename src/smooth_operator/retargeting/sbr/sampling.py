"""SBR's sampler, Algorithm 1 of the Smooth Operator paper: MPOPI with iCEM's elites.

``sample_minimise`` follows the printed algorithm and its symbols: mean mu', covariance Sigma'
(stored as its Cholesky factor ``chol``), elites and weights w. Comments "line n" give the line
number of the printed algorithm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final, Literal, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, UInt32

from smooth_operator.errors import ConfigError
from smooth_operator.retargeting.sbr.gpu_kernels import kernels_available, next_gaussian
from smooth_operator.retargeting.sbr.random_numbers import (
    counter_normal_matrix,
    counter_normals,
    random_words,
)
from smooth_operator.settings import check_choice, check_numbers


def _largest(values: Array, count: int) -> tuple[Array, Array]:
    """``lax.top_k``. Without the barrier, XLA on a CPU sorts all values, which is slower."""
    return lax.optimization_barrier(tuple(lax.top_k(values, count)))  # type: ignore


MOST_SAMPLES: Final = 1 << 20
MOST_CYCLES: Final = 10_000
"""Upper bounds, because larger values exceed the memory or take minutes."""

Cost: TypeAlias = Callable[[Sequence[Array]], Array]
"""Function from m arrays of a common shape (one per variable, batch last) to costs of that
shape."""


@dataclass(frozen=True)
class SamplingConfig:
    """Settings of the sampler (Algorithm 1); defaults are those of the Smooth Operator paper.

    Attributes:
        samples: N, candidates per cycle.
        elites: M, candidates that shape the next cycle.
        cycles: L, number of cycles.
        sigma: initial standard deviation [rad].
        temperature: lambda of the softmax over elites.
        jitter: epsilon, added to the diagonal of the covariance.
        draws: ``fresh`` for new normals in every cycle, as published; or ``quasi`` for always the
            same normals, of low discrepancy.
    """

    samples: int = 8192
    elites: int = 128
    cycles: int = 20
    sigma: float = 0.2
    temperature: float = 0.1
    jitter: float = 1e-6
    draws: Literal["fresh", "quasi"] = "fresh"

    def __post_init__(self) -> None:
        numbers = ("samples", "elites", "cycles", "sigma", "temperature", "jitter")
        check_numbers(self, "sampling.", positive=numbers)
        if self.elites > self.samples:
            raise ConfigError(
                "sampling needs samples >= elites, not "
                f"samples={self.samples}, elites={self.elites}"
            )
        if self.samples > MOST_SAMPLES or self.cycles > MOST_CYCLES:
            raise ConfigError(
                f"sampling takes at most {MOST_SAMPLES} samples and {MOST_CYCLES} cycles, not "
                f"samples={self.samples}, cycles={self.cycles}; the paper has 8192 and 20"
            )
        check_choice(self, "draws", ("fresh", "quasi"))


def sample_minimise(
    cost: Cost,
    start: Float[Array, " m"],
    limits: Float[np.ndarray, "m 2"],
    key: UInt32[Array, "2"],
    config: SamplingConfig,
    sigma: Float[Array, ""] | float | None = None,
    cycles: Int[Array, ""] | int | None = None,
) -> Float[Array, " m"]:
    """Minimises a cost within bounds by adaptive importance sampling (Algorithm 1).

    The last cycle, whose candidates the printed algorithm does not use, is left out. Candidates are
    clipped before they are scored, as in the authors' released code, not in line 14 only.

    Args:
        cost: cost of candidates, batch last; it is called only within the bounds.
        start: (m,) initial mean.
        limits: (m, 2) bounds.
        key: two random words; unused if the normals are fixed.
        config: hyper-parameters.
        sigma: initial standard deviation [rad], instead of the configured one; may be traced.
        cycles: L, instead of the configured one, which it must not exceed; may be traced.

    Returns:
        (m,) the final mean, clipped to the bounds.
    """
    size, dtype = len(limits), jnp.float32
    low, high = (jnp.asarray(limits[:, i], dtype) for i in (0, 1))
    gaussian = _ClippedGaussian(low, high, config)
    cycle_keys = random_words(key, max(config.cycles - 1, 1))  # an empty loop is traced, too
    ones = jnp.ones((1, config.elites), dtype)

    # Lines 1-2: mu' = q and Sigma' = diag(sigma^2) + epsilon I
    deviation = config.sigma if sigma is None else sigma
    mean = start.astype(dtype)
    chol = jnp.sqrt(deviation**2 + config.jitter) * jnp.eye(size, dtype=dtype)
    epsilon = config.jitter * jnp.eye(size, dtype=dtype)

    def cycle(mean: Array, chol: Array, cycle_key: Array) -> tuple[Array, Array]:
        # Line 4: draw the candidates. Line 5: compute their costs
        costs = cost(gaussian.draw_all(mean, chol, cycle_key))
        # Line 7: the M elites, best first
        rewards, index = _largest(-costs, config.elites)
        elites = gaussian.draw(mean, chol, cycle_key, index)
        # Line 8: J_min is the cost of the first elite. Line 9: w_m; the division by their sum is
        # cheaper after the next sum
        weights = jnp.exp((rewards - rewards[0]) / config.temperature)
        sums = jnp.concatenate([elites, ones]) @ weights
        # Line 10: the new mean
        mean = sums[:-1] / sums[-1]
        # Line 11: the covariance about the new mean
        centred = (elites - mean[:, None]) * jnp.sqrt(weights / sums[-1])
        covariance = centred @ centred.T + epsilon
        return mean, lax.linalg.cholesky(covariance, symmetrize_input=False)

    # Lines 3-13: L - 1 cycles
    count = config.cycles if cycles is None else cycles
    if kernels_available(config.samples):

        def cycle_in_kernel(i: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
            mean, chol, words = carry
            following: tuple[Array, ...] = next_gaussian(
                cost(gaussian.draw_all(mean, chol, words)),
                mean,
                chol,
                words,
                (key, i + 1),
                gaussian.base,
                limits,
                config.elites,
                config.temperature,
                config.jitter,
            )
            return following

        mean, *_ = lax.fori_loop(0, count - 1, cycle_in_kernel, (mean, chol, cycle_keys[0]))
    else:
        mean, _ = lax.fori_loop(
            0, count - 1, lambda i, carry: cycle(carry[0], carry[1], cycle_keys[i]), (mean, chol)
        )
    # Line 14: clip to the joint limits
    return jnp.clip(mean, low, high)


class _ClippedGaussian:
    """Draws from N(mean, chol chol^T), clipped to bounds; a draw is a function of its index."""

    def __init__(self, low: Array, high: Array, config: SamplingConfig) -> None:
        self.low, self.high, self.size = low, high, len(low)
        self.everyone = jnp.arange(config.samples, dtype=jnp.uint32)
        quasi = config.draws == "quasi"
        self.base = jnp.asarray(quasi_normals(self.size, config.samples)) if quasi else None

    def draw(self, mean: Array, chol: Array, words: Array, index: Array) -> Array:
        """Returns the samples at the given indices, as columns of an array (m, len(index))."""
        if self.base is None:
            normals = counter_normal_matrix(index.astype(jnp.uint32), words, self.size)
        else:
            normals = self.base if index is self.everyone else self.base[:, index]
        return jnp.clip(mean[:, None] + chol @ normals, self.low[:, None], self.high[:, None])

    def draw_all(self, mean: Array, chol: Array, words: Array) -> list[Array]:
        """All N draws, as m arrays (N,). The product with ``chol`` is written out, so that drawing,
        kinematics and cost fuse into one loop, unless the normals are fixed."""
        if self.base is not None:
            return list(self.draw(mean, chol, words, self.everyone))
        normals = counter_normals(self.everyone, words, self.size)
        rows = []
        for i in range(self.size):
            row = mean[i] + chol[i, 0] * normals[0]
            for j in range(1, i + 1):
                row = row + chol[i, j] * normals[j]
            rows.append(lax.clamp(self.low[i], row, self.high[i]))
        return rows


def quasi_normals(count: int, samples: int) -> Float[np.ndarray, "count samples"]:
    """(count, samples) standard normals of low discrepancy, the same in every frame. They are the
    shifted additive recurrence of Roberts' generalised golden ratio."""
    rng = np.random.default_rng(0)
    ratio = 2.0
    for _ in range(64):  # the root of x^(count + 1) = x + 1
        ratio = (1 + ratio) ** (1 / (count + 1))
    steps = ratio ** -np.arange(1.0, count + 1)
    points = (rng.random((count, 1)) + steps[:, None] * np.arange(1, samples + 1)) % 1.0
    inverse = NormalDist().inv_cdf  # SciPy takes 0.5 s to import
    quantiles = [inverse(u) for u in np.clip(points, 1e-6, 1 - 1e-6).ravel()]
    return _whitened(np.array(quantiles).reshape(count, samples))


def _whitened(normals: Float[np.ndarray, "count samples"]) -> Float[np.ndarray, "count samples"]:
    """Gives the samples mean 0 and covariance I, if there are enough: a few hundred fixed normals
    in 16 dimensions would otherwise have a constant bias."""
    count, samples = normals.shape
    if samples > 2 * count:
        normals = normals - normals.mean(axis=1, keepdims=True)
        normals = np.linalg.solve(np.linalg.cholesky(normals @ normals.T / samples), normals)
    return normals.astype(np.float32)
