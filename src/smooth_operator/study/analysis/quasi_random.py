"""The box probability of many variables, by scrambled Sobol points with fixed seeds.

Where nested quadrature would need too many nodes. The variables are taken one after the other and
mapped to the unit cube (Genz 1992); a t adds its chi variable as one more direction. Independent
scramblings give the error. Seeds are fixed: the same data give the same p-value.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.special import gammaincinv, ndtr, ndtri
from scipy.stats.qmc import Sobol

_SCRAMBLES: Final = 8
_POWERS: Final = (12, 14, 16)
"""Points of each scrambling, as powers of two, few to many."""
_EDGE: Final = 1e-16


def outside_by_points(
    limit: float,
    factor: Float[np.ndarray, "m m"],
    freedom: float,
    *,
    enough: float,
) -> tuple[float, float]:
    """P(max |T_j| > limit) for the lower triangular factor of a correlation matrix.

    Args:
        limit: above zero.
        factor: L with L L' the correlation matrix.
        freedom: degrees of freedom of the t; infinite for normal variables.
        enough: error at which no more points are tried.

    Returns:
        (probability, three standard errors over the scramblings).
    """
    mixed = bool(np.isfinite(freedom))
    for power in _POWERS:
        estimates = np.array(
            [
                1 - np.mean(_inside(limit, factor, freedom, _points(len(factor), mixed, power, k)))
                for k in range(_SCRAMBLES)
            ]
        )
        error = 3 * float(estimates.std(ddof=1)) / np.sqrt(_SCRAMBLES)
        if error < enough:
            break
    return float(np.clip(estimates.mean(), 0.0, 1.0)), error


@lru_cache(maxsize=32)
def _points(width: int, mixed: bool, power: int, seed: int) -> Float[np.ndarray, "k d"]:
    # The last variable of the box needs no coordinate, its probability is closed form.
    points = Sobol(width - 1 + mixed, scramble=True, rng=np.random.default_rng(seed))
    return np.asarray(np.clip(points.random_base2(power), _EDGE, 1 - _EDGE))


def _inside(
    limit: float, factor: Float[np.ndarray, "m m"], freedom: float, points: Float[np.ndarray, "k d"]
) -> Float[np.ndarray, " k"]:
    reach = np.full(len(points), limit)
    if np.isfinite(freedom):
        reach = limit * np.sqrt(2 * gammaincinv(freedom / 2, points[:, -1]) / freedom)
    known = np.zeros((len(factor), len(points)))
    total = np.ones(len(points))
    for at in range(len(factor)):
        mean = factor[at, :at] @ known[:at]
        low = ndtr((-reach - mean) / factor[at, at])
        share = ndtr((reach - mean) / factor[at, at]) - low
        total *= share
        if at + 1 < len(factor):
            known[at] = ndtri(np.clip(low + points[:, at] * share, 1e-300, 1 - _EDGE))
    return total
