"""Means of retargeters, their differences and effect sizes, for all models.

Estimated marginal means have equal weights of the tasks and the mean index of the trials. For a
logistic model they are means of probabilities, not of logits, with standard errors by the delta
method. Words for effect sizes are Cohen's (1988).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.special import expit

from smooth_operator.study.analysis.dunnett import dunnett, holm, quantile, two_sided
from smooth_operator.study.analysis.frame import Frame
from smooth_operator.study.analysis.results import Against, Coefficient, Mean, Pair

_MEANS: Final = (0.2, 0.5, 0.8)
_CORRELATIONS: Final = (0.1, 0.3, 0.5)
_WORDS: Final = ("negligible", "small", "medium", "large")
_NO_SPREAD: Final = 1e-10
"""Share of the largest standard error of a mean below which that of a difference is zero."""
_ROUGH: Final = 1e-6
Freedom = Callable[[Float[np.ndarray, " p"]], float]
"""Function from a combination of the coefficients to its degrees of freedom."""
Effect = Callable[[float, float], float]
"""Function from two means to the effect size of their difference."""


@dataclass(frozen=True, eq=False)
class MarginalMeans:
    """Means of retargeters, and their derivatives.

    Attributes:
        names: names of the retargeters (r,).
        values: means (r,).
        gradient: derivatives of the means by the coefficients (r, p).
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, " r"]
    gradient: Float[np.ndarray, "r p"]

    def covariance(self, of_coefficients: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "r r"]:
        """Covariance of the means."""
        return np.asarray(self.gradient @ of_coefficients @ self.gradient.T)


def linear_means(frame: Frame, beta: Float[np.ndarray, " p"]) -> MarginalMeans:
    """Computes means of a linear predictor: times, workload, or logits."""
    gradient = frame.grid(len(beta)).mean(axis=1)
    return MarginalMeans(frame.retargeters, gradient @ beta, gradient)


def response_means(frame: Frame, beta: Float[np.ndarray, " p"]) -> MarginalMeans:
    """Computes means of the probabilities of a logistic model."""
    grid = frame.grid(len(beta))
    probability = expit(grid @ beta)
    slope = probability * (1 - probability)
    gradient = np.mean(slope[:, :, None] * grid, axis=1)
    return MarginalMeans(frame.retargeters, probability.mean(axis=1), gradient)


def cohen_h(probability: float, baseline: float) -> float:
    """Difference of two probabilities after the arcsine transform."""
    return float(2 * np.arcsin(np.sqrt(probability)) - 2 * np.arcsin(np.sqrt(baseline)))


def in_words(effect: float) -> str:
    """Returns negligible, small, medium or large for an effect size d or h."""
    return _WORDS[int(np.searchsorted(_MEANS, abs(effect), side="right"))]


def correlation_in_words(rho: float) -> str:
    """Returns negligible, small, medium or large for a correlation."""
    return _WORDS[int(np.searchsorted(_CORRELATIONS, abs(rho), side="right"))]


@dataclass(frozen=True)
class Comparisons:
    """Means, differences and warnings of one model."""

    emm: dict[str, Mean]
    dunnett: dict[str, Against]
    pairs: dict[str, Pair]
    correlation: list[list[float]]
    warnings: tuple[str, ...]


def coefficients(
    names: list[str],
    beta: Float[np.ndarray, " p"],
    covariance: Float[np.ndarray, "p p"],
    freedom: Freedom,
) -> dict[str, Coefficient]:
    """Returns each coefficient with its test."""
    table = {}
    for name, value, variance, axis in zip(
        names, beta, np.diag(covariance), np.eye(len(beta)), strict=True
    ):
        se, df = float(np.sqrt(max(variance, 0))), freedom(axis)
        p = two_sided(value / se, df) if se > 0 else float("nan")
        table[name] = Coefficient(float(value), se, df, p)
    return table


def compare(
    means: MarginalMeans,
    of_coefficients: Float[np.ndarray, "p p"],
    freedom: Freedom,
    effect: Effect,
    baseline: str,
    *,
    limits: bool = True,
    decide: float | None = None,
) -> Comparisons:
    """Computes means with intervals, Dunnett against the baseline, and Holm over all pairs.

    Args:
        means: means of the retargeters.
        of_coefficients: covariance of the coefficients.
        freedom: degrees of freedom of a combination of coefficients; infinite for normal tests.
        effect: effect size of two means.
        baseline: retargeter that the others are compared with, if it is among the means.
        limits: whether to compute simultaneous intervals against the baseline, the slowest part.
        decide: significance level. A Dunnett p-value whose bounds lie on one side of it is then
            replaced by a bound. None computes all p-values.
    """
    covariance = means.covariance(of_coefficients)
    emm = {}
    for j, name in enumerate(means.names):
        se, df = float(np.sqrt(covariance[j, j])), freedom(means.gradient[j])
        reach = se * quantile(df)
        value = float(means.values[j])
        emm[name] = Mean(value, se, df, value - reach, value + reach)
    warnings = []
    tests = {}
    least = _NO_SPREAD * float(np.sqrt(np.max(np.diag(covariance))))
    for a, b in combinations(range(len(means.names)), 2):
        test = _difference(means, of_coefficients, a, b, freedom)
        if not test.se > least:
            warnings.append(
                f"{means.names[a]} and {means.names[b]} differ without any estimated error; there "
                "are too few operators for a test"
            )
        tests[a, b] = test
    usable = {key: test for key, test in tests.items() if test.se > least}
    adjusted = dict(zip(usable, holm([test.p for test in usable.values()]), strict=True))
    pairs = {}
    for (a, b), test in usable.items():
        size = effect(means.values[a], means.values[b])
        first, second = means.names[a], means.names[b]
        pairs[f"{first}-{second}"] = Pair(
            first, second, test.difference, test.se, test.df, test.statistic, test.p,
            adjusted[a, b], size, in_words(size),
        )  # fmt: skip
    against: dict[str, Against] = {}
    correlation: list[list[float]] = []
    if means.names[0] == baseline:
        others = [j for j in range(1, len(means.names)) if (0, j) in usable]
        if others:
            against, correlation, error = _against(
                means, covariance, others, {j: usable[0, j] for j in others}, effect, limits, decide
            )
            if error > _ROUGH:
                warnings.append(f"Dunnett p-values are known to {error:.1g} only")
    return Comparisons(emm, against, pairs, correlation, tuple(warnings))


@dataclass(frozen=True)
class _Test:
    difference: float
    se: float
    df: float

    @property
    def statistic(self) -> float:
        return self.difference / self.se

    @property
    def p(self) -> float:
        return two_sided(self.statistic, self.df)


def _difference(
    means: MarginalMeans,
    of_coefficients: Float[np.ndarray, "p p"],
    a: int,
    b: int,
    freedom: Freedom,
) -> _Test:
    contrast = means.gradient[a] - means.gradient[b]
    variance = float(contrast @ of_coefficients @ contrast)
    return _Test(
        float(means.values[a] - means.values[b]),
        float(np.sqrt(max(variance, 0))),
        freedom(contrast),
    )


def _against(
    means: MarginalMeans,
    covariance: Float[np.ndarray, "r r"],
    others: list[int],
    tests: dict[int, _Test],
    effect: Effect,
    limits: bool,
    decide: float | None,
) -> tuple[dict[str, Against], list[list[float]], float]:
    # Tests are baseline minus other; Dunnett's are the other way round, with equal correlations.
    matrix = np.zeros((len(others), len(means.names)))
    matrix[:, 0] = -1
    matrix[np.arange(len(others)), others] = 1
    spread = matrix @ covariance @ matrix.T
    scale = np.sqrt(np.diag(spread))
    correlation = spread / np.outer(scale, scale)
    family = dunnett(
        [-tests[j].statistic for j in others],
        correlation,
        [tests[j].df for j in others],
        level=0.95 if limits else None,
        decide=decide,
    )
    comparisons = {}
    for j, p, reach in zip(others, family.p, family.critical, strict=True):
        test, size = tests[j], effect(means.values[j], means.values[0])
        difference, half = -test.difference, reach * test.se
        comparisons[means.names[j]] = Against(
            difference, test.se, test.df, -test.statistic, test.p, p,
            difference - half, difference + half, size, in_words(size),
        )  # fmt: skip
    return comparisons, [[float(x) for x in row] for row in correlation], family.error
