"""Proportional odds: logit P(score ≤ level k) = θₖ − x β, by maximum likelihood (McCullagh 1980).

Rows count as independent for the estimate; the covariance is corrected for operators.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from scipy.special import expit

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.readings.clusters import corrected_influence

_STEPS: Final = 60
_HALVINGS: Final = 30
_TOLERANCE: Final = 1e-10
_RUNAWAY: Final = 20.0


@dataclass(frozen=True, eq=False)
class CumulativeLogit:
    """A fitted model; parameters are the thresholds θ, then the coefficients β.

    Attributes:
        parameters: on the logit scale (k + p,).
        thresholds: how many of them are thresholds, k.
        influence: of each operator, corrected for its leverage (g, k + p).
        log_likelihood: as if rows were independent.
    """

    parameters: Float[np.ndarray, " m"]
    thresholds: int
    influence: Float[np.ndarray, "g m"]
    log_likelihood: float

    @property
    def beta(self) -> Float[np.ndarray, " p"]:
        """Coefficients: positive for higher scores."""
        return self.parameters[self.thresholds :]

    @property
    def covariance(self) -> Float[np.ndarray, "m m"]:
        """Of the parameters, operators being clusters."""
        return np.asarray(self.influence.T @ self.influence)


def fit_cumulative_logit(
    design: Float[np.ndarray, "n p"], level: Int[np.ndarray, " n"], groups: Int[np.ndarray, " n"]
) -> CumulativeLogit:
    """Fits by Newton's method; the likelihood is concave.

    Args:
        design: columns without an intercept (n, p).
        level: of each row, 0 .. k, each there, with k of at least 1 (then a logistic regression).
        groups: operator of each row, codes 0 .. g-1, each there.

    Raises:
        StudyError: the likelihood has no maximum (separation), or an operator has too much
            leverage.
    """
    count = int(level.max())
    shares = np.cumsum(np.bincount(level))[:-1] / len(level)
    now = np.concatenate([np.log(shares / (1 - shares)), np.zeros(design.shape[1])])
    value, rows, hessian = _derivatives(now, design, level, count)
    for _ in range(_STEPS):
        try:
            step = np.linalg.solve(hessian.sum(axis=0), rows.sum(axis=0))
        except np.linalg.LinAlgError as error:
            raise StudyError(_NO_MAXIMUM) from error
        scale = 1.0
        for _ in range(_HALVINGS):
            following = now + scale * step
            found = _derivatives(following, design, level, count)
            if found[0] >= value - 1e-12 * abs(value):
                break
            scale /= 2
        now, (value, rows, hessian) = following, found
        if np.max(np.abs(now)) > _RUNAWAY:
            raise StudyError(_NO_MAXIMUM)
        if np.max(np.abs(scale * step)) < _TOLERANCE:
            break
    else:
        raise StudyError("the ordinal model did not converge; its figures would mean nothing")
    operators, width = int(groups.max()) + 1, len(now)
    scores, information = np.zeros((operators, width)), np.zeros((operators, width, width))
    np.add.at(scores, groups, rows)
    np.add.at(information, groups, hessian)
    return CumulativeLogit(now, count, corrected_influence(information, scores), value)


_NO_MAXIMUM: Final = (
    "separation: retargeter, task or trial tell scores without error in a part of the rows, so the "
    "ordinal model has infinite odds"
)


def _derivatives(
    parameters: Float[np.ndarray, " m"],
    design: Float[np.ndarray, "n p"],
    level: Int[np.ndarray, " n"],
    count: int,
) -> tuple[float, Float[np.ndarray, "n m"], Float[np.ndarray, "n m m"]]:
    """Log-likelihood, and score and information of each row; minus infinity out of order."""
    theta, beta = parameters[:count], parameters[count:]
    rows, width = len(level), len(parameters)
    if np.any(np.diff(theta) <= 0):
        return -np.inf, np.zeros((rows, width)), np.zeros((rows, width, width))
    bounds = np.concatenate([[-np.inf], theta, [np.inf]])
    linear = design @ beta
    upper, lower = bounds[level + 1] - linear, bounds[level] - linear
    axes = np.zeros((count + 2, width))
    axes[np.arange(1, count + 1), np.arange(count)] = 1
    first, second = axes[level + 1], axes[level]
    first[level < count, count:] = -design[level < count]
    second[level > 0, count:] = -design[level > 0]
    high, low = expit(upper), expit(lower)
    chance = np.maximum(high - low, 1e-300)
    slope_high, slope_low = high * (1 - high) / chance, low * (1 - low) / chance
    score = first * slope_high[:, None] - second * slope_low[:, None]
    bend_high, bend_low = slope_high * (1 - 2 * high), slope_low * (1 - 2 * low)
    information = (
        score[:, :, None] * score[:, None, :]
        - bend_high[:, None, None] * first[:, :, None] * first[:, None, :]
        + bend_low[:, None, None] * second[:, :, None] * second[:, None, :]
    )
    return float(np.sum(np.log(chance))), score, information
