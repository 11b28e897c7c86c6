"""Dunnett's single-step comparison of each retargeter with the baseline.

The contrasts are those of a fitted model, so they correlate as the model's covariance says, and not
as a balanced one-way layout would: the p-value of one is the probability that the largest of them
all is as far out. Where contrasts have their own degrees of freedom, each p-value uses its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from smooth_operator.study.analysis.multivariate import outside

_PINNED: Final = 1e-13
_STEPS: Final = 20
_CLOSE: Final = 1e-6
"""Relative error of the probability at which the search for a limit ends."""


@dataclass(frozen=True)
class Dunnett:
    """A family of comparisons with one baseline.

    Attributes:
        p: adjusted, of each comparison.
        critical: how many standard errors a simultaneous interval reaches, of each; NaN if not
            asked for.
        error: largest estimate of the error of a p-value.
    """

    p: tuple[float, ...]
    critical: tuple[float, ...]
    error: float


def two_sided(statistic: float, freedom: float) -> float:
    """Unadjusted p of a z (infinite degrees of freedom) or t statistic."""
    if np.isfinite(freedom):
        return float(2 * stdtr(freedom, -abs(statistic)))
    return float(2 * ndtr(-abs(statistic)))


def quantile(freedom: float, tail: float = 0.025) -> float:
    """How many standard errors an interval reaches that leaves ``tail`` out at either end."""
    return float(-stdtrit(freedom, tail) if np.isfinite(freedom) else -ndtri(tail))


def dunnett(
    statistics: Sequence[float],
    correlation: Float[np.ndarray, "m m"],
    freedom: Sequence[float],
    *,
    level: float | None = 0.95,
) -> Dunnett:
    """Adjusted p-values and simultaneous limits.

    Args:
        statistics: estimate over standard error of each comparison.
        correlation: of the estimates.
        freedom: degrees of freedom of each; infinite for normal ones.
        level: of the intervals; None for no limits, which is quicker.

    Returns:
        The family. No p is below its unadjusted one, or above that times their number.
    """
    count = len(statistics)
    adjusted, errors = [], []
    for statistic, df in zip(statistics, freedom, strict=True):
        raw = two_sided(statistic, df)
        if (count - 1) * raw < _PINNED:  # between its bounds there is nothing left to find out
            p, error = count * raw, 0.0
        else:
            p, error = outside(abs(statistic), correlation, df)
        # Both bounds hold exactly; deep in the tail they know better than a difference from one.
        adjusted.append(float(np.clip(p, raw, min(1.0, count * raw))))
        errors.append(min(error, (count - 1) * raw))
    critical = [float("nan")] * count
    if level is not None and count:
        limits = {df: _critical(correlation, df, level) for df in set(freedom)}
        critical = [limits[df] for df in freedom]
    return Dunnett(tuple(adjusted), tuple(critical), max(errors, default=0.0))


def _critical(correlation: Float[np.ndarray, "m m"], freedom: float, level: float) -> float:
    alpha = 1 - level
    low, high = quantile(freedom, alpha / 2), quantile(freedom, alpha / 2 / len(correlation))
    if len(correlation) == 1:
        return low

    def excess(limit: float) -> float:
        # The logarithm is nearly a straight line, so the secant takes few steps.
        return float(np.log(outside(limit, correlation, freedom)[0] / alpha))

    a, b = low, high
    at_a, at_b = excess(a), excess(b)
    if at_a <= 0:  # all comparisons are one and the same
        return low
    for _ in range(_STEPS):
        if abs(at_b) < _CLOSE or at_a == at_b:
            break
        a, b, at_a = b, float(np.clip(b - at_b * (b - a) / (at_b - at_a), low, high)), at_b
        at_b = excess(b)
    return b
