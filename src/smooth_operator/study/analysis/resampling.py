"""Samples of operators: whole operators are drawn, or change sign, with all of their rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

DRAWS: Final = 2000


@dataclass(frozen=True)
class Drawn:
    """A number with its 95 % percentile interval of a bootstrap over operators."""

    estimate: float
    lower: float
    upper: float


def drawn(value: float, draws: np.ndarray) -> Drawn:
    """A number and the 2.5 and 97.5 % points of what the bootstrap has (draws,), NaN left out."""
    finite = draws[np.isfinite(draws)]
    low, high = np.percentile(finite, [2.5, 97.5]) if len(finite) else (np.nan, np.nan)
    return Drawn(float(value), float(low), float(high))


def operator_weights(operators: int, *, seed: int, draws: int = DRAWS) -> Float[np.ndarray, "k g"]:
    """How often each operator is in each sample; the first sample has everybody once.

    Args:
        operators: how many there are.
        seed: of the draws.
        draws: samples after the first.
    """
    rng = np.random.default_rng(seed)
    chosen = rng.integers(operators, size=(draws, operators))
    counts = np.zeros((draws + 1, operators))
    counts[0] = 1
    np.add.at(counts, (np.arange(1, draws + 1)[:, None], chosen), 1)
    return counts


def operator_signs(operators: int, *, seed: int, draws: int) -> Float[np.ndarray, "k g"]:
    """1 or -1 for each operator of each sample, for tests that change operators' signs.

    Args:
        operators: how many there are.
        seed: of the draws.
        draws: samples.
    """
    return np.random.default_rng(seed).choice([-1.0, 1.0], (draws, operators))
