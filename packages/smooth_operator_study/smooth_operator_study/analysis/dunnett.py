"""Tests of single and multiple comparisons: t, Holm, and Dunnett with a model's correlations.

Dunnett's single-step test compares each retargeter with the baseline. The contrasts of a fitted
model have the correlations of its covariance, not those of a balanced one-way layout, which
``scipy.stats.dunnett`` assumes. The p-value of a contrast is the probability that the largest of
all contrasts is as extreme, with the degrees of freedom of this contrast.

The probability that a multivariate t lies in a box is an integral over its chi variable of the
probability of normal boxes (Genz and Bretz 2009, chapters 3 and 4). The latter is a smooth function
of the size of the box. It is computed once for a correlation matrix, at Chebyshev points, for every
limit and every number of degrees of freedom. Up to five variables are integrated by nested
Gauss-Legendre rules, which are more accurate and faster than SciPy's quasi-random points (used for
more variables, and for singular correlations of rank three and more). Fewer operators than
coefficients make a correlation singular. With rank two its box is a polygon in the plane of two
normal variables, whose probability is one integral over the angle. The same data give the same
p-value in every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import Chebyshev
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq
from scipy.special import gammainccinv, gammaincinv, gammaln, ndtr, ndtri, stdtr, stdtrit
from scipy.stats import multivariate_normal

_PINNED: Final = 1e-13
_FAR: Final = 8.7
"""Limit beyond which the probability of a normal variable is zero in double precision."""
_LARGEST: Final = 6.0
"""Size from which the probability outside a box equals the sum over its sides to 1e-8."""
_DEGREE: Final = 44
"""Degree of the Chebyshev polynomial over sizes from 0 to the largest."""
_NODES: Final = {1: (2, 2), 2: (48, 64), 3: (48, 64), 4: (30, 36), 5: (19, 22)}
"""Number of variables -> nodes in each direction: fewer for the error estimate, then all."""
_CHECKED: Final = np.array([1.0, 2.0, 3.0, 4.0])
"""Sizes at which the two numbers of nodes are compared."""
_CLOSE: Final = 1e-7
"""Difference between the two rules above which SciPy's points are used instead."""
_POINTS: Final = 100_000
"""Number of SciPy's points for one box."""
_POINTS_ERROR: Final = 1e-5
"""Error of a probability by SciPy's points."""
_SINGULAR_ERROR: Final = 1e-4
"""Error of a probability by SciPy's points for a singular correlation matrix."""
_SINGULAR: Final = 1e-9
"""Smallest eigenvalue below which a correlation matrix counts as singular."""
_POLYGON_ERROR: Final = 1e-8
_ANGLES: Final = 48
"""Number of nodes between two corners of a polygon."""
_CHI_NODES: Final = 240
_DIVISOR: Final = float(np.sqrt(2 * np.pi))


@dataclass(frozen=True)
class Dunnett:
    """A family of comparisons with one baseline.

    Attributes:
        p: adjusted p-value of each comparison.
        critical: half width of each simultaneous interval in standard errors; NaN if not requested.
        error: largest estimated error of a p-value.
    """

    p: tuple[float, ...]
    critical: tuple[float, ...]
    error: float


def two_sided(statistic: float, freedom: float) -> float:
    """Returns the unadjusted p-value of a t statistic; of z for infinite degrees of freedom."""
    if np.isfinite(freedom):
        return float(2 * stdtr(freedom, -abs(statistic)))
    return float(2 * ndtr(-abs(statistic)))


def quantile(freedom: float, tail: float = 0.025) -> float:
    """Half width of an interval that excludes ``tail`` at each end [standard errors]."""
    return float(-stdtrit(freedom, tail) if np.isfinite(freedom) else -ndtri(tail))


def holm(p: Sequence[float]) -> list[float]:
    """Adjusts p-values by Holm (1979): the smallest times m, the next times m - 1, never falling.

    statsmodels' ``multipletests`` collects garbage in each call, which takes 0.1 to 1 s.

    Args:
        p: unadjusted p-values of the family; none NaN.

    Returns:
        Adjusted p-values in the order of ``p``, at most 1.
    """
    raw = np.asarray(p, float)
    order = np.argsort(raw, kind="stable")
    adjusted = np.empty_like(raw)
    adjusted[order] = np.maximum.accumulate(raw[order] * np.arange(len(raw), 0, -1))
    return [float(value) for value in np.minimum(adjusted, 1.0)]


def dunnett(
    statistics: Sequence[float],
    correlation: Float[np.ndarray, "m m"],
    freedom: Sequence[float],
    *,
    level: float | None = 0.95,
    decide: float | None = None,
) -> Dunnett:
    """Computes adjusted p-values and simultaneous limits.

    Args:
        statistics: estimate over standard error of each comparison.
        freedom: degrees of freedom of each comparison; infinite for normal ones.
        level: confidence level of the intervals; None for no intervals, which is faster.
        decide: significance level. A p-value whose bounds lie on one side of it is then replaced by
            a bound. None computes all p-values.

    Returns:
        The family. Each p-value is at least the unadjusted one, and at most that times the number
        of comparisons.
    """
    count = len(statistics)
    adjusted, errors = [], []
    for statistic, df in zip(statistics, freedom, strict=True):
        raw = two_sided(statistic, df)
        if (count - 1) * raw < _PINNED:  # its bounds are equal in double precision
            p, error = count * raw, 0.0
        elif decide is not None and (raw > decide or count * raw <= decide):
            p, error = (raw if raw > decide else count * raw), 0.0
        else:
            p, error = outside(abs(statistic), correlation, df)
        # The bounds are exact; deep in the tail they are closer than a difference from 1.
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

    def excess(limit: float) -> float:
        return float(np.log(outside(limit, correlation, freedom)[0] / alpha))

    if len(correlation) == 1 or excess(low) <= 0:  # all comparisons are equal
        return low
    if excess(high) >= 0:  # Bonferroni's limit is reached within the error
        return high
    return float(brentq(excess, low, high, xtol=1e-10))


def outside(
    limit: float, correlation: Float[np.ndarray, "m m"], freedom: float = np.inf
) -> tuple[float, float]:
    """Computes P(max |T_j| > limit) of correlated t or normal variables.

    Args:
        freedom: degrees of freedom of the t; infinite for normal variables.

    Returns:
        The probability, and an estimate of its error.
    """
    if limit <= 0:
        return 1.0, 0.0
    correlation = _distinct(correlation)
    count = len(correlation)
    if count == 1:
        return two_sided(limit, freedom), 0.0
    boxes, error = _boxes(np.ascontiguousarray(correlation).tobytes(), count)
    scales, weights = _chi(freedom)
    sizes = limit * scales
    beyond = np.where(
        sizes < _LARGEST, 1 - boxes(np.minimum(sizes, _LARGEST)), 2 * count * ndtr(-sizes)
    )
    return float(np.clip(weights @ beyond, 0.0, 1.0)), error


def _distinct(correlation: Float[np.ndarray, "m m"]) -> Float[np.ndarray, "k k"]:
    """Removes variables that equal an earlier variable up to the sign."""
    distinct: list[int] = []
    for j in range(len(correlation)):
        if not np.any(np.abs(correlation[j, distinct]) > 1 - 1e-12):
            distinct.append(j)
    return correlation[np.ix_(distinct, distinct)]


def _chi(freedom: float) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Nodes and weights of the chi variable over the root of its degrees of freedom.

    They are those of the trapezoidal rule for its logarithm, whose density vanishes at both ends.
    """
    if not np.isfinite(freedom):
        return np.ones(1), np.ones(1)
    half = freedom / 2
    low, high = (np.log(f(half, 1e-17) / half) / 2 for f in (gammaincinv, gammainccinv))
    logs, step = np.linspace(low, high, _CHI_NODES, retstep=True)
    squares = np.exp(2 * logs)
    density = np.log(2) + half * np.log(half) - gammaln(half) + freedom * logs - half * squares
    return np.exp(logs), step * np.exp(density)


@lru_cache(maxsize=256)
def _boxes(correlation: bytes, count: int) -> tuple[Chebyshev, float]:
    """Interpolates P(|Z_j| <= size for all j) of normal variables over the size; with its error."""
    matrix = np.frombuffer(correlation).reshape(count, count)
    domain = [0.0, _LARGEST]
    values, axes = np.linalg.eigh(matrix)
    singular = values[0] <= _SINGULAR
    if count > 2 and values[-3] <= _SINGULAR:
        factor = axes[:, -2:] * np.sqrt(values[-2:])
        return Chebyshev.interpolate(
            lambda sizes: _polygon(sizes, factor), _DEGREE, domain
        ), _POLYGON_ERROR
    if count in _NODES and not singular:
        factor = np.linalg.cholesky(_ordered(matrix))
        few, many = (_nested(_CHECKED, factor, nodes) for nodes in _NODES[count])
        error = float(np.max(np.abs(few - many)))
        if error < _CLOSE:
            nodes = _NODES[count][1]
            return Chebyshev.interpolate(
                lambda sizes: _nested(sizes, factor, nodes), _DEGREE, domain
            ), error
    normal = multivariate_normal(
        np.zeros(count), matrix, allow_singular=True, seed=1, maxpts=_POINTS, abseps=0, releps=0
    )

    def by_points(sizes: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        return np.array(
            [normal.cdf(np.full(count, s), lower_limit=np.full(count, -s)) for s in sizes]
        )

    return Chebyshev.interpolate(
        by_points, _DEGREE, domain
    ), _SINGULAR_ERROR if singular else _POINTS_ERROR


def _polygon(
    sizes: Float[np.ndarray, " k"], factor: Float[np.ndarray, "m 2"]
) -> Float[np.ndarray, " k"]:
    """Computes P(|L z| <= size) of two independent normal z for each size, by polar coordinates.

    In a direction u the edge lies at the distance size / max_j |L_j u|, within which z lies with
    probability 1 - exp(-distance² / 2). Between two corners of the polygon this is smooth.
    """
    lines = np.vstack(
        [
            factor[i] + sign * factor[j]
            for i in range(len(factor))
            for j in range(i)
            for sign in (-1, 1)
        ]
    )
    # Two of the |L_j u| are equal where u is perpendicular to a sum or difference of their rows.
    corners = np.unique(np.append(np.arctan2(-lines[:, 0], lines[:, 1]) % np.pi, [0.0, np.pi]))
    points, weights = leggauss(_ANGLES)
    half = np.diff(corners)[:, None] / 2
    angles = (corners[:-1, None] + half * (1 + points)).ravel()
    reach = np.max(np.abs(factor @ np.array([np.cos(angles), np.sin(angles)])), axis=0)
    inside = -np.expm1(-((sizes[:, None] / reach) ** 2) / 2)
    return np.asarray(inside @ (half * weights).ravel() / np.pi)


def _ordered(correlation: Float[np.ndarray, "m m"]) -> Float[np.ndarray, "m m"]:
    """Orders variables so that each is the least determined by earlier ones, for smooth limits."""
    left, chosen = list(range(len(correlation))), list[int]()
    while left:
        earlier, cross = correlation[np.ix_(chosen, chosen)], correlation[np.ix_(left, chosen)]
        explained = np.sum(cross * np.linalg.solve(earlier, cross.T).T, axis=1)
        chosen.append(left.pop(int(np.argmin(explained))))
    return correlation[np.ix_(chosen, chosen)]


def _nested(
    sizes: Float[np.ndarray, " k"], factor: Float[np.ndarray, "m m"], nodes: int
) -> Float[np.ndarray, " k"]:
    """Computes P(|L z| <= size) of independent normal z, L lower triangular, for each size."""
    points, weights = leggauss(nodes)

    def inside(
        means: Sequence[np.ndarray], size: np.ndarray, factor: Float[np.ndarray, "j j"]
    ) -> np.ndarray:
        """Probability of the remaining variables at their conditional means."""
        low, high = ((side * size - means[0]) / factor[0, 0] for side in (-1, 1))
        if len(means) == 1:
            return np.asarray(ndtr(high) - ndtr(low))
        low, high = np.clip(low, -_FAR, _FAR), np.clip(high, -_FAR, _FAR)
        half = (high - low) / 2
        here = half[..., None] * points + (half + low)[..., None]
        further = [
            mean[..., None] + own * here for mean, own in zip(means[1:], factor[1:, 0], strict=True)
        ]
        rest = inside(further, size[..., None], factor[1:, 1:]) * np.exp(-(here**2) / 2)
        return np.asarray(half * (rest @ weights) / _DIVISOR)

    start = [np.zeros(())] * len(factor)
    return np.array([float(inside(start, np.asarray(size), factor)) for size in sizes])
