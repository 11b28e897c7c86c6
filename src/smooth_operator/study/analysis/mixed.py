"""Linear mixed model with a random intercept for each operator, by profile REML.

y = X β + u[operator] + ε,  u ~ N(0, λ σ²),  ε ~ N(0, σ²).

For a given λ everything else is closed form, so REML is a search over one number. What the data say
about it are a few sums over each operator's rows; criterion, gradient and Hessian are exact, no
derivative is numerical. The degrees of freedom are Satterthwaite's, as lmerTest has them.

Sources: Bates et al. 2015 (profiled criterion), Fai and Cornelius 1996 and Kuznetsova et al. 2017
(Satterthwaite's approximation for contrasts).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import brentq

from smooth_operator.errors import StudyError

_GRID: Final = np.concatenate([[0.0], np.logspace(-7, 12, 153)])
"""Ratios of variances at which the criterion is looked at before the minimum is refined."""
_NO_RESIDUAL: Final = 1e-12
"""Share of the outcome's sum of squares within operators below which no residual is left."""
_EXPLAINED: Final = (
    "the model explains the outcome without any residual, so nothing can be tested: within "
    "operators it never varies, or never but as the model says"
)


@dataclass(frozen=True, eq=False)
class MixedFit:
    """A fitted linear mixed model.

    Attributes:
        beta: fixed effects (p,).
        covariance: (X' V⁻¹ X)⁻¹ of the fixed effects (p, p).
        ratio: λ, variance of operators over residual variance.
        residual_variance: σ².
        intercepts: predicted u of each operator (g,), in the order of their codes.
        residuals: y - X β - u of each row (n,).
        log_likelihood: restricted, as lme4 reports it.
        singular: whether the variance of operators is estimated as zero.
    """

    beta: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    ratio: float
    residual_variance: float
    intercepts: Float[np.ndarray, " g"]
    residuals: Float[np.ndarray, " n"]
    log_likelihood: float
    singular: bool
    _gradient: Float[np.ndarray, "p p"]  # d (X' H⁻¹ X)⁻¹ / d λ
    _information: Float[np.ndarray, "2 2"]  # half the Hessian of -2 log L in (λ, σ²)

    @property
    def sd_operator(self) -> float:
        """Standard deviation of the operators' intercepts."""
        return float(np.sqrt(self.ratio * self.residual_variance))

    @property
    def sd_residual(self) -> float:
        """Standard deviation of what is left."""
        return float(np.sqrt(self.residual_variance))

    @cached_property
    def _variance_of_parameters(self) -> Float[np.ndarray, "2 2"]:
        if self.singular:
            # At the edge λ does not vary: the intercepts are gone and σ² is an ordinary residual
            # variance, which leaves n - p degrees of freedom. So does lmerTest.
            return np.array([[0.0, 0.0], [0.0, 1.0 / self._information[1, 1]]])
        return np.asarray(np.linalg.inv(self._information))

    def satterthwaite(self, contrast: Float[np.ndarray, " p"]) -> float:
        """Degrees of freedom of a contrast of the fixed effects."""
        variance = float(contrast @ self.covariance @ contrast)
        by_ratio = self.residual_variance * float(contrast @ self._gradient @ contrast)
        gradient = np.array([by_ratio, variance / self.residual_variance])
        spread = float(gradient @ self._variance_of_parameters @ gradient)
        return 2.0 * variance**2 / spread if spread > 0 else float("nan")


def fit_mixed(
    design: Float[np.ndarray, "n p"],
    outcome: Float[np.ndarray, " n"],
    groups: Int[np.ndarray, " n"],
) -> MixedFit:
    """Fits by REML.

    Args:
        design: fixed effects, of full column rank.
        outcome: y.
        groups: operator of each row, codes 0 .. g-1, each there.

    Returns:
        The fit at the global minimum of the criterion.

    Raises:
        StudyError: no more rows than coefficients, or the model leaves no residual.
    """
    rows, width = design.shape
    if rows <= width:
        raise StudyError(
            f"a mixed model with {width} coefficients needs more rows than that; came {rows}"
        )
    profile = _Profile(design, outcome, groups)
    ratio = profile.minimise()
    return profile.fit(ratio)


class _Profile:
    """The restricted likelihood as a function of λ, from sums over each operator."""

    def __init__(
        self,
        design: Float[np.ndarray, "n p"],
        outcome: Float[np.ndarray, " n"],
        groups: Int[np.ndarray, " n"],
    ) -> None:
        self.design, self.outcome, self.groups = design, outcome, groups
        self.rows, self.width = design.shape
        both = np.column_stack([design, outcome])
        self.sizes = np.bincount(groups).astype(float)
        sums = np.zeros((len(self.sizes), self.width + 1))
        np.add.at(sums, groups, both)
        self.means = sums / self.sizes[:, None]
        # Deviations from the operator's mean: differences of large sums would lose digits where
        # operators differ far more than their trials.
        within = both - self.means[groups]
        self.within = within.T @ within
        self._check_residual()

    def _check_residual(self) -> None:
        moment, right = self.within[:-1, :-1], self.within[:-1, -1]
        total = float(self.within[-1, -1])
        left = total - float(right @ np.linalg.lstsq(moment, right, rcond=None)[0])
        if left <= _NO_RESIDUAL * total or total == 0:
            raise StudyError(_EXPLAINED)

    def _moment(self, weights: Float[np.ndarray, " g"]) -> Float[np.ndarray, "q q"]:
        return np.asarray((self.means * weights[:, None]).T @ self.means)

    def solve(
        self, ratio: float
    ) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"], float]:
        """(X' H⁻¹ X, β, residual sum of squares in the metric of H) at λ."""
        cross = self.within + self._moment(self.sizes / (1 + ratio * self.sizes))
        matrix, right = cross[:-1, :-1], cross[:-1, -1]
        beta = np.linalg.solve(matrix, right)
        # Of the residuals themselves: y'y - β'X'y would lose digits where little is left.
        signed = np.append(-beta, 1.0)
        squares = float(signed @ cross @ signed)
        return matrix, beta, squares

    def criterion(self, ratio: float) -> float:
        """-2 log of the restricted likelihood with β and σ² profiled out, without constants."""
        matrix, _, squares = self.solve(ratio)
        if squares <= 0:  # nothing but rounding is left
            raise StudyError(_EXPLAINED)
        free = self.rows - self.width
        return float(
            np.sum(np.log1p(ratio * self.sizes))
            + np.linalg.slogdet(matrix)[1]
            + free * np.log(squares / free)
        )

    def derivatives(
        self, ratio: float
    ) -> tuple[float, float, float, float, Float[np.ndarray, "p p"]]:
        """First and second derivative in λ of log-determinants (D) and squares (R), and of A⁻¹.

        Returns:
            (D', D'', R', R'', d A⁻¹ / d λ) with A = X' H⁻¹ X.
        """
        matrix, beta, _ = self.solve(ratio)
        shrunk = self.sizes / (1 + ratio * self.sizes)
        first, second = -(shrunk**2), 2 * shrunk**3
        d_first, d_second = self._moment(first), self._moment(second)
        inverse = np.linalg.inv(matrix)
        step, bend = inverse @ d_first[:-1, :-1], inverse @ d_second[:-1, :-1]
        signed = np.append(-beta, 1.0)
        turned = d_first[:-1] @ signed
        d1 = float(np.sum(shrunk) + np.trace(step))
        d2 = float(-np.sum(shrunk**2) + np.trace(bend) - np.trace(step @ step))
        r1 = float(signed @ d_first @ signed)
        r2 = float(signed @ d_second @ signed - 2 * turned @ inverse @ turned)
        return d1, d2, r1, r2, -step @ inverse

    def slope(self, ratio: float) -> float:
        """Derivative of the criterion in λ."""
        squares = self.solve(ratio)[2]
        d1, _, r1, _, _ = self.derivatives(ratio)
        return float(d1 + (self.rows - self.width) * r1 / squares)

    def minimise(self) -> float:
        """λ at the global minimum: the best of all stretches of the grid that hold one."""
        values = np.array([self.criterion(ratio) for ratio in _GRID])
        best, chosen = values[0], 0.0
        for i in range(len(_GRID)):
            left = values[i - 1] if i else np.inf
            right = values[i + 1] if i + 1 < len(_GRID) else np.inf
            if values[i] > left or values[i] > right:
                continue
            low, high = _GRID[max(i - 1, 0)], _GRID[min(i + 1, len(_GRID) - 1)]
            ratio = self._refine(float(low), float(high))
            value = self.criterion(ratio)
            if value < best or (value == best and ratio > chosen):
                best, chosen = value, ratio
        return chosen

    def _refine(self, low: float, high: float) -> float:
        if self.slope(low) >= 0:
            return low  # only at zero: the criterion rises from the edge on
        if self.slope(high) <= 0:
            raise StudyError(
                "the variance between operators is beyond all measure larger than that of their "
                "trials; look for operators whose outcome never varies"
            )
        return float(brentq(self.slope, low, high, xtol=1e-300, rtol=1e-14, maxiter=500))

    def fit(self, ratio: float) -> MixedFit:
        """Everything at λ."""
        matrix, beta, squares = self.solve(ratio)
        free = self.rows - self.width
        variance = squares / free
        _, d2, r1, r2, gradient = self.derivatives(ratio)
        information = 0.5 * np.array(
            [
                [d2 + r2 / variance, -r1 / variance**2],
                [-r1 / variance**2, free / variance**2],
            ]
        )
        raw = self.outcome - self.design @ beta
        sums = np.bincount(self.groups, raw)
        intercepts = ratio * sums / (1 + ratio * self.sizes)
        return MixedFit(
            beta=beta,
            covariance=variance * np.linalg.inv(matrix),
            ratio=ratio,
            residual_variance=variance,
            intercepts=intercepts,
            residuals=raw - intercepts[self.groups],
            log_likelihood=-0.5 * (self.criterion(ratio) + free * (1 + np.log(2 * np.pi))),
            singular=ratio == 0.0,
            _gradient=gradient,
            _information=information,
        )
