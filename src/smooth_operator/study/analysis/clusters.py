"""Covariance of linear coefficients that holds whatever is alike within operators.

Of a fit by generalised least squares with a random intercept as its working covariance V: Mancl and
DeRouen's sandwich (2001), which corrects each operator's residuals for their leverage. With t on
one degree of freedom less than operators it holds where operators differ in a slope as well, which
Satterthwaite's t on a model without random slopes does not.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float, Int

_ALONE: Final = 1 - 1e-10
"""Leverage from which on an operator alone determines a coefficient."""


def mancl_derouen(
    design: Float[np.ndarray, "n p"],
    residuals: Float[np.ndarray, " n"],
    groups: Int[np.ndarray, " n"],
    ratio: float,
) -> Float[np.ndarray, "p p"] | None:
    """The covariance of the coefficients.

    Args:
        design: of full column rank.
        residuals: y - X β, with the predicted intercepts still in them.
        groups: operator of each row, codes from 0.
        ratio: variance of operators over residual variance, of the working covariance.

    Returns:
        The covariance; None where an operator's leverage can't be corrected.
    """
    rows = [np.flatnonzero(groups == k) for k in range(int(groups.max()) + 1)]
    # V⁻¹ X of each operator, up to the residual variance, which cancels.
    turned = []
    for of in rows:
        part = design[of]
        turned.append(part - ratio / (1 + ratio * len(of)) * part.sum(axis=0))
    bread = np.linalg.inv(sum(design[of].T @ w for of, w in zip(rows, turned, strict=True)))
    meat = np.zeros_like(bread)
    for of, weighted in zip(rows, turned, strict=True):
        # (I - X B W')⁻¹ r by the inverse of a p x p matrix (Woodbury).
        inner = np.eye(len(bread)) - weighted.T @ design[of] @ bread
        if np.min(np.abs(np.linalg.eigvals(inner))) < 1 - _ALONE:
            return None
        score = weighted.T @ residuals[of]
        corrected = np.linalg.solve(inner, score)
        meat += np.outer(corrected, corrected)
    return np.asarray(bread @ meat @ bread)
