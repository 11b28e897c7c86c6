"""Success, time or workload over one scope: model, means, comparisons and checks of assumptions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from scipy.stats import kurtosis, levene, shapiro, skew

from smooth_operator.errors import StudyError
from smooth_operator_study.analysis.frame import INDEX, Frame, check_frame, keep_rows
from smooth_operator_study.analysis.gee import (
    GeeFit,
    OneSided,
    one_sided_cells,
    one_sided_levels,
)
from smooth_operator_study.analysis.mixed import MixedFit
from smooth_operator_study.analysis.models import (
    Comparisons,
    Fit,
    check_separation,
    coefficients,
    compare,
    fit_modes,
    fit_with,
    linear_means,
)
from smooth_operator_study.analysis.results import (
    MODES,
    Mode,
    Outcome,
    Refused,
    ScopeResult,
    Separated,
)

FEW_OPERATORS: Final = 10
"""Number of operators below which asymptotic tests get a warning."""
SKEW: Final = 1.0
"""Skewness above which residuals count as skewed."""
_HEAVY: Final = 3.0
_UNEQUAL: Final = 2.0
_MOST_FOR_SHAPIRO: Final = 5000
_RARE: Final = 5
_IN_R: Final = {
    "operator": "operator",
    "operator:retargeter": "operator:retargeter",
    "block": "operator:retargeter:task",
}
_OWN: Final = {
    "operator:retargeter": "of operator by retargeter",
    "block": "between blocks of one operator and retargeter",
}
_TAIL: Final = 0.05
_UNITS: Final[dict[Outcome, str]] = {"success": "", "time": " s", "tlx": " points"}
_IGNORED: Final = (
    "mode paper has no term for this and treats trials of one block as independent, so its "
    "p-values are too small"
)


def analyze(
    outcome: Outcome,
    frame: Frame,
    missing: tuple[str, ...] = (),
    *,
    modes: Sequence[Mode] = MODES,
    limits: bool = True,
    decide: float | None = None,
) -> dict[Mode, ScopeResult]:
    """Fits the models of an outcome and compares the retargeters.

    Args:
        frame: rows of the model; success has an outcome of 0 and 1.
        limits: whether to compute simultaneous intervals against the baseline.
        decide: significance level. Only the means and tests are then computed, fast: p-values may
            be bounds on the same side of the level; intervals, odds ratios, the checks of residuals
            and the search for combinations of terms that separate are left out.

    Returns:
        The result in each mode. Retargeters that never or always succeed are in ``separated``, too.
    """
    blank = ScopeResult(n=len(frame), operators=len(frame.operators), warnings=missing)
    success = outcome == "success"
    if len(frame) and decide is None:
        facts, notes = layout(frame)
        if success:
            facts["one_sided_cells"] = one_sided_cells(frame)
            facts["least_p"] = least_p(frame)
        blank = replace(
            blank, observed=observed(frame), diagnostics=facts, warnings=(*missing, *notes)
        )
    try:
        check_frame(frame)
        if success:
            levels = one_sided_levels(frame)
            alone = separated(frame)
            notes = [*map(separated_in_words, alone, alone.values()), *_one_sided_tasks(levels)]
            warnings = (*blank.warnings, *notes, *rare_outcomes(frame))
            blank = replace(blank, separated=alone, warnings=warnings)
            if decide is None:
                check_separation(frame)
        fits = fit_modes(outcome, frame, modes)
    except StudyError as error:
        return dict.fromkeys(modes, refuse(blank, str(error)))
    results = {mode: _result(blank, fit, limits, decide) for mode, fit in fits.items()}
    if success:
        # A refused covariance does not concern the facts of the fit.
        gee = next((fit.model for fit in fits.values() if isinstance(fit, Fit)), None)
        for mode, fit in fits.items():
            if isinstance(fit, Refused) and isinstance(gee, GeeFit):
                base = replace(
                    blank,
                    model=_gee_facts(frame, gee),
                    warnings=(*blank.warnings, *_gee_warnings(frame, gee)),
                )
                results[mode] = refuse(base, fit.refused)
    apart = _preferences(results, _UNITS[outcome])
    for mode, result in results.items():
        if apart and result.refused is None:
            more = (_IGNORED,) if mode == "paper" else ()
            results[mode] = replace(result, warnings=(*result.warnings, *apart, *more))
    return results


def layout(frame: Frame) -> tuple[dict[str, Any], list[str]]:
    """Counts rows of each cell, and finds empty cells and operators without a retargeter."""
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
            f"only {len(frame.operators)} operators: with few operators, the published "
            "analysis (mode paper) gives too many false positives"
        )
    if empty:
        notes.append(
            f"no rows of {', '.join(empty)}: means over tasks assume that retargeter and "
            "task do not interact"
        )
    if partial:
        shown = ", ".join(partial[:6]) + (f" and {len(partial) - 6} more" if partial[6:] else "")
        notes.append(f"not every retargeter has rows of operator {shown}")
    if frame.index_sd == 0:
        notes.append("the index of trials is constant: the term t is omitted")
    return facts, notes


def observed(frame: Frame) -> dict[str, Any]:
    """Computes mean, standard deviation and quartiles of each retargeter, without a model."""
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
    """Checks that residuals are near normal and equally wide, and that no operator is outlying."""
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
    if abs(facts["skewness"]) > SKEW:
        notes.append(
            f"residuals are skewed ({facts['skewness']:.2f}): medians describe the data "
            "better than means; look at the distributions"
        )
    if facts["excess_kurtosis"] > _HEAVY:
        notes.append(
            f"residuals have heavy tails (excess kurtosis {facts['excess_kurtosis']:.1f}): a "
            "few trials have a large influence"
        )
    if spreads and min(spreads.values()) > 0:
        ratio = max(spreads.values()) / min(spreads.values())
        if ratio > _UNEQUAL:
            wide = max(spreads, key=lambda name: spreads[name])
            notes.append(
                f"the spread of residuals is {ratio:.1f} times as wide for {wide} as for the "
                "narrowest retargeter: standard errors assume the same width"
            )
    if len(intercepts) > 3 and np.std(intercepts) > 0:
        scores = (intercepts - intercepts.mean()) / intercepts.std(ddof=1)
        far = [frame.operators[i] for i in np.flatnonzero(np.abs(scores) > 3.0)]
        facts["outlying_operators"] = far
        if far:
            notes.append(f"operator {', '.join(far)} lies more than 3 standard deviations out")
    return facts, notes


def rare_outcomes(frame: Frame) -> list[str]:
    """Notes on retargeters with too few successes or failures for a normal approximation."""
    notes = []
    for j, name in enumerate(frame.retargeters):
        y = frame.outcome[frame.retargeter == j]
        fewer = int(min(y.sum(), len(y) - y.sum()))
        if 0 < fewer < _RARE:
            kind = "success" if y.sum() < len(y) / 2 else "failure"
            kind += "" if fewer == 1 else "es" if kind == "success" else "s"
            notes.append(
                f"{name} has only {fewer} {kind} in {len(y)} trials: its standard error is "
                "approximate"
            )
    return notes


def _result(
    blank: ScopeResult, fit: Fit | Refused, limits: bool, decide: float | None
) -> ScopeResult:
    if isinstance(fit, Refused):
        return refuse(blank, fit.refused)
    compared = fit.compare(limits=limits and decide is None, decide=decide)
    if decide is not None:
        return replace(blank, emm=compared.emm, dunnett=compared.dunnett, pairs=compared.pairs)
    frame, checks = fit.frame, dict[str, Any]()
    if isinstance(fit.model, MixedFit):
        checks, notes = residual_checks(fit.model.residuals, fit.model.intercepts, frame)
        model = _mixed_facts(frame, fit.model)
        if fit.model.variances["operator"] == 0:
            notes.append(
                "singular fit: the variance between operators is estimated as zero, so "
                "trials of one operator are treated as independent"
            )
        if fit.outcome == "time" and abs(checks["skewness"]) > SKEW:
            notes.append(
                "times are skewed: compare with the model of their logarithms (reading "
                "log_time), which gives ratios of times"
            )
        notes += compared.warnings
    else:
        notes = [*_gee_warnings(frame, fit.model), *compared.warnings]
        model = _gee_facts(frame, fit.model) | {"odds_ratios": _odds(fit)}
    return replace(
        blank,
        coefficients=coefficients(fit.names, fit.beta, fit.covariance, fit.freedom),
        emm=compared.emm,
        dunnett=compared.dunnett,
        pairs=compared.pairs,
        model=model | {"dunnett_correlation": compared.correlation},
        diagnostics={**blank.diagnostics, **checks},
        warnings=(*blank.warnings, *notes),
    )


def _mixed_facts(frame: Frame, fit: MixedFit) -> dict[str, Any]:
    variances = fit.variances
    return {
        "kind": "linear mixed model, REML",
        "formula": formula(frame, random=fit.levels),
        "variances": variances,
        "sd_operator": float(np.sqrt(variances["operator"])),
        "sd_residual": float(np.sqrt(variances["residual"])),
        "share_of_operators": variances["operator"] / sum(variances.values()),
        "log_likelihood": fit.log_likelihood,
        "singular": variances["operator"] == 0,
        "operator_effects": dict(zip(frame.operators, map(float, fit.intercepts), strict=True)),
        **_index_facts(frame),
    }


def _gee_facts(frame: Frame, fit: GeeFit) -> dict[str, Any]:
    if fit.firth:
        return {
            "kind": "Firth's logistic regression, covariance clustered by operators",
            "formula": formula(frame),
            "firth": True,
            **_index_facts(frame),
        }
    return {
        "kind": "logistic GEE, exchangeable working correlation",
        "formula": formula(frame),
        "alpha": fit.alpha,
        "phi": fit.phi,
        **_index_facts(frame),
    }


def _index_facts(frame: Frame) -> dict[str, float]:
    """Mean and standard deviation by which the index was standardised."""
    return {"index_mean": frame.index_mean, "index_sd": frame.index_sd}


def _preferences(results: dict[Mode, ScopeResult], unit: str) -> tuple[str, ...]:
    """Note on how much operators differ in which retargeter suits them; empty if they do not."""
    exact = results.get("small-sample")
    variances = {} if exact is None or exact.refused else exact.model.get("variances", {})
    spreads = [
        f"{float(np.sqrt(variances[name])):.2g}{unit} {words}"
        for name, words in _OWN.items()
        if variances.get(name, 0.0) > 0
    ]
    if not spreads:
        return ()
    return (f"operators differ in the retargeter that suits them: SD {' and '.join(spreads)}",)


def refuse(blank: ScopeResult, reason: str) -> ScopeResult:
    """Makes a result that contains no numbers, but the reason for the refusal."""
    return replace(blank, refused=reason, warnings=(f"not tested: {reason}", *blank.warnings))


def formula(frame: Frame, *, random: Sequence[str] = ()) -> str:
    """Returns the model in R's notation, with the names of its random intercepts."""
    terms = ["retargeter"]
    if len(frame.tasks) > 1:
        terms.append("task")
    if frame.index_sd > 0:
        terms.append(INDEX)
    return " + ".join([f"y ~ {' + '.join(terms)}", *(f"(1 | {_IN_R[name]})" for name in random)])


def _odds(fit: Fit) -> dict[str, dict[str, float]]:
    """Comparisons as odds ratios, from the logit scale."""
    means = linear_means(fit.frame, fit.beta)
    logits: Comparisons = compare(
        means, fit.covariance, fit.freedom, lambda a, b: a - b, fit.frame.baseline
    )
    return {
        name: {
            "odds_ratio": float(np.exp(test.difference)),
            "lower": float(np.exp(test.lower)),
            "upper": float(np.exp(test.upper)),
            "log_odds_ratio": test.difference,
            "se": test.se,
            "p_raw": test.p_raw,
            "p_dunnett": test.p_dunnett,
        }
        for name, test in logits.dunnett.items()
    }


def _one_sided_tasks(levels: list[OneSided]) -> list[str]:
    return [
        f"{level.text}: success is analysed with Firth's model, in which the odds of this "
        "task are finite"
        for level in levels
        if level.text.startswith("task ")
    ]


def _gee_warnings(frame: Frame, fit: GeeFit) -> list[str]:
    apart = separated(frame)
    notes = [
        f"{cell}; the model shares its other rows"
        for cell in one_sided_cells(frame)
        if not any(cell.startswith(f"{name} in task ") for name in apart)
    ]
    if fit.operators <= len(fit.beta):
        notes.append(
            f"{fit.operators} operators for {len(fit.beta)} coefficients: the sandwich covariance "
            "is singular, and its standard errors are far too small"
        )
    if fit.alpha < 0:
        notes.append(
            f"the working correlation is negative ({fit.alpha:.3f}): rows of one operator "
            "are no more similar than rows of different operators"
        )
    return notes


def least_p(frame: Frame) -> float | None:
    """Computes the smallest Dunnett p-value of success that the rows of a study can lead to.

    It is that of the clearest result: one retargeter always succeeds, the others never.

    Args:
        frame: rows of the design; their outcome is not used.

    Returns:
        The p-value, mode small-sample. None if no outcome of these rows can be tested.
    """
    found = []
    for j in range(len(frame.retargeters)):
        clear = replace(frame, outcome=(frame.retargeter == j).astype(float))
        try:
            result = fit_with("success", clear).compare(limits=False)
        except StudyError:
            return None
        found += [test.p_dunnett for test in result.dunnett.values()]
    return min(found, default=None)


def separated(frame: Frame) -> dict[str, Separated]:
    """Finds the retargeters that never or always succeed, and bounds their success rates.

    The bound takes each operator as one observation, whatever the correlation of their trials. If
    none of G operators succeeds, the share of operators who do is at most 1 - 0.05^(1/G). So is the
    success rate, since an operator's rate is at most the probability of one success or more.

    Args:
        frame: frame whose outcome is the success of each trial, 0 or 1.

    Returns:
        The retargeters by name. None if all trials have one outcome.
    """
    if not len(frame) or np.ptp(frame.outcome) == 0:
        return {}
    found = {}
    for j, name in enumerate(frame.retargeters):
        rows = frame.retargeter == j
        if np.ptp(frame.outcome[rows]) == 0:
            always = bool(frame.outcome[rows][0])
            trials, operators = int(rows.sum()), len(np.unique(frame.group[rows]))
            edges = [float(_TAIL ** (1 / units)) for units in (operators, trials)]
            bounds = edges if always else [1 - edge for edge in edges]
            found[name] = Separated(float(always), trials, operators, *bounds)
    return found


def without_separated(frame: Frame) -> Frame | None:
    """Rows of the retargeters that have both successes and failures; None if no retargeter has."""
    apart = separated(frame)
    if not apart:
        return frame
    rest = ~np.isin(np.array(frame.retargeters)[frame.retargeter], list(apart))
    return keep_rows(frame, rest) if rest.any() else None


def separated_in_words(name: str, result: Separated) -> str:
    """Describes a separated retargeter for the warnings."""
    share, side = ("all", "at least") if result.rate else ("none", "at most")
    return (
        f"{name} succeeded in {share} of {result.trials} trials of {result.operators} "
        "operators: its odds are infinite, so success is analysed with Firth's model, which "
        f"estimates a rate short of {100 * result.rate:.0f} %. Its success rate is {side} "
        f"{100 * result.bound:.1f} % (exact 95 % bound with operators as units; "
        f"{100 * result.bound_if_independent:.1f} % if all trials were independent)"
    )
