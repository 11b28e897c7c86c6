"""Models of the outcomes, fitted to a frame in each mode, and joint tests of their coefficients.

Success has a logistic GEE, time and workload have linear mixed models. Where a retargeter or task
always or never succeeds, the logistic model is Firth's, which keeps all retargeters in one family
of comparisons (see ``gee``). Mode ``paper`` uses the sandwich covariance, or a random intercept for
each operator, and normal statistics. Mode ``small-sample`` uses Mancl and DeRouen's covariance and
t with operators - 1 degrees of freedom, or random intercepts also for each operator with each
retargeter and, with several tasks, for each block, and t with Satterthwaite's degrees of freedom.

Estimated marginal means have equal weights of the tasks and the mean index of the trials. For a
logistic model they are means of probabilities, not of logits, with standard errors by the delta
method. Words for effect sizes are Cohen's (1988).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.special import expit, fdtrc, logit

from smooth_operator.errors import StudyError
from smooth_operator_study.analysis.dunnett import dunnett, holm, quantile, two_sided
from smooth_operator_study.analysis.frame import Frame, check_frame, dependent_columns
from smooth_operator_study.analysis.gee import (
    GeeFit,
    fit_firth,
    fit_gee,
    one_sided_levels,
    separating,
)
from smooth_operator_study.analysis.mixed import MixedFit, fit_mixed
from smooth_operator_study.analysis.results import (
    MODES,
    Against,
    Coefficient,
    Mean,
    Mode,
    Outcome,
    Pair,
    Refused,
    refusable,
)
from smooth_operator_study.design.protocol import ALPHA

_MEANS: Final = (0.2, 0.5, 0.8)
_CORRELATIONS: Final = (0.1, 0.3, 0.5)
_WORDS: Final = ("negligible", "small", "medium", "large")
NOT_SHOWN: Final = "not shown"
"""Text that replaces the word for an effect size if the difference is not significant."""
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
        shares: True for means of probabilities, 0 to 1.
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, " r"]
    gradient: Float[np.ndarray, "r p"]
    shares: bool = False

    def interval(self, which: int, se: float, freedom: float) -> tuple[float, float]:
        """95 % interval of a mean. That of a share is computed on its logit, so it stays in 0 to 1.

        Args:
            which: index of the retargeter.
            se: standard error of the mean.
        """
        value, reach = float(self.values[which]), se * quantile(freedom)
        if not self.shares:
            return value - reach, value + reach
        middle, reach = float(logit(value)), reach / (value * (1 - value))
        return float(expit(middle - reach)), float(expit(middle + reach))

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
    return MarginalMeans(frame.retargeters, probability.mean(axis=1), gradient, shares=True)


def cohen_h(probability: float, baseline: float) -> float:
    """Difference of two probabilities after the arcsine transform."""
    return float(2 * np.arcsin(np.sqrt(probability)) - 2 * np.arcsin(np.sqrt(baseline)))


def in_words(effect: float) -> str:
    """Returns negligible, small, medium or large for an effect size d or h."""
    return _WORDS[int(np.searchsorted(_MEANS, abs(effect), side="right"))]


def size_in_words(effect: float, p: float) -> str:
    """Word for the size of a significant effect d or h; ``NOT_SHOWN`` if it is not significant.

    An estimate near zero does not make the effect negligible: its interval may reach far.
    """
    return in_words(effect) if p < ALPHA else NOT_SHOWN


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
        freedom: degrees of freedom of a combination of coefficients; infinite for normal tests.
        baseline: retargeter that the others are compared with, if it is among the means.
        limits: whether to compute simultaneous intervals against the baseline, the slowest part.
        decide: significance level. A Dunnett p-value whose bounds lie on one side of it is then
            replaced by a bound. None computes all p-values.
    """
    covariance = means.covariance(of_coefficients)
    emm = {}
    for j, name in enumerate(means.names):
        se, df = float(np.sqrt(covariance[j, j])), freedom(means.gradient[j])
        emm[name] = Mean(float(means.values[j]), se, df, *means.interval(j, se, df))
    warnings = []
    tests: dict[tuple[int, int], tuple[float, float, float, float, float]] = {}
    least = _NO_SPREAD * float(np.sqrt(np.max(np.diag(covariance))))
    for a, b in combinations(range(len(means.names)), 2):
        contrast = means.gradient[a] - means.gradient[b]
        se = float(np.sqrt(max(float(contrast @ of_coefficients @ contrast), 0)))
        if not se > least:
            warnings.append(
                f"{means.names[a]} and {means.names[b]} differ without any estimated error; there "
                "are too few operators for a test"
            )
            continue
        difference, df = float(means.values[a] - means.values[b]), freedom(contrast)
        statistic = difference / se
        tests[a, b] = difference, se, df, statistic, two_sided(statistic, df)
    pairs = {}
    for (a, b), p_holm in zip(tests, holm([p for *_, p in tests.values()]), strict=True):
        size, names = effect(means.values[a], means.values[b]), (means.names[a], means.names[b])
        words = size_in_words(size, p_holm)
        pairs["-".join(names)] = Pair(*names, *tests[a, b], p_holm, size, words)
    others = [b for a, b in tests if a == 0] if means.names[0] == baseline else []
    if not others:
        return Comparisons(emm, {}, pairs, [], tuple(warnings))
    # Pairs are baseline minus other; Dunnett's are the other way round, with equal correlations.
    matrix = np.zeros((len(others), len(means.names)))
    matrix[:, 0] = -1
    matrix[np.arange(len(others)), others] = 1
    spread = matrix @ covariance @ matrix.T
    scale = np.sqrt(np.diag(spread))
    correlation = spread / np.outer(scale, scale)
    family = dunnett(
        [-tests[0, j][3] for j in others],
        correlation,
        [tests[0, j][2] for j in others],
        level=0.95 if limits else None,
        decide=decide,
    )
    against = {}
    for j, p, reach in zip(others, family.p, family.critical, strict=True):
        difference, se, df, statistic, p_raw = tests[0, j]
        size, half = effect(means.values[j], means.values[0]), reach * se
        low, high = -difference - half, -difference + half
        if means.shares:  # two shares differ by 1 at most
            low, high = max(low, -1.0), min(high, 1.0)
        against[means.names[j]] = Against(
            -difference, se, df, -statistic, p_raw, p, low, high, size, size_in_words(size, p)
        )
    if family.error > _ROUGH:
        warnings.append(f"Dunnett p-values are accurate only to {family.error:.1g}")
    return Comparisons(emm, against, pairs, correlation.tolist(), tuple(warnings))


def check_separation(frame: Frame) -> None:
    """Raises StudyError if a combination of terms other than one retargeter or task separates
    success."""
    rest = np.ones(len(frame), bool)
    for level in one_sided_levels(frame):
        rest &= ~level.rows
    if not rest.any():
        return
    design, names = frame.design()
    direction = separating(design[rest], frame.outcome[rest])
    if direction is not None:
        named = ", ".join(name for name, x in zip(names, direction, strict=True) if abs(x) > 1e-6)
        raise StudyError(
            f"separation: a combination of {named} predicts success without error in some of "
            "the rows, so its odds are infinite and have no standard error; see the "
            "observed rates"
        )


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model of one outcome in one mode.

    Attributes:
        outcome: success, time or tlx.
        frame: rows of the model.
        names: names of the coefficients.
        beta: coefficients, for success on the logit (p,).
        covariance: covariance of the coefficients (p, p).
        freedom: degrees of freedom of a combination of the coefficients.
        model: fit with these coefficients.
    """

    outcome: Outcome
    frame: Frame
    names: list[str]
    beta: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    freedom: Freedom
    model: GeeFit | MixedFit

    @property
    def means(self) -> MarginalMeans:
        """Means of the retargeters (rates, times or points), with further columns at zero."""
        means = response_means if self.outcome == "success" else linear_means
        return means(self.frame, self.beta)

    def effect(self, mean: float, other: float) -> float:
        """Effect size of two means: Cohen's h, or the difference in SDs of single rows."""
        if isinstance(self.model, MixedFit):
            return (mean - other) / self.model.sd_row
        return cohen_h(mean, other)

    def compare(self, *, limits: bool = True, decide: float | None = None) -> Comparisons:
        """Computes means, differences and effect sizes; see ``compare``."""
        return compare(
            self.means,
            self.covariance,
            self.freedom,
            self.effect,
            self.frame.baseline,
            limits=limits,
            decide=decide,
        )

    def joint(self, columns: slice) -> WaldTest:
        """Tests that all of these coefficients are zero."""
        chosen = np.eye(len(self.beta))[columns]
        values, covariance = chosen @ self.beta, chosen @ self.covariance @ chosen.T
        if isinstance(self.model, GeeFit):
            return clustered_wald(values, covariance, self.model.operators)
        return model_wald(values, covariance, chosen, self.freedom)


def fit_modes(
    outcome: Outcome,
    frame: Frame,
    modes: Sequence[Mode] = MODES,
    more: Float[np.ndarray, "n q"] | None = None,
) -> dict[Mode, Fit | Refused]:
    """Fits retargeter, task, the index and further columns.

    Args:
        frame: rows that passed ``check_frame``, of success also ``check_separation``.
        more: further columns, centred so that means are at their mean.
    """
    design, names = frame.design()
    if more is not None:
        design = np.column_stack([design, more])
        names = [*names, *(f"more{k}" for k in range(more.shape[1]))]
    fits: dict[Mode, Fit | Refused] = {}
    if outcome != "success":
        for mode in modes:
            fits[mode] = _linear(outcome, frame, design, names, mode)
        return fits
    levels = one_sided_levels(frame) if more is None else []
    if levels:
        gee = fit_firth(design, frame.outcome, frame.group, levels)
    else:
        gee = fit_gee(design, frame.outcome, frame.group)
    gee.check_correlation()
    count = gee.operators
    for mode in modes:
        covariance = gee.mancl_derouen if mode == "small-sample" else gee.robust
        df = count - 1.0 if mode == "small-sample" else np.inf
        if covariance is None:
            fits[mode] = Refused(
                "an operator has so much leverage that its residuals can't be corrected: too few "
                f"operators ({count}) for {len(names)} coefficients"
            )
        else:
            fits[mode] = Fit(outcome, frame, names, gee.beta, covariance, lambda _, df=df: df, gee)  # type: ignore[misc]
    return fits


@refusable
def _linear(
    outcome: Outcome, frame: Frame, design: Float[np.ndarray, "n p"], names: list[str], mode: Mode
) -> Fit:
    small = mode == "small-sample"
    levels = frame.levels if small else {"operator": frame.group}
    fit = fit_mixed(design, frame.outcome, levels)
    freedom: Freedom = fit.satterthwaite if small else lambda _: np.inf
    return Fit(outcome, frame, names, fit.beta, fit.covariance, freedom, fit)


def fit_with(outcome: Outcome, frame: Frame, more: Float[np.ndarray, "n q"] | None = None) -> Fit:
    """Checks the rows and fits retargeter, task, index and further columns, mode small-sample."""
    check_frame(frame)
    design = frame.design()[0]
    if more is not None:
        design = np.column_stack([design, more])
    if dependent_columns(design):
        raise StudyError("the further terms are not independent of retargeter, task and trial")
    if len(frame) <= design.shape[1]:
        raise StudyError(f"{len(frame)} rows are too few for {design.shape[1]} coefficients")
    if outcome == "success" and more is None:
        check_separation(frame)
    elif outcome == "success" and separating(design, frame.outcome) is not None:
        raise StudyError("separation: with these terms the odds are infinite")
    fit = fit_modes(outcome, frame, MODES[:1], more)[MODES[0]]
    if isinstance(fit, Refused):
        raise StudyError(fit.refused)
    return fit


@dataclass(frozen=True)
class WaldTest:
    """Joint test of several coefficients: F with its degrees of freedom."""

    f: float
    df1: float
    df2: float
    p: float


def clustered_wald(
    values: Float[np.ndarray, " q"], covariance: Float[np.ndarray, "q q"], operators: int
) -> WaldTest:
    """Tests that all values are zero by Hotelling's F, with a covariance from operators."""
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
    """Tests that all values are zero by F with Satterthwaite's denominators (Fai, Cornelius 1996).

    Args:
        freedom: degrees of freedom of one combination.
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
