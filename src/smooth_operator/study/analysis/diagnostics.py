"""Assumptions of the models, checked: figures for the results and sentences for the reader."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from jaxtyping import Float
from scipy.stats import kurtosis, levene, shapiro, skew

from smooth_operator.study.analysis.frame import Frame

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
    seen = np.zeros((len(frame.operators), len(frame.retargeters)), bool)
    seen[frame.group, frame.retargeter] = True
    empty = [f"{frame.retargeters[j]} in task {frame.tasks[k]}" for j, k in np.argwhere(cells == 0)]
    partial = [frame.operators[i] for i in np.flatnonzero(~seen.all(axis=1))]
    facts = {
        "operators": len(frame.operators),
        "rows_per_cell": {
            name: dict(zip(frame.tasks, map(int, cells[j]), strict=True))
            for j, name in enumerate(frame.retargeters)
        },
        "empty_cells": empty,
        "operators_without_every_retargeter": partial,
    }
    said = []
    if len(frame.operators) < FEW_OPERATORS:
        said.append(
            f"only {len(frame.operators)} operators: tests that are right for many (mode paper) "
            "find differences too easily"
        )
    if empty:
        said.append(
            f"no rows of {', '.join(empty)}: means over tasks rest on the model having no "
            "interaction of retargeter and task"
        )
    if partial:
        shown = ", ".join(partial[:6]) + (f" and {len(partial) - 6} more" if partial[6:] else "")
        said.append(f"not every retargeter has rows of operator {shown}")
    if frame.index_sd == 0:
        said.append("the index of trials never varies: the term t is left out")
    return facts, said


def observed(frame: Frame) -> dict[str, Any]:
    """Rows, mean, standard deviation and quartiles of each retargeter, without a model."""
    found = {}
    for j, name in enumerate(frame.retargeters):
        y = frame.outcome[frame.retargeter == j]
        low, middle, high = np.percentile(y, [25, 50, 75])
        found[name] = {
            "n": len(y),
            "mean": float(y.mean()),
            "sd": float(y.std(ddof=1)) if len(y) > 1 else None,
            "q25": float(low),
            "median": float(middle),
            "q75": float(high),
        }
    return found


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
    said = []
    if abs(facts["skewness"]) > _SKEW:
        said.append(
            f"residuals are skewed ({facts['skewness']:.2f}): means say less than medians; look at "
            "the distributions, and at the logarithm of times"
        )
    if facts["excess_kurtosis"] > _HEAVY:
        said.append(
            f"residuals have heavy tails (excess kurtosis {facts['excess_kurtosis']:.1f}): a few "
            "trials weigh much"
        )
    if spreads and min(spreads.values()) > 0:
        ratio = max(spreads.values()) / min(spreads.values())
        if ratio > _UNEQUAL:
            wide = max(spreads, key=lambda name: spreads[name])
            said.append(
                f"residuals spread {ratio:.1f} times as wide for {wide} as for the narrowest "
                "retargeter: standard errors assume the same width"
            )
    if len(intercepts) > 3 and np.std(intercepts) > 0:
        scores = (intercepts - intercepts.mean()) / intercepts.std(ddof=1)
        far = [frame.operators[i] for i in np.flatnonzero(np.abs(scores) > 3.0)]
        facts["outlying_operators"] = far
        if far:
            said.append(f"operator {', '.join(far)} lies more than 3 standard deviations out")
    return facts, said


def rare_outcomes(frame: Frame) -> list[str]:
    """Retargeters with too few successes or failures for a normal approximation."""
    said = []
    for j, name in enumerate(frame.retargeters):
        y = frame.outcome[frame.retargeter == j]
        fewer = int(min(y.sum(), len(y) - y.sum()))
        if fewer < _RARE:
            kind = "successes" if y.sum() < len(y) / 2 else "failures"
            said.append(f"{name} has only {fewer} {kind} in {len(y)} trials: its error is rough")
    return said
