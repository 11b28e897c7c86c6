"""Time or workload over one scope: linear mixed model, means and comparisons in both modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis import diagnostics
from smooth_operator.study.analysis.contrasts import Freedom, coefficients, compare
from smooth_operator.study.analysis.effects import standardised
from smooth_operator.study.analysis.emm import linear_means
from smooth_operator.study.analysis.frame import INDEX, Frame, check_frame
from smooth_operator.study.analysis.mixed import fit_mixed
from smooth_operator.study.analysis.results import MODES, Mode, ScopeResult


def analyze_linear(
    frame: Frame,
    missing: tuple[str, ...] = (),
    *,
    modes: Sequence[Mode] = MODES,
    limits: bool = True,
) -> dict[Mode, ScopeResult]:
    """Fits and compares.

    Args:
        frame: the rows.
        missing: what is known to be absent from them, for the warnings.
        modes: which are wanted.
        limits: whether to find simultaneous intervals against the baseline.

    Returns:
        The result in each mode: ``paper`` takes statistics for normal, ``small-sample`` for t with
        Satterthwaite's degrees of freedom. Estimates and standard errors are the same.
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
        fit = fit_mixed(design, frame.outcome, frame.group)
    except StudyError as error:
        return dict.fromkeys(modes, refuse(blank, str(error)))
    checks, said = diagnostics.residual_checks(fit.residuals, fit.intercepts, frame)
    if fit.singular:
        said.append(
            "singular fit: the variance between operators is estimated as zero, so that trials "
            "count as independent"
        )
    model = {
        "kind": "linear mixed model, REML",
        "formula": formula(frame, random=True),
        "sd_operator": fit.sd_operator,
        "sd_residual": fit.sd_residual,
        "share_of_operators": fit.ratio / (1 + fit.ratio),
        "log_likelihood": fit.log_likelihood,
        "singular": fit.singular,
        "operator_effects": dict(zip(frame.operators, map(float, fit.intercepts), strict=True)),
        **index_facts(frame),
    }
    means = linear_means(frame, fit.beta)

    def effect(mean: float, other: float) -> float:
        return standardised(mean - other, fit.sd_operator, fit.sd_residual)

    freedoms: dict[Mode, Freedom] = {
        "small-sample": fit.satterthwaite,
        "paper": lambda contrast: np.inf,
    }
    found = {}
    for mode in modes:
        freedom = freedoms[mode]
        compared = compare(means, fit.covariance, freedom, effect, frame.baseline, limits=limits)
        found[mode] = replace(
            blank,
            coefficients=coefficients(names, fit.beta, fit.covariance, freedom),
            emm=compared.emm,
            dunnett=compared.dunnett,
            pairs=compared.pairs,
            model={**model, "dunnett_correlation": compared.correlation},
            diagnostics={**blank.diagnostics, **checks},
            warnings=(*blank.warnings, *said, *compared.warnings),
        )
    return found


def refuse(blank: ScopeResult, reason: str) -> ScopeResult:
    """No figures, and why."""
    return replace(blank, refused=reason, warnings=(f"refused: {reason}", *blank.warnings))


def index_facts(frame: Frame) -> dict[str, float]:
    """How the index was standardised; means are at its mean."""
    return {"index_mean": frame.index_mean, "index_sd": frame.index_sd}


def formula(frame: Frame, *, random: bool) -> str:
    """The model in R's notation."""
    terms = ["retargeter"]
    if len(frame.tasks) > 1:
        terms.append("task")
    if frame.index_sd > 0:
        terms.append(INDEX)
    return f"y ~ {' + '.join(terms)}" + (" + (1 | operator)" if random else "")
