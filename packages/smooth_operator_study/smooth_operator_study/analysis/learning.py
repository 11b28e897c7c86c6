"""Learning: slopes of the outcomes over the number of the trial, in the task and in the block.

Each slope is for one index and a step of one trial, adjusted for retargeter (and task, if pooled).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import expit

from smooth_operator.errors import StudyError
from smooth_operator_study.analysis.dunnett import two_sided
from smooth_operator_study.analysis.frame import Frame, check_frame
from smooth_operator_study.analysis.gee import fit_gee, mancl_derouen, separating
from smooth_operator_study.analysis.mixed import fit_mixed
from smooth_operator_study.analysis.outcomes import separated, without_separated


def linear_slope(frame: Frame) -> dict[str, Any]:
    """Estimates the slope of time or workload over the index of the frame.

    Returns:
        ``slope`` per step with ``se``, ``z`` and ``p_z`` (mode paper), ``se_mancl_derouen``, ``df``
        and ``p_t`` (small-sample: it holds where operators learn at different rates),
        ``df_satterthwaite`` and ``p_satterthwaite`` (if they learn at the same rate), ``n``,
        ``sd_x``; ``per_retargeter`` with a slope for each retargeter. Only ``refused`` and ``n`` if
        the slope can't be estimated.
    """
    try:
        _check(frame)
        factors, _ = frame.factors()
        centred = frame.index - frame.index_mean
        slope: dict[str, Any] = {**_tested(np.column_stack([factors, centred]), frame, 1)[0]}
        slope |= {"n": len(frame), "sd_x": frame.index_sd}
    except StudyError as error:
        return {"refused": str(error), "n": len(frame)}
    try:
        own = (frame.retargeter[:, None] == np.arange(len(frame.retargeters))) * centred[:, None]
        slopes = _tested(np.column_stack([factors, own]), frame, len(frame.retargeters))
        slope["per_retargeter"] = dict(zip(frame.retargeters, slopes, strict=True))
    except (StudyError, np.linalg.LinAlgError) as error:
        slope["per_retargeter"] = {"refused": str(error)}
    return slope


def logistic_slope(frame: Frame) -> dict[str, Any]:
    """Estimates the slope of the log-odds of success over the index of the frame.

    Returns:
        ``slope_logit`` per step with ``se`` (sandwich), ``z`` and ``p_z`` (mode paper),
        ``se_mancl_derouen``, ``df`` and ``p_t`` (small-sample); ``ame_prob_per_unit`` and
        ``ame_se``, the average change of the probability per step; ``n``, ``sd_x``;
        ``without``, retargeters that never or always succeed, if any.
    """
    try:
        _check(frame)
        apart, rest = separated(frame), without_separated(frame)
        if rest is None:
            raise StudyError("no retargeter has both successes and failures")
        frame = rest
        factors, _ = frame.factors()
        design = np.column_stack([factors, frame.index - frame.index_mean])
        if separating(design, frame.outcome) is not None:
            raise StudyError("separation: the model has infinite odds")
        fit = fit_gee(design, frame.outcome, frame.group)
        fit.check_correlation()
    except StudyError as error:
        return {"refused": str(error), "n": len(frame)}
    slope, df = float(fit.beta[-1]), float(fit.operators - 1)
    se = float(np.sqrt(fit.robust[-1, -1]))
    probability = expit(design @ fit.beta)
    spread = probability * (1 - probability)
    gradient = slope * np.mean((spread * (1 - 2 * probability))[:, None] * design, axis=0)
    gradient[-1] += spread.mean()
    result: dict[str, Any] = {
        "slope_logit": slope,
        "se": se,
        "z": slope / se,
        "p_z": two_sided(slope / se, np.inf),
        "ame_prob_per_unit": slope * float(spread.mean()),
        "ame_se": float(np.sqrt(gradient @ fit.robust @ gradient)),
        "n": len(frame),
        "sd_x": frame.index_sd,
    }
    if apart:
        result["without"] = list(apart)
    if fit.mancl_derouen is not None:
        corrected = float(np.sqrt(fit.mancl_derouen[-1, -1]))
        result |= {
            "se_mancl_derouen": corrected,
            "df": df,
            "p_t": two_sided(slope / corrected, df),
        }
    return result


def _check(frame: Frame) -> None:
    check_frame(frame)
    if frame.index_sd == 0:
        raise StudyError("the index is constant, so there is no slope")


def _tested(design: Float[np.ndarray, "n p"], frame: Frame, count: int) -> list[dict[str, float]]:
    """Tests the last coefficients of a mixed model in both ways."""
    fit = fit_mixed(design, frame.outcome, {"operator": frame.group})
    slopes = []
    width = design.shape[1]
    robust = mancl_derouen(
        design, frame.outcome - design @ fit.beta, frame.group, float(fit.ratios[0])
    )
    freedom = float(len(frame.operators) - 1)
    for j in range(width - count, width):
        slope, se = float(fit.beta[j]), float(np.sqrt(fit.covariance[j, j]))
        df = fit.satterthwaite(np.eye(width)[j])
        one = {
            "slope": slope,
            "se": se,
            "z": slope / se,
            "p_z": two_sided(slope / se, np.inf),
            "df_satterthwaite": df,
            "p_satterthwaite": two_sided(slope / se, df),
        }
        if robust is not None:
            corrected = float(np.sqrt(robust[j, j]))
            one |= {
                "se_mancl_derouen": corrected,
                "df": freedom,
                "p_t": two_sided(slope / corrected, freedom),
            }
        slopes.append(one)
    return slopes
