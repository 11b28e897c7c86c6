"""Reading: the three scores as an ordered outcome, and success as the full score only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import expit

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis import diagnostics
from smooth_operator.study.analysis.contrasts import compare
from smooth_operator.study.analysis.dunnett import dunnett
from smooth_operator.study.analysis.effects import cohen_h
from smooth_operator.study.analysis.frame import Frame, check_frame, keep_rows
from smooth_operator.study.analysis.outcome_frames import success_frame, within
from smooth_operator.study.analysis.readings.clusters import WaldTest, clustered_wald
from smooth_operator.study.analysis.readings.cumulative_logit import (
    CumulativeLogit,
    fit_cumulative_logit,
)
from smooth_operator.study.analysis.readings.fits import fit_with
from smooth_operator.study.analysis.readings.parts import (
    Estimate,
    Refused,
    estimated,
    found_or_refused,
)
from smooth_operator.study.analysis.results import ScopeResult
from smooth_operator.study.analysis.separated import split
from smooth_operator.study.data.rows import SCORES, Trials


@dataclass(frozen=True)
class OddsRatio:
    """Odds of a higher score, over those with the baseline, with its simultaneous interval."""

    odds_ratio: float
    lower: float
    upper: float
    log_odds_ratio: float
    se: float
    df: float
    p_raw: float
    p_dunnett: float


@dataclass(frozen=True)
class OrdinalReading:
    """Proportional odds over the scores.

    Attributes:
        mean_score: by retargeter, 0 to 1, tasks weighing equally.
        odds_ratios: by retargeter, without the baseline.
        proportional: test that the odds ratios are those of both cuts, under 1 and under 0.5
            (Brant 1990, operators as clusters); None where a cut can't be fitted.
        left_out: retargeters whose trials all have the score 0, or all 1.
        shares: by retargeter, how many trials had each score, as they are.
    """

    mean_score: Mapping[str, Estimate]
    odds_ratios: Mapping[str, OddsRatio]
    proportional: WaldTest | None
    shares: Mapping[str, Mapping[str, float]]
    left_out: tuple[str, ...]
    n: int
    operators: int


def full_success(trials: Trials, scope: str, baseline: str) -> ScopeResult:
    """Success as a score of 1, by the model of success in mode small-sample."""
    frame = success_frame(trials, scope, baseline)
    frame = replace(frame, outcome=(trials.score[within(trials, scope)] >= 1).astype(float))
    blank = ScopeResult(
        n=len(frame), operators=len(frame.operators), observed=diagnostics.observed(frame)
    )
    try:
        rest, separated = split(frame)
        blank = replace(blank, separated=separated)
        if rest is None:
            raise StudyError("no retargeter has both full successes and other trials")
        fit = fit_with("success", rest)
        found = compare(fit.means, fit.covariance, fit.freedom, cohen_h, baseline)
    except StudyError as error:
        return replace(blank, refused=str(error))
    return replace(
        blank,
        emm=found.emm,
        dunnett=found.dunnett,
        pairs=found.pairs,
        n=len(rest),
        operators=fit.operators,
        warnings=found.warnings,
    )


def ordinal(trials: Trials, scope: str, baseline: str) -> OrdinalReading | Refused:
    """Proportional odds over the scores of a scope, against the baseline."""
    return found_or_refused(lambda: _ordinal(trials, scope, baseline))


def _ordinal(trials: Trials, scope: str, baseline: str) -> OrdinalReading:
    frame = success_frame(trials, scope, baseline)
    frame = replace(frame, outcome=trials.score[within(trials, scope)])
    check_frame(frame)
    left_out = _one_sided(frame)
    kept = ~np.isin(frame.retargeter, [frame.retargeters.index(name) for name in left_out])
    frame = keep_rows(frame, kept)
    check_frame(frame)
    if frame.retargeters[0] != baseline:
        raise StudyError(f"no trials with the baseline, {baseline}, or all have one score")
    values, level = np.unique(frame.outcome, return_inverse=True)
    if len(values) < len(SCORES):
        absent = ", ".join(f"{score:g}" for score in SCORES if score not in values)
        raise StudyError(f"no trial has the score {absent}: the outcome has two levels only")
    design = frame.design()[0][:, 1:]
    fit = fit_cumulative_logit(design, level, frame.group)
    df, others = float(len(frame.operators) - 1), len(frame.retargeters) - 1
    place = fit.thresholds + np.arange(others)
    return OrdinalReading(
        mean_score=_means(frame, fit, values, df),
        odds_ratios=_odds(
            frame.retargeters[1:],
            fit.parameters[place],
            fit.covariance[np.ix_(place, place)],
            df,
        ),
        proportional=_brant(frame, design, level),
        shares={
            name: {
                f"{score:g}": float(np.mean(frame.outcome[frame.retargeter == j] == score))
                for score in SCORES
            }
            for j, name in enumerate(frame.retargeters)
        },
        left_out=left_out,
        n=len(frame),
        operators=len(frame.operators),
    )


def _one_sided(frame: Frame) -> tuple[str, ...]:
    """Retargeters that no odds ratio can hold: all trials have the lowest score, or the highest."""
    found = []
    for j, name in enumerate(frame.retargeters):
        scores = frame.outcome[frame.retargeter == j]
        if np.ptp(scores) == 0 and scores[0] in (SCORES[0], SCORES[-1]):
            found.append(name)
    return tuple(found)


def _means(
    frame: Frame, fit: CumulativeLogit, values: Float[np.ndarray, " k"], df: float
) -> dict[str, Estimate]:
    """Expected scores, by the delta method; tasks weigh equally."""
    count = fit.thresholds
    grid = frame.grid(len(fit.beta) + 1)[:, :, 1:]
    linear = fit.parameters[:count] - (grid @ fit.beta)[..., None]
    below = expit(linear)
    mean = values[-1] - np.mean(below @ np.diff(values), axis=1)
    steep = below * (1 - below) * np.diff(values)
    by_theta = -np.mean(steep, axis=1)
    by_beta = np.mean(np.sum(steep, axis=-1)[..., None] * grid, axis=1)
    gradient = np.column_stack([by_theta, by_beta])
    variance = np.einsum("ri,ij,rj->r", gradient, fit.covariance, gradient)
    return {
        name: estimated(mean[j], float(np.sqrt(variance[j])), df)
        for j, name in enumerate(frame.retargeters)
    }


def _odds(
    names: tuple[str, ...],
    values: Float[np.ndarray, " m"],
    covariance: Float[np.ndarray, "m m"],
    df: float,
) -> dict[str, OddsRatio]:
    se = np.sqrt(np.diag(covariance))
    family = dunnett(list(values / se), covariance / np.outer(se, se), [df] * len(values))
    found = {}
    for j, name in enumerate(names):
        reach = family.critical[j] * se[j]
        found[name] = OddsRatio(
            odds_ratio=float(np.exp(values[j])),
            lower=float(np.exp(values[j] - reach)),
            upper=float(np.exp(values[j] + reach)),
            log_odds_ratio=float(values[j]),
            se=float(se[j]),
            df=df,
            p_raw=estimated(values[j], float(se[j]), df).p,
            p_dunnett=family.p[j],
        )
    return found


def _brant(frame: Frame, design: Float[np.ndarray, "n p"], level: np.ndarray) -> WaldTest | None:
    """Do the retargeters' coefficients of both cuts agree? From two logits fitted side by side."""
    others = slice(1, len(frame.retargeters))
    try:
        low, high = (
            fit_cumulative_logit(design, (level >= cut).astype(int), frame.group) for cut in (1, 2)
        )
        apart = (high.influence - low.influence)[:, others]
        return clustered_wald(
            (high.parameters - low.parameters)[others], apart.T @ apart, len(frame.operators)
        )
    except StudyError:
        return None
