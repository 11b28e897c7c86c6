"""Time or workload over one scope: linear mixed model, means and comparisons in both modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis import diagnostics
from smooth_operator.study.analysis.contrasts import (
    Freedom,
    coefficients,
    compare,
    linear_means,
    standardised,
)
from smooth_operator.study.analysis.frame import INDEX, Frame, check_frame
from smooth_operator.study.analysis.mixed import MixedFit, fit_mixed
from smooth_operator.study.analysis.results import MODES, Mode, ScopeResult

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
        facts, said = diagnostics.layout(frame)
        blank = replace(
            blank,
            observed=diagnostics.observed(frame),
            diagnostics=facts,
            warnings=(*missing, *said),
        )
    try:
        check_frame(frame)
        design, names = frame.design()
    except StudyError as error:
        return dict.fromkeys(modes, refuse(blank, str(error)))
    found = {}
    for mode in modes:
        small = mode == "small-sample"
        try:
            fit = fit_mixed(
                design, frame.outcome, frame.levels if small else {"operator": frame.group}
            )
        except StudyError as error:
            found[mode] = refuse(blank, str(error))
            continue
        freedom: Freedom = fit.satterthwaite if small else _normal
        checks, said = diagnostics.residual_checks(fit.residuals, fit.intercepts, frame)
        means = linear_means(frame, fit.beta)

        def effect(mean: float, other: float, spread: float = fit.sd_row) -> float:
            return standardised(mean - other, spread)

        compared = compare(means, fit.covariance, freedom, effect, frame.baseline, limits=limits)
        found[mode] = replace(
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
            warnings=(*blank.warnings, *said, *_singular(fit.variances), *compared.warnings),
        )
    small, paper = found.get("small-sample"), found.get("paper")
    if small is not None and small.refused is None:
        apart = _preferences(small.model["variances"], unit)
        found["small-sample"] = replace(small, warnings=(*small.warnings, *apart))
        if apart and paper is not None and paper.refused is None:
            found["paper"] = replace(paper, warnings=(*paper.warnings, *apart, _IGNORED))
    return found


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
    said = [
        f"{float(np.sqrt(variances[name])):.2g}{unit} {words}"
        for name, words in _OWN.items()
        if variances.get(name, 0.0) > 0
    ]
    if not said:
        return ()
    return (f"operators differ in which retargeter suits them: SD {' and '.join(said)}",)


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
