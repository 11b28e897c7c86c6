"""Success over one scope: logistic GEE, means of probabilities and comparisons in both modes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis import diagnostics
from smooth_operator.study.analysis.contrasts import (
    Freedom,
    coefficients,
    cohen_h,
    compare,
    linear_means,
    response_means,
)
from smooth_operator.study.analysis.frame import Frame, check_frame
from smooth_operator.study.analysis.gee import GeeFit, fit_gee
from smooth_operator.study.analysis.linear_outcome import formula, index_facts, refuse
from smooth_operator.study.analysis.results import MODES, Mode, ScopeResult
from smooth_operator.study.analysis.separated import in_words, split
from smooth_operator.study.analysis.separation import (
    one_sided_cells,
    one_sided_levels,
    separating,
)


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
        facts, said = diagnostics.layout(frame)
        blank = replace(
            blank,
            observed=diagnostics.observed(frame),
            diagnostics={**facts, "one_sided_cells": one_sided_cells(frame)},
            warnings=(*missing, *said),
        )
    try:
        check_frame(frame)
        rest, separated = split(frame)
        said = [in_words(name, found) for name, found in separated.items()]
        blank = replace(blank, separated=separated, warnings=(*blank.warnings, *said))
        if rest is None:
            raise StudyError("no retargeter has both successes and failures")
        frame = rest
        said = diagnostics.rare_outcomes(frame)
        blank = replace(
            blank,
            n=len(frame),
            operators=len(frame.operators),
            warnings=(*blank.warnings, *said),
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
    said = _warnings(frame, fit)
    covariances = {"small-sample": fit.mancl_derouen, "paper": fit.robust}
    freedoms = {"small-sample": float(fit.operators - 1), "paper": np.inf}
    found: dict[Mode, ScopeResult] = {}
    for mode in MODES:
        covariance, df = covariances[mode], freedoms[mode]
        base = replace(blank, model=model, warnings=(*blank.warnings, *said))
        if covariance is None:
            found[mode] = refuse(
                base,
                "an operator has so much leverage that its residuals can't be corrected: too few "
                f"operators ({fit.operators}) for {len(names)} coefficients",
            )
            continue
        found[mode] = _in_mode(base, frame, fit, names, covariance, df)
    return found


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
    said = [f"{cell}; the model shares its other rows" for cell in one_sided_cells(frame)]
    if fit.operators <= len(fit.beta):
        said.append(
            f"{fit.operators} operators for {len(fit.beta)} coefficients: the sandwich covariance "
            "is singular, and its standard errors are far too small"
        )
    if fit.alpha < 0:
        said.append(
            f"the working correlation is negative ({fit.alpha:.3f}): rows of one operator are no "
            "more alike than those of different ones"
        )
    return said
