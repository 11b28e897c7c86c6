"""Success, time or workload over one scope: model, means and comparisons in both modes.

Success is a logistic GEE, time and workload are linear mixed models. Their assumptions are checked:
figures for the results and sentences for the reader.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from scipy.stats import kurtosis, levene, shapiro, skew

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.contrasts import (
    Freedom,
    coefficients,
    cohen_h,
    compare,
    linear_means,
    response_means,
    standardised,
)
from smooth_operator.study.analysis.frame import INDEX, Frame, check_frame
from smooth_operator.study.analysis.gee import (
    GeeFit,
    fit_gee,
    one_sided_cells,
    one_sided_levels,
    separating,
)
from smooth_operator.study.analysis.mixed import MixedFit, fit_mixed
from smooth_operator.study.analysis.results import MODES, Mode, ScopeResult
from smooth_operator.study.analysis.separated import in_words, split

FEW_OPERATORS: Final = 10
"""Fewer clusters than this, and asymptotic tests are warned of."""


_SKEW: Final = 1.0


_HEAVY: Final = 3.0


_UNEQUAL: Final = 2.0


_MOST_FOR_SHAPIRO: Final = 5000


_RARE: Final = 5


def layout(frame: Frame) -> tuple[dict[str, Any], list[str]]:
    """Who did what: operators, cells that are empty, operators that lack a retargeter."""
    cells = np.zeros((len(frame.retargeters), len(frame.tasks)), int)
    np.add.at(cells, (frame.retargeter, frame.task), 1)
    present = np.zeros((len(frame.operators), len(frame.retargeters)), bool)
    present[frame.group, frame.retargeter] = True
    empty = [f"{frame.retargeters[j]} in task {frame.tasks[k]}" for j, k in np.argwhere(cells == 0)]
    partial = [frame.operators[i] for i in np.flatnonzero(~present.all(axis=1))]
    facts = {
        "operators": len(frame.operators),
        "rows_per_cell": {
            name: dict(zip(frame.tasks, map(int, cells[j]), strict=True))
            for j, name in enumerate(frame.retargeters)
        },
        "empty_cells": empty,
        "operators_without_every_retargeter": partial,
    }
    notes = []
    if len(frame.operators) < FEW_OPERATORS:
        notes.append(
            f"only {len(frame.operators)} operators: tests that are right for many (mode paper) "
            "find differences too easily"
        )
    if empty:
        notes.append(
            f"no rows of {', '.join(empty)}: means over tasks rest on the model having no "
            "interaction of retargeter and task"
        )
    if partial:
        shown = ", ".join(partial[:6]) + (f" and {len(partial) - 6} more" if partial[6:] else "")
        notes.append(f"not every retargeter has rows of operator {shown}")
    if frame.index_sd == 0:
        notes.append("the index of trials never varies: the term t is left out")
    return facts, notes


def observed(frame: Frame) -> dict[str, Any]:
    """Rows, mean, standard deviation and quartiles of each retargeter, without a model."""
    table = {}
    for j, name in enumerate(frame.retargeters):
        y = frame.outcome[frame.retargeter == j]
        low, middle, high = np.percentile(y, [25, 50, 75])
        table[name] = {
            "n": len(y),
            "mean": float(y.mean()),
            "sd": float(y.std(ddof=1)) if len(y) > 1 else None,
            "q25": float(low),
            "median": float(middle),
            "q75": float(high),
        }
    return table


def residual_checks(
    residuals: Float[np.ndarray, " n"], intercepts: Float[np.ndarray, " g"], frame: Frame
) -> tuple[dict[str, Any], list[str]]:
    """Are residuals of a linear model near normal and equally wide? Are operators outlying?"""
    spreads = {
        name: float(residuals[frame.retargeter == j].std(ddof=1))
        for j, name in enumerate(frame.retargeters)
        if np.sum(frame.retargeter == j) > 1
    }
    groups = [residuals[frame.retargeter == j] for j in range(len(frame.retargeters))]
    groups = [group for group in groups if len(group) > 2]
    facts: dict[str, Any] = {
        "skewness": float(skew(residuals)),
        "excess_kurtosis": float(kurtosis(residuals)),
        "sd_by_retargeter": spreads,
    }
    if 3 <= len(residuals) <= _MOST_FOR_SHAPIRO and np.ptp(residuals) > 0:
        test = shapiro(residuals)
        facts["shapiro_wilk"] = {"w": float(test.statistic), "p": float(test.pvalue)}
    if len(groups) > 1:
        test = levene(*groups)
        facts["levene"] = {"statistic": float(test.statistic), "p": float(test.pvalue)}
    notes = []
    if abs(facts["skewness"]) > _SKEW:
        notes.append(
            f"residuals are skewed ({facts['skewness']:.2f}): means say less than medians; look at "
            "the distributions, and at the logarithm of times"
        )
    if facts["excess_kurtosis"] > _HEAVY:
        notes.append(
            f"residuals have heavy tails (excess kurtosis {facts['excess_kurtosis']:.1f}): a few "
            "trials weigh much"
        )
    if spreads and min(spreads.values()) > 0:
        ratio = max(spreads.values()) / min(spreads.values())
        if ratio > _UNEQUAL:
            wide = max(spreads, key=lambda name: spreads[name])
            notes.append(
                f"residuals spread {ratio:.1f} times as wide for {wide} as for the narrowest "
                "retargeter: standard errors assume the same width"
            )
    if len(intercepts) > 3 and np.std(intercepts) > 0:
        scores = (intercepts - intercepts.mean()) / intercepts.std(ddof=1)
        far = [frame.operators[i] for i in np.flatnonzero(np.abs(scores) > 3.0)]
        facts["outlying_operators"] = far
        if far:
            notes.append(f"operator {', '.join(far)} lies more than 3 standard deviations out")
    return facts, notes


def rare_outcomes(frame: Frame) -> list[str]:
    """Retargeters with too few successes or failures for a normal approximation."""
    notes = []
    for j, name in enumerate(frame.retargeters):
        y = frame.outcome[frame.retargeter == j]
        fewer = int(min(y.sum(), len(y) - y.sum()))
        if fewer < _RARE:
            kind = "successes" if y.sum() < len(y) / 2 else "failures"
            notes.append(f"{name} has only {fewer} {kind} in {len(y)} trials: its error is rough")
    return notes


_IN_R: Final = {
    "operator": "operator",
    "operator:retargeter": "operator:retargeter",
    "block": "operator:retargeter:task",
}


_OWN: Final = {
    "operator:retargeter": "of operator by retargeter",
    "block": "between blocks of one operator and retargeter",
}


_IGNORED: Final = (
    "mode paper has no term for that and takes trials of one block for independent: it finds "
    "differences too easily"
)


def analyze_linear(
    frame: Frame,
    missing: tuple[str, ...] = (),
    *,
    modes: Sequence[Mode] = MODES,
    limits: bool = True,
    unit: str = "",
) -> dict[Mode, ScopeResult]:
    """Fits and compares.

    Args:
        frame: the rows.
        missing: what is known to be absent from them, for the warnings.
        modes: which are wanted.
        limits: whether to find simultaneous intervals against the baseline.
        unit: of the outcome, with a blank in front, for the warnings.

    Returns:
        The result in each mode. ``paper`` has a random intercept for each operator and takes
        statistics for normal. ``small-sample`` has one for each operator with each retargeter as
        well, and with several tasks for each block, and t with Satterthwaite's degrees of freedom.
    """
    blank = ScopeResult(n=len(frame), operators=len(frame.operators), warnings=missing)
    if len(frame):
        facts, notes = layout(frame)
        blank = replace(
            blank,
            observed=observed(frame),
            diagnostics=facts,
            warnings=(*missing, *notes),
        )
    try:
        check_frame(frame)
        design, names = frame.design()
    except StudyError as error:
        return dict.fromkeys(modes, refuse(blank, str(error)))
    results = {}
    for mode in modes:
        small = mode == "small-sample"
        try:
            fit = fit_mixed(
                design, frame.outcome, frame.levels if small else {"operator": frame.group}
            )
        except StudyError as error:
            results[mode] = refuse(blank, str(error))
            continue
        freedom: Freedom = fit.satterthwaite if small else _normal
        checks, notes = residual_checks(fit.residuals, fit.intercepts, frame)
        means = linear_means(frame, fit.beta)

        def effect(mean: float, other: float, spread: float = fit.sd_row) -> float:
            return standardised(mean - other, spread)

        compared = compare(means, fit.covariance, freedom, effect, frame.baseline, limits=limits)
        results[mode] = replace(
            blank,
            coefficients=coefficients(names, fit.beta, fit.covariance, freedom),
            emm=compared.emm,
            dunnett=compared.dunnett,
            pairs=compared.pairs,
            model={
                **_facts(frame, fit),
                **index_facts(frame),
                "dunnett_correlation": compared.correlation,
            },
            diagnostics={**blank.diagnostics, **checks},
            warnings=(*blank.warnings, *notes, *_singular(fit.variances), *compared.warnings),
        )
    exact, paper = results.get("small-sample"), results.get("paper")
    if exact is not None and exact.refused is None:
        apart = _preferences(exact.model["variances"], unit)
        results["small-sample"] = replace(exact, warnings=(*exact.warnings, *apart))
        if apart and paper is not None and paper.refused is None:
            results["paper"] = replace(paper, warnings=(*paper.warnings, *apart, _IGNORED))
    return results


def _normal(_: Float[np.ndarray, " p"]) -> float:
    """Infinite degrees of freedom."""
    return np.inf


def _facts(frame: Frame, fit: MixedFit) -> dict[str, Any]:
    variances = fit.variances
    return {
        "kind": "linear mixed model, REML",
        "formula": formula(frame, random=[name for name in variances if name != "residual"]),
        "variances": variances,
        "sd_operator": float(np.sqrt(variances["operator"])),
        "sd_residual": float(np.sqrt(variances["residual"])),
        "share_of_operators": variances["operator"] / sum(variances.values()),
        "log_likelihood": fit.log_likelihood,
        "singular": variances["operator"] == 0,
        "operator_effects": dict(zip(frame.operators, map(float, fit.intercepts), strict=True)),
    }


def _singular(variances: dict[str, float]) -> tuple[str, ...]:
    if variances["operator"] > 0:
        return ()
    return (
        "singular fit: the variance between operators is estimated as zero, so that what they do "
        "counts as independent of who they are",
    )


def _preferences(variances: dict[str, float], unit: str) -> tuple[str, ...]:
    """How far operators differ in which retargeter suits them, if they do."""
    spreads = [
        f"{float(np.sqrt(variances[name])):.2g}{unit} {words}"
        for name, words in _OWN.items()
        if variances.get(name, 0.0) > 0
    ]
    if not spreads:
        return ()
    return (f"operators differ in which retargeter suits them: SD {' and '.join(spreads)}",)


def refuse(blank: ScopeResult, reason: str) -> ScopeResult:
    """No figures, and why."""
    return replace(blank, refused=reason, warnings=(f"refused: {reason}", *blank.warnings))


def index_facts(frame: Frame) -> dict[str, float]:
    """How the index was standardised; means are at its mean."""
    return {"index_mean": frame.index_mean, "index_sd": frame.index_sd}


def formula(frame: Frame, *, random: Sequence[str] = ()) -> str:
    """The model in R's notation, with the names of its random intercepts."""
    terms = ["retargeter"]
    if len(frame.tasks) > 1:
        terms.append("task")
    if frame.index_sd > 0:
        terms.append(INDEX)
    return " + ".join([f"y ~ {' + '.join(terms)}", *(f"(1 | {_IN_R[name]})" for name in random)])


def analyze_success(frame: Frame, missing: tuple[str, ...] = ()) -> dict[Mode, ScopeResult]:
    """Fits and compares.

    Args:
        frame: the rows, with an outcome of 0 and 1.
        missing: what is known to be absent from them, for the warnings.

    Returns:
        The result in each mode: ``paper`` has the sandwich covariance and normal statistics,
        ``small-sample`` Mancl and DeRouen's and t with one degree of freedom less than operators.
        A retargeter that never or always succeeds is left out of the model, see ``separated``.
    """
    blank = ScopeResult(n=len(frame), operators=len(frame.operators), warnings=missing)
    if len(frame):
        facts, notes = layout(frame)
        blank = replace(
            blank,
            observed=observed(frame),
            diagnostics={**facts, "one_sided_cells": one_sided_cells(frame)},
            warnings=(*missing, *notes),
        )
    try:
        check_frame(frame)
        rest, separated = split(frame)
        notes = [in_words(name, results) for name, results in separated.items()]
        blank = replace(blank, separated=separated, warnings=(*blank.warnings, *notes))
        if rest is None:
            raise StudyError("no retargeter has both successes and failures")
        frame = rest
        notes = rare_outcomes(frame)
        blank = replace(
            blank,
            n=len(frame),
            operators=len(frame.operators),
            warnings=(*blank.warnings, *notes),
        )
        check_frame(frame, retargeters=1)
        design, names = frame.design()
        _check_separation(frame, design, names)
        fit = fit_gee(design, frame.outcome, frame.group)
        fit.check_correlation()
    except StudyError as error:
        return dict.fromkeys(MODES, refuse(blank, str(error)))
    model = {
        "kind": "logistic GEE, exchangeable working correlation",
        "formula": formula(frame),
        "alpha": fit.alpha,
        "phi": fit.phi,
        **index_facts(frame),
    }
    notes = _warnings(frame, fit)
    covariances = {"small-sample": fit.mancl_derouen, "paper": fit.robust}
    freedoms = {"small-sample": float(fit.operators - 1), "paper": np.inf}
    results: dict[Mode, ScopeResult] = {}
    for mode in MODES:
        covariance, df = covariances[mode], freedoms[mode]
        base = replace(blank, model=model, warnings=(*blank.warnings, *notes))
        if covariance is None:
            results[mode] = refuse(
                base,
                "an operator has so much leverage that its residuals can't be corrected: too few "
                f"operators ({fit.operators}) for {len(names)} coefficients",
            )
            continue
        results[mode] = _in_mode(base, frame, fit, names, covariance, df)
    return results


def _in_mode(
    base: ScopeResult,
    frame: Frame,
    fit: GeeFit,
    names: list[str],
    covariance: Float[np.ndarray, "p p"],
    df: float,
) -> ScopeResult:
    freedom: Freedom = lambda contrast: df  # noqa: E731
    compared = compare(
        response_means(frame, fit.beta), covariance, freedom, cohen_h, frame.baseline
    )
    # The same on the logit scale, for those who report odds ratios.
    logits = compare(
        linear_means(frame, fit.beta), covariance, freedom, lambda a, b: a - b, frame.baseline
    )
    warnings = list(compared.warnings)
    for name, mean in compared.emm.items():
        if mean.lower < 0 or mean.upper > 1:
            warnings.append(
                f"the interval of {name} leaves 0 to 1: the delta method is rough so near the edge"
            )
    return replace(
        base,
        coefficients=coefficients(names, fit.beta, covariance, freedom),
        emm=compared.emm,
        dunnett=compared.dunnett,
        pairs=compared.pairs,
        model={
            **base.model,
            "dunnett_correlation": compared.correlation,
            "odds_ratios": {name: _odds(test) for name, test in logits.dunnett.items()},
        },
        warnings=(*base.warnings, *warnings),
    )


def _odds(test: Any) -> dict[str, float]:
    return {
        "odds_ratio": float(np.exp(test.difference)),
        "lower": float(np.exp(test.lower)),
        "upper": float(np.exp(test.upper)),
        "log_odds_ratio": test.difference,
        "se": test.se,
        "p_raw": test.p_raw,
        "p_dunnett": test.p_dunnett,
    }


def _check_separation(frame: Frame, design: Float[np.ndarray, "n p"], names: list[str]) -> None:
    levels = one_sided_levels(frame)
    if levels:
        raise StudyError(
            f"separation: {'; '.join(levels)}, so its odds are estimated as zero or infinite and "
            "have no standard error; see the observed rates"
        )
    direction = separating(design, frame.outcome)
    if direction is not None:
        named = ", ".join(name for name, x in zip(names, direction, strict=True) if abs(x) > 1e-6)
        raise StudyError(
            f"separation: a combination of {named} tells success without error in a part of the "
            "rows, so its odds are infinite and have no standard error; see the observed rates"
        )


def _warnings(frame: Frame, fit: GeeFit) -> list[str]:
    notes = [f"{cell}; the model shares its other rows" for cell in one_sided_cells(frame)]
    if fit.operators <= len(fit.beta):
        notes.append(
            f"{fit.operators} operators for {len(fit.beta)} coefficients: the sandwich covariance "
            "is singular, and its standard errors are far too small"
        )
    if fit.alpha < 0:
        notes.append(
            f"the working correlation is negative ({fit.alpha:.3f}): rows of one operator are no "
            "more alike than those of different ones"
        )
    return notes
