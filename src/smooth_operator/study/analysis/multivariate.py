"""P(|T_j| <= c for all j) of correlated normal or t variables, by exact integration.

Variables are taken one after the other: given the ones before, each is normal with a mean that
depends on them, so the box becomes nested integrals with smooth limits, and the innermost one is a
difference of two normal distribution functions. Gauss-Legendre nodes then converge geometrically. A
t divides all of them by one chi variable, which is one more integral over the probability of a
normal box. That is a smooth function of the box's size alone, so it is worked out once for a
correlation, at Chebyshev points, and serves every limit and every number of degrees of freedom. Two
and fewer independent directions are one integral over an angle, exact for singular correlations as
well. Many variables go to ``smooth_operator.study.analysis.quasi_random``.

Source: Genz and Bretz 2009, chapters 3 and 4. Nothing depends on a random seed: the same data give
the same p-value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc, gammainc, gammainccinv, gammaincinv, gammaln, ndtr

from smooth_operator.study.analysis.quasi_random import apart_by_points

_FAR: Final = 8.7
"""Where a normal variable has no probability left to double precision."""
_SINGULAR: Final = 1e-9
"""Eigenvalues of a correlation matrix below this are taken for zero."""
_NODES: Final = {3: (12, 20, 32, 64, 160), 4: (10, 14, 20, 30, 44), 5: (8, 10, 12, 14, 16, 20, 24)}
"""Nodes along each direction, coarse to fine, by number of directions."""
_NESTED: Final = 5
"""Most variables that are integrated by nodes; for more it is quasi-random points."""
_LARGEST: Final = {3: 7.5, 4: 6.5}
"""Size from which on the outside of a box is the sum of its sides, by number of directions."""
_LARGE: Final = 5.5
"""The same for more directions."""
_SIZES: Final = {3: 48, 4: 40}
"""Chebyshev points over the sizes below, by number of directions."""
_FEW_SIZES: Final = 32
"""The same for more directions."""
_BANDS: Final = (0.0, 2.0, 2.8, 3.4, 4.0, 4.6, 5.2, 6.0, np.inf)
"""Between these, boxes need as many nodes; the larger, the more."""
_LEAST: Final = {3: 1e-9, 4: 1e-8, 5: 1e-7}
"""Error that no more nodes are tried for, by number of directions."""
_ROUGH: Final = 1e-6
"""Error that is enough for points."""
_FACTOR_NODES: Final = 160
"""Over the one factor of the approximation."""
_MOST_SHARED: Final = 0.95
"""Largest share of a variable that its factor explains in the one-factor approximation."""
_CHI_NODES: Final = 14
_BLOCK: Final = 15_000
"""Nodes evaluated together: they stay in the processor's cache, and their arrays below the 128 KiB
from which on the C library has each mapped by the system, page by page."""
_ENTRIES: Final = 1024
"""Of the table of the normal distribution, for one standard deviation."""


def outside(
    limit: float,
    correlation: Float[np.ndarray, "m m"],
    freedom: float = np.inf,
) -> tuple[float, float]:
    """P(max |T_j| > limit).

    Args:
        limit: c, zero or more.
        correlation: of the variables.
        freedom: degrees of freedom of the t; infinite for normal variables.

    Returns:
        (probability, estimate of its error).
    """
    if limit <= 0:
        return 1.0, 0.0
    values, vectors = np.linalg.eigh(correlation)
    if np.sum(values > _SINGULAR) <= 2:
        # rounding of a zero is not a direction: its root would be 1e-8
        factor = vectors[:, -2:] * np.sqrt(np.where(values[-2:] > _SINGULAR, values[-2:], 0.0))
        return _by_angle(limit, factor, freedom)
    if values[0] < _SINGULAR:  # no factor; a little independence moves no probability by 1e-6
        correlation = (correlation + 1e-8 * np.eye(len(values))) / (1 + 1e-8)
    boxes = _boxes_of(correlation.tobytes(), len(correlation))
    scales, weights, rest = _chi_nodes(limit, freedom)
    beyond, errors = boxes(limit * scales)
    probability = rest + float(weights @ beyond)
    return float(np.clip(probability, 0.0, 1.0)), float(weights @ errors)


@dataclass(frozen=True, eq=False)
class _Boxes:
    """P(|Z_j| > size for any j) of correlated normal variables, for every size.

    Attributes:
        count: of the variables.
        largest: size from which on the sides do not overlap.
        coefficients: of Chebyshev polynomials over sizes from 0 to ``largest`` (k,).
        sizes: rising (s,).
        errors: estimate of the error at each (s,).
    """

    count: int
    largest: float
    coefficients: Float[np.ndarray, " k"]
    sizes: Float[np.ndarray, " s"]
    errors: Float[np.ndarray, " s"]

    def __call__(
        self, sizes: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """(probability, estimate of its error)."""
        at = np.minimum(2 * sizes / self.largest - 1, 1.0)
        within = 1 - np.polynomial.chebyshev.chebval(at, self.coefficients)
        one = 2 * ndtr(-sizes)
        far = sizes >= self.largest
        return (
            np.where(far, self.count * one, within),
            np.where(far, (self.count - 1) * one, np.interp(sizes, self.sizes, self.errors)),
        )


@lru_cache(maxsize=256)
def _boxes_of(correlation: bytes, count: int) -> _Boxes:
    matrix = _ordered(np.frombuffer(correlation).reshape(count, count))
    loadings = _loadings(matrix)
    near = np.outer(loadings, loadings)
    np.fill_diagonal(near, 1.0)
    factors = np.linalg.cholesky(matrix), np.linalg.cholesky(near)
    largest, number = _LARGEST.get(count, _LARGE), _SIZES.get(count, _FEW_SIZES)
    angles = np.pi * (np.arange(number) + 0.5) / number
    sizes = largest * (np.cos(angles) + 1) / 2
    if count <= _NESTED:
        apart, errors = _apart(sizes, factors)
    else:
        apart, errors = apart_by_points(sizes, *factors, enough=_ROUGH)
    values = _by_factor(sizes, loadings) + apart
    terms = np.cos(np.outer(np.arange(number), angles)) @ values * 2 / number
    terms[0] /= 2
    return _Boxes(count, largest, terms, sizes[::-1], errors[::-1])


def _apart(
    sizes: Float[np.ndarray, " k"],
    factors: tuple[Float[np.ndarray, "m m"], Float[np.ndarray, "m m"]],
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Box probabilities of a factor minus those of a near one, and estimates of their errors.

    Errors of the nodes are nearly the same for both, so that the difference has few of them.
    """
    count = len(factors[0])
    found, errors = np.zeros(len(sizes)), np.zeros(len(sizes))
    for low, high in pairwise(_BANDS):
        band = np.flatnonzero((sizes >= low) & (sizes < high))
        if not len(band):
            continue
        before = np.full(len(band), np.nan)
        for nodes in _NODES[count]:
            here, there = (_boxes(sizes[band], factor, nodes) for factor in factors)
            found[band] = here - there
            errors[band] = np.abs(found[band] - before)
            if np.max(errors[band]) < _LEAST[count]:
                break
            before = found[band]
    return found, errors


def _loadings(correlation: Float[np.ndarray, "m m"]) -> Float[np.ndarray, " m"]:
    """λ of the nearest matrix with correlations λ_i λ_j, or one that is about as near.

    Differences from one baseline share it as their one factor, so it is near for them.
    """
    shared = np.sort(np.abs(correlation), axis=1)[:, -2]
    for _ in range(30):
        reduced = correlation.copy()
        np.fill_diagonal(reduced, shared)
        values, vectors = np.linalg.eigh(reduced)
        loadings = vectors[:, -1] * np.sqrt(max(values[-1], 0.0))
        shared = np.minimum(loadings**2, _MOST_SHARED)
    return np.asarray(np.sign(loadings) * np.sqrt(shared))


def _by_factor(
    sizes: Float[np.ndarray, " k"], loadings: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " k"]:
    """Box probabilities of variables that are independent given one factor."""
    points, weights = _legendre(_FACTOR_NODES)
    factor = _FAR * points
    density = _FAR * weights * np.exp(-(factor**2) / 2) / np.sqrt(2 * np.pi)
    mean = factor[:, None] * loadings
    own = np.sqrt(1 - loadings**2)
    size = sizes[:, None, None]
    inside = ndtr((size - mean) / own) - ndtr((-size - mean) / own)
    return np.asarray(inside.prod(axis=2) @ density)


def _ordered(correlation: Float[np.ndarray, "m m"]) -> Float[np.ndarray, "m m"]:
    """The same variables, each the least determined by the previous ones: keeps limits smooth."""
    left = list(range(len(correlation)))
    chosen: list[int] = []
    while left:
        known = correlation[np.ix_(chosen, chosen)]
        spread = []
        for j in left:
            cross = correlation[j, chosen]
            explained = float(cross @ np.linalg.solve(known, cross)) if chosen else 0.0
            spread.append(1 - explained)
        chosen.append(left.pop(int(np.argmax(spread))))
    return correlation[np.ix_(chosen, chosen)]


@lru_cache(maxsize=64)
def _legendre(nodes: int) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    points, weights = np.polynomial.legendre.leggauss(nodes)
    return points, weights


def _chi_nodes(
    limit: float, freedom: float
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], float]:
    """Nodes and weights of the chi variable that divides a t, and what lies below all of them.

    Beyond ``_FAR / limit`` the box holds everything; there is nothing to integrate.
    """
    if not np.isfinite(freedom):
        return np.ones(1), np.ones(1), 0.0
    half_freedom = freedom / 2
    low = float(np.sqrt(gammaincinv(half_freedom, 1e-17) / half_freedom))
    high = float(np.sqrt(gammainccinv(half_freedom, 1e-17) / half_freedom))
    high = min(high, 1.2 * _FAR / limit)
    if high <= low:
        return np.ones(1), np.zeros(1), float(gammainc(half_freedom, half_freedom * high**2))
    # Panels where the density or the box changes: about its mean, and about 1 / limit.
    spread = np.sqrt(0.5 / freedom)
    about_mean = [1 + spread * times for times in (-4, -1.5, 0, 1.5, 4)]
    inner = [v for v in (1 / limit, 3 / limit, *about_mean) if low < v < high]
    edges = np.array(sorted({low, *inner, high}))
    points, weights = _legendre(_CHI_NODES)
    half = np.diff(edges) / 2
    nodes = (edges[:-1] + half)[:, None] + half[:, None] * points
    logarithm = np.log(2) + half_freedom * np.log(half_freedom) - gammaln(half_freedom)
    logarithm = logarithm + (freedom - 1) * np.log(nodes) - half_freedom * nodes**2
    total = half[:, None] * weights * np.exp(logarithm)
    keep = total.ravel() > 1e-19
    return (
        nodes.ravel()[keep],
        total.ravel()[keep],
        float(gammainc(half_freedom, half_freedom * low**2)),
    )


def _boxes(
    limits: Float[np.ndarray, " k"], factor: Float[np.ndarray, "m m"], nodes: int
) -> Float[np.ndarray, " k"]:
    """P(|L z| <= limit) of independent normal z, with L lower triangular, for each limit."""
    points, weights = _legendre(nodes)
    # By symmetry z_1 and -z_1 hold the same.
    top = np.minimum(limits / factor[0, 0], _FAR)[:, None]
    first = top / 2 * (points + 1)
    weight = top * weights * np.exp(-(first**2) / 2) / np.sqrt(2 * np.pi)
    known, limit = first.ravel(), np.repeat(limits, nodes)
    block = max(1, _BLOCK // nodes ** (len(factor) - 2))
    inside = []
    for start in range(0, len(known), block):
        part = slice(start, start + block)
        means = [own * known[part] for own in factor[1:, 0]]
        inside.append(_rest(means, limit[part], factor[1:, 1:], points, weights))
    return np.asarray(np.sum(weight * np.concatenate(inside).reshape(weight.shape), axis=1))


def _rest(
    means: Sequence[Float[np.ndarray, "..."]],
    limit: Float[np.ndarray, "..."],
    factor: Float[np.ndarray, "j j"],
    points: Float[np.ndarray, " q"],
    weights: Float[np.ndarray, " q"],
) -> Float[np.ndarray, "..."]:
    """P(|mean + L z| <= limit) of the variables that are left, given their means so far."""
    low = (-limit - means[0]) / factor[0, 0]
    high = (limit - means[0]) / factor[0, 0]
    if len(means) == 1:
        return np.asarray(_normal(high) - _normal(low))
    low, high = np.clip(low, -_FAR, _FAR), np.clip(high, -_FAR, _FAR)
    half = (high - low) / 2
    # Nodes along a new first axis: rows stay together in memory.
    here = np.multiply.outer(points, half)
    here += (low + high) / 2
    further = []
    for mean, own in zip(means[1:], factor[1:, 0], strict=True):
        further.append(own * here)
        further[-1] += mean
    inside = _rest(further, limit, factor[1:, 1:], points, weights)
    here *= here
    here *= -0.5
    inside *= np.exp(here, out=here)
    within = weights @ inside.reshape(len(weights), -1)
    return np.asarray(half * within.reshape(half.shape) / np.sqrt(2 * np.pi))


def _normal(x: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """The distribution function, by Taylor's series about the nearest entry of a table.

    To 2e-15; ``ndtr`` takes longer for many values, and they are most of the work here.
    """
    values, slopes = _normal_table()
    scaled = np.clip(x, -_FAR, _FAR)
    scaled *= _ENTRIES
    nearest = np.rint(scaled)
    away = (scaled - nearest) * (1 / _ENTRIES)
    place = nearest.astype(np.intp)
    place += len(values) // 2
    nearest *= 1 / _ENTRIES
    series = away * (away * (nearest * nearest - 1) * (1 / 3) - nearest) * 0.5
    series += 1
    series *= away
    series *= slopes.take(place)
    series += values.take(place)
    return np.asarray(series)


@lru_cache(maxsize=1)
def _normal_table() -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    most = int(np.ceil(_FAR * _ENTRIES))
    at = np.arange(-most, most + 1) / _ENTRIES
    return np.asarray(ndtr(at)), np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi)


def _by_angle(
    limit: float, factor: Float[np.ndarray, "m 2"], freedom: float
) -> tuple[float, float]:
    """The same in two directions: the radius has a closed form, the angle is one integral.

    Between the angles at which two variables are equally far out, one of them alone decides.
    """
    angles = [0.0, np.pi]
    for i in range(len(factor)):
        for j in range(i):
            for sign in (1, -1):
                normal = factor[i] + sign * factor[j]
                if np.hypot(*normal) > 1e-12:
                    angles.append(float(np.arctan2(-normal[0], normal[1]) % np.pi))
    edges = np.unique(angles)
    edges = edges[np.append(True, np.diff(edges) > 1e-13)]
    found = []
    for nodes in (64, 128):
        points, weights = _legendre(nodes)
        half = np.diff(edges) / 2
        theta = ((edges[:-1] + half)[:, None] + half[:, None] * points).ravel()
        weight = (half[:, None] * weights).ravel() / np.pi
        reach = np.max(np.abs(factor @ np.stack([np.cos(theta), np.sin(theta)])), axis=0)
        square = np.divide(
            limit**2, reach**2, out=np.full_like(reach, np.inf), where=reach > 1e-150
        )
        tail = fdtrc(2, freedom, square / 2) if np.isfinite(freedom) else np.exp(-square / 2)
        found.append(float(weight @ tail))
    return float(np.clip(found[1], 0.0, 1.0)), abs(found[1] - found[0])
