"""Box probabilities of many normal variables, by scrambled Sobol points with fixed seeds.

Where nested quadrature would need too many nodes. The variables are taken one after the other and
mapped to the unit cube (Genz 1992). Independent scramblings give the error. Seeds are fixed: the
same data give the same p-value.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri
from scipy.stats.qmc import Sobol

_SCRAMBLES: Final = 8
_POWERS: Final = (10, 12, 14)
"""Points of each scrambling, as powers of two, few to many."""
_EDGE: Final = 1e-16


def apart_by_points(
    sizes: Float[np.ndarray, " k"],
    factor: Float[np.ndarray, "m m"],
    near: Float[np.ndarray, "m m"],
    *,
    enough: float,
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """P(|L z| <= size) of independent normal z, for each size, minus that of a near matrix.

    Args:
        sizes: above zero.
        factor: L, lower triangular, with L L' the correlation matrix.
        near: the same of a matrix that is nearly it: the difference varies less from point to point
            than the probability.
        enough: error at which no more points are tried.

    Returns:
        (differences, three standard errors over the scramblings of each).
    """
    for power in _POWERS:
        # The same points for every size, so that the error is as smooth as the probability.
        estimates = np.array(
            [
                [
                    np.mean(_inside(size, factor, points) - _inside(size, near, points))
                    for size in sizes
                ]
                for points in (_points(len(factor), power, seed) for seed in range(_SCRAMBLES))
            ]
        )
        errors = 3 * estimates.std(axis=0, ddof=1) / np.sqrt(_SCRAMBLES)
        if errors.max() < enough:
            break
    return estimates.mean(axis=0), errors


@lru_cache(maxsize=32)
def _points(width: int, power: int, seed: int) -> Float[np.ndarray, "k d"]:
    # The last variable of the box needs no coordinate, its probability is closed form.
    points = Sobol(width - 1, scramble=True, rng=np.random.default_rng(seed))
    return np.asarray(np.clip(points.random_base2(power), _EDGE, 1 - _EDGE))


def _inside(
    size: float, factor: Float[np.ndarray, "m m"], points: Float[np.ndarray, "k d"]
) -> Float[np.ndarray, " k"]:
    known = np.zeros((len(factor), len(points)))
    total = np.ones(len(points))
    for at in range(len(factor)):
        mean = factor[at, :at] @ known[:at]
        low = ndtr((-size - mean) / factor[at, at])
        share = ndtr((size - mean) / factor[at, at]) - low
        total *= share
        if at + 1 < len(factor):
            known[at] = ndtri(np.clip(low + points[:, at] * share, 1e-300, 1 - _EDGE))
    return total
