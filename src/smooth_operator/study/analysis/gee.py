"""Population-averaged logistic regression: GEE with an exchangeable working correlation.

Rows of one operator share the correlation α; scale φ and α are moment estimates without correction
for the number of coefficients, as geepack has them. An exchangeable matrix has a closed-form
inverse, so an operator enters through a few sums, and no matrix is larger than the number of
coefficients.

Two covariances of the coefficients: the sandwich (Liang and Zeger 1986), which is too small with
few operators, and Mancl and DeRouen's (2001), which corrects each operator's residuals for their
leverage.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from scipy.special import expit

from smooth_operator.errors import StudyError

_STEPS: Final = 500
_TOLERANCE: Final = 1e-13
_RUNAWAY: Final = 30.0
"""Log-odds beyond which a fit is on its way to infinity: 1e-13 is no probability of a trial."""
_SINGULAR: Final = 1e-10
"""Reciprocal condition number below which a correction for leverage is refused."""


@dataclass(frozen=True, eq=False)
class GeeFit:
    """A fitted population-averaged logistic model.

    Attributes:
        beta: coefficients, on the logit scale (p,).
        robust: sandwich covariance (p, p).
        mancl_derouen: the same with residuals corrected for leverage (p, p); None where an
            operator's leverage can't be corrected.
        naive: covariance if the working correlation were true (p, p).
        alpha: working correlation of two rows of one operator.
        phi: scale.
        residuals: Pearson residuals (n,).
        operators: number of clusters.
        valid_correlation: whether α is one that rows of the largest operator can have.
    """

    beta: Float[np.ndarray, " p"]
    robust: Float[np.ndarray, "p p"]
    mancl_derouen: Float[np.ndarray, "p p"] | None
    naive: Float[np.ndarray, "p p"]
    alpha: float
    phi: float
    residuals: Float[np.ndarray, " n"]
    operators: int
    valid_correlation: bool


def fit_gee(
    design: Float[np.ndarray, "n p"],
    success: Float[np.ndarray, " n"],
    groups: Int[np.ndarray, " n"],
) -> GeeFit:
    """Fits by Fisher scoring, α and φ anew in every step.

    Args:
        design: of full column rank; separation is to be ruled out before.
        success: 0 or 1 of each row.
        groups: operator of each row, codes 0 .. g-1, each there.

    Returns:
        The fit at the fixed point.

    Raises:
        StudyError: it does not converge, or runs away to infinite odds.
    """
    clusters = _Clusters(design, success, groups)
    beta = clusters.independent()
    for _ in range(_STEPS):
        alpha, _, residuals, root = clusters.moments(beta)
        bread, scores, _ = clusters.equations(alpha, residuals, root)
        step = np.linalg.solve(bread, scores.sum(axis=0))
        beta = beta + step
        if not np.all(np.isfinite(beta)) or np.max(np.abs(design @ beta)) > _RUNAWAY:
            raise StudyError(
                "the GEE runs away to infinite odds: success is (nearly) told without error by "
                "retargeter, task or trial"
            )
        if np.max(np.abs(step)) <= _TOLERANCE * (1 + np.max(np.abs(beta))):
            break
    else:
        raise StudyError(
            f"the GEE did not converge in {_STEPS} steps (last step {np.max(np.abs(step)):.1e}, "
            f"working correlation {alpha:.3f}); its figures would mean nothing"
        )
    return clusters.fit(beta)


class _Clusters:
    """Sums over each operator's rows."""

    def __init__(
        self,
        design: Float[np.ndarray, "n p"],
        success: Float[np.ndarray, " n"],
        groups: Int[np.ndarray, " n"],
    ) -> None:
        order = np.argsort(groups, kind="stable")
        self.design, self.success = design[order], success[order]
        self.back = np.argsort(order)
        self.sizes = np.bincount(groups).astype(float)
        self.starts = np.concatenate([[0], np.cumsum(self.sizes)[:-1]]).astype(int)
        self.pairs = float(np.sum(self.sizes * (self.sizes - 1)) / 2)

    def _sum(self, values: Float[np.ndarray, "n ..."]) -> Float[np.ndarray, "g ..."]:
        return np.asarray(np.add.reduceat(values, self.starts, axis=0))

    def independent(self) -> Float[np.ndarray, " p"]:
        """Logistic regression that ignores operators: where the iteration starts."""
        beta = np.zeros(self.design.shape[1])
        for _ in range(25):
            mean = expit(self.design @ beta)
            weighted = self.design * (mean * (1 - mean))[:, None]
            step = np.linalg.solve(weighted.T @ self.design, self.design.T @ (self.success - mean))
            beta = beta + step
            if np.max(np.abs(step)) < 1e-8 or np.max(np.abs(self.design @ beta)) > _RUNAWAY:
                break
        return beta

    def moments(
        self, beta: Float[np.ndarray, " p"]
    ) -> tuple[float, float, Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """(α, φ, Pearson residuals, square root of the variance function) at β."""
        mean = expit(self.design @ beta)
        root = np.sqrt(mean * (1 - mean))
        residuals = (self.success - mean) / root
        squares = self._sum(residuals**2)
        phi = float(squares.sum() / len(residuals))
        products = float(np.sum(self._sum(residuals) ** 2 - squares) / 2)
        return (products / (phi * self.pairs) if self.pairs else 0.0), phi, residuals, root

    def equations(
        self, alpha: float, residuals: Float[np.ndarray, " n"], root: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, "g p"], Float[np.ndarray, "g p p"]]:
        """(Σ D'R⁻¹D, D'R⁻¹r of each operator, D'R⁻¹D of each operator), without φ."""
        scaled = self.design * root[:, None]
        # Operators that are exactly alike have the lowest correlation there is, and R no inverse:
        # the fit runs away, and is refused for that.
        with np.errstate(divide="ignore"):
            shared = alpha / (1 + (self.sizes - 1) * alpha)
        sums, total = self._sum(scaled), self._sum(residuals)
        scores = self._sum(scaled * residuals[:, None]) - (shared * total)[:, None] * sums
        slices = np.split(scaled, self.starts[1:])
        parts = np.stack([part.T @ part for part in slices])
        parts -= shared[:, None, None] * sums[:, :, None] * sums[:, None, :]
        scores, parts = scores / (1 - alpha), parts / (1 - alpha)
        return parts.sum(axis=0), scores, parts

    def fit(self, beta: Float[np.ndarray, " p"]) -> GeeFit:
        """Everything at β."""
        alpha, phi, residuals, root = self.moments(beta)
        bread, scores, parts = self.equations(alpha, residuals, root)
        inverse = np.linalg.inv(bread)
        robust = inverse @ (scores.T @ scores) @ inverse
        # (I - H)⁻¹ r of all rows of an operator enters as (I - D'R⁻¹D A⁻¹)⁻¹ of its score.
        left = np.eye(len(beta)) - parts @ inverse
        corrected = None
        if np.min(1 / np.linalg.cond(left)) > _SINGULAR:
            adjusted = np.linalg.solve(left, scores[:, :, None])[:, :, 0]
            corrected = inverse @ (adjusted.T @ adjusted) @ inverse
        largest = float(self.sizes.max())
        lowest = -1 / (largest - 1) if largest > 1 else -1.0
        return GeeFit(
            beta=beta,
            robust=robust,
            mancl_derouen=corrected,
            naive=phi * inverse,
            alpha=alpha,
            phi=phi,
            residuals=residuals[self.back],
            operators=len(self.sizes),
            valid_correlation=lowest < alpha < 1,
        )
