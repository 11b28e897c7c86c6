"""Inference from sums over operators: corrected sandwich covariance and joint Wald tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.contrasts import Freedom


@dataclass(frozen=True)
class WaldTest:
    """A joint test of several coefficients: F with its degrees of freedom."""

    f: float
    df1: float
    df2: float
    p: float


def corrected_influence(
    information: Float[np.ndarray, "g p p"], scores: Float[np.ndarray, "g p"]
) -> Float[np.ndarray, "g p"]:
    """What each operator adds to the coefficients, its score corrected for its own leverage.

    Args:
        information: of each operator; their sum is that of the estimating equations.
        scores: of each operator at the estimate; they add up to zero.

    Returns:
        Rows whose cross product is the sandwich covariance; for a GEE it is Mancl and DeRouen's
        (2001).

    Raises:
        StudyError: an operator alone determines a coefficient.
    """
    inverse = np.linalg.inv(information.sum(axis=0))
    left = np.eye(scores.shape[1]) - information @ inverse
    if not np.max(np.linalg.cond(left)) < 1e10:
        raise StudyError(
            "an operator has so much leverage that its residuals can't be corrected: too few "
            f"operators ({len(scores)}) for {scores.shape[1]} coefficients"
        )
    corrected = np.linalg.solve(left, scores[:, :, None])[:, :, 0]
    return np.asarray(corrected @ inverse.T)


def clustered_wald(
    values: Float[np.ndarray, " q"], covariance: Float[np.ndarray, "q q"], operators: int
) -> WaldTest:
    """Are all values zero? Hotelling's F, for a covariance that is estimated from operators.

    Raises:
        StudyError: not more operators than values.
    """
    count = len(values)
    if operators <= count:
        raise StudyError(
            f"{operators} operators are too few for a joint test of {count} differences"
        )
    statistic = _quadratic(values, covariance)
    free = operators - count
    f = statistic * free / ((operators - 1) * count)
    return WaldTest(f, float(count), float(free), float(fdtrc(count, free, f)))


def model_wald(
    values: Float[np.ndarray, " q"],
    covariance: Float[np.ndarray, "q q"],
    contrasts: Float[np.ndarray, "q p"],
    freedom: Freedom,
) -> WaldTest:
    """Are all values zero? F with denominators from Satterthwaite (Fai and Cornelius 1996).

    Args:
        values: combinations of the coefficients.
        covariance: theirs.
        contrasts: the combinations.
        freedom: degrees of freedom of one combination.

    Raises:
        StudyError: the covariance is singular, or there are next to no degrees of freedom.
    """
    count = len(values)
    statistic = _quadratic(values, covariance)
    _, axes = np.linalg.eigh(covariance)
    each = np.array([freedom(axis @ contrasts) for axis in axes.T])
    if np.min(each) <= 2:
        raise StudyError("too few operators: a difference has no more than 2 degrees of freedom")
    if np.isinf(each).all():
        free = np.inf
    else:
        total = float(np.sum(1 / (1 - 2 / each)))
        free = 2 * total / (total - count)
    f = statistic / count
    return WaldTest(f, float(count), float(free), float(fdtrc(count, min(free, 1e9), f)))


def _quadratic(values: np.ndarray, covariance: np.ndarray) -> float:
    scale = np.sqrt(np.maximum(np.diag(covariance), 0))
    if not np.all(scale > 0) or np.linalg.cond(covariance / np.outer(scale, scale)) > 1e10:
        raise StudyError("the differences have no joint test: their covariance is singular")
    return float(values @ np.linalg.solve(covariance, values))
