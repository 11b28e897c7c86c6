"""Separable CMA-ES: a search of many numbers by their order of merit alone.

R. Ros and N. Hansen, "A Simple Modification in CMA-ES Achieving Linear Time and Space Complexity",
PPSN 2008. The covariance is diagonal, which a few thousand evaluations of a hundred numbers can
learn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Evolution:
    """The state of a search; a value that is replaced, never changed.

    Attributes:
        mean: (n,) centre of the candidates.
        sigma: step size.
        variance: (n,) of each number, in units of ``sigma``.
        path: (n,) evolution path of the step size.
        path_c: (n,) evolution path of the variances.
        generation: how many have been judged.
        seed: of the random numbers.
        count: candidates in a generation.
    """

    mean: Float[np.ndarray, " n"]
    sigma: float
    variance: Float[np.ndarray, " n"]
    path: Float[np.ndarray, " n"]
    path_c: Float[np.ndarray, " n"]
    generation: int = 0
    seed: int = 0
    count: int = 16

    @classmethod
    def begin(cls, mean: Float[np.ndarray, " n"], sigma: float, seed: int, count: int) -> Self:
        """A search around a point."""
        zero = np.zeros_like(mean)
        return cls(mean, sigma, np.ones_like(mean), zero, zero, 0, seed, count)

    def candidates(self) -> Float[np.ndarray, "c n"]:
        """(c, n) the points to be judged next; the same for the same state."""
        rng = np.random.default_rng([self.seed, self.generation])
        draws = rng.standard_normal((self.count, len(self.mean)))
        return np.asarray(self.mean + self.sigma * np.sqrt(self.variance) * draws)

    def judged(self, candidates: Float[np.ndarray, "c n"], merits: Float[np.ndarray, " c"]) -> Self:
        """The next state; more merit is better."""
        n, half = len(self.mean), self.count // 2
        weights = np.log(half + 0.5) - np.log(np.arange(1, half + 1))
        weights /= weights.sum()
        mass = 1.0 / (weights**2).sum()
        c_sigma = (mass + 2.0) / (n + mass + 5.0)
        damping = 1.0 + c_sigma + 2.0 * max(0.0, np.sqrt((mass - 1.0) / (n + 1.0)) - 1.0)
        c_c = (4.0 + mass / n) / (n + 4.0 + 2.0 * mass / n)
        c_1 = 2.0 / ((n + 1.3) ** 2 + mass)
        c_mu = min(1.0 - c_1, 2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2.0) ** 2 + mass))
        faster = (n + 2.0) / 3.0  # what a diagonal allows
        c_1, c_mu = min(c_1 * faster, 0.5), min(c_mu * faster, 0.5)
        best = candidates[np.argsort(-merits, kind="stable")[:half]]
        steps = (best - self.mean) / self.sigma
        step = weights @ steps
        path = (1.0 - c_sigma) * self.path + np.sqrt(
            c_sigma * (2.0 - c_sigma) * mass
        ) * step / np.sqrt(self.variance)
        usual = np.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))
        length = float(np.linalg.norm(path))
        still = length / np.sqrt(1.0 - (1.0 - c_sigma) ** (2 * (self.generation + 1)))
        grows = still < (1.4 + 2.0 / (n + 1.0)) * usual
        path_c = (1.0 - c_c) * self.path_c + grows * np.sqrt(c_c * (2.0 - c_c) * mass) * step
        variance = (
            (1.0 - c_1 - c_mu) * self.variance + c_1 * path_c**2 + c_mu * (weights @ steps**2)
        )
        sigma = self.sigma * float(np.exp(c_sigma / damping * (length / usual - 1.0)))
        return replace(
            self, mean=self.mean + self.sigma * step, sigma=sigma, variance=variance, path=path,
            path_c=path_c, generation=self.generation + 1,
        )  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> Self:
        """From what ``to_json`` gave."""
        values: dict[str, Any] = {
            name: np.array(value) if isinstance(value, list) else value
            for name, value in content.items()
        }
        return cls(**values)
