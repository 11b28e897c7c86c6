"""Reading: are two retargeters alike within a margin? Two one-sided tests (Schuirmann 1987)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, stdtr

from smooth_operator.study.analysis.dunnett import quantile
from smooth_operator.study.analysis.holm import holm
from smooth_operator.study.analysis.results import Pair, ScopeResult

ALPHA = 0.05


@dataclass(frozen=True)
class Equivalence:
    """One pair, ``a`` minus ``b``.

    Attributes:
        difference: in the outcome's unit (success: a share).
        lower: of the 90 % interval, the one that goes with two tests at 5 %.
        upper: of the 90 % interval.
        margin: of the plan; None without one.
        p: larger of both one-sided p-values; None without a margin.
        p_holm: corrected over the other retargeters against the baseline; None in other pairs.
        equivalent: whether p is under 0.05; None without a margin.
        smallest_margin: with which p would be 0.05. It is chosen after seeing the data, so it shows
            nothing.
    """

    a: str
    b: str
    difference: float
    se: float
    df: float
    lower: float
    upper: float
    margin: float | None
    p: float | None
    p_holm: float | None
    equivalent: bool | None
    smallest_margin: float


def equivalences(
    result: ScopeResult, baseline: str, margin: float | None
) -> Mapping[str, Equivalence]:
    """Every pair of a scope, by ``a-b``; the other retargeters against the baseline come first.

    Args:
        result: in mode small-sample; none of it where that is refused.
        baseline: the retargeter that others are compared with.
        margin: of the plan, in the outcome's unit; None without one.
    """
    against = [pair for pair in result.pairs.values() if baseline in (pair.a, pair.b)]
    others = [pair for pair in result.pairs.values() if baseline not in (pair.a, pair.b)]
    turned = [_turned(pair) if pair.a == baseline else pair for pair in against]
    tests = [_test(pair, margin) for pair in (*turned, *others)]
    if margin is not None and turned:
        adjusted = holm([one.p for one in tests[: len(turned)] if one.p is not None])
        for i, p in enumerate(adjusted):
            tests[i] = _with(tests[i], p)
    return {f"{one.a}-{one.b}": one for one in tests}


def _turned(pair: Pair) -> Pair:
    return Pair(
        pair.b, pair.a, -pair.difference, pair.se, pair.df, -pair.statistic, pair.p_raw,
        pair.p_holm, -pair.effect, pair.effect_words,
    )  # fmt: skip


def _test(pair: Pair, margin: float | None) -> Equivalence:
    reach = pair.se * quantile(pair.df, ALPHA)
    low, high = pair.difference - reach, pair.difference + reach
    p = None
    if margin is not None:
        nearest = (abs(pair.difference) - margin) / pair.se
        p = float(stdtr(pair.df, nearest) if np.isfinite(pair.df) else ndtr(nearest))
    return Equivalence(
        pair.a, pair.b, pair.difference, pair.se, pair.df, low, high, margin, p, None,
        None if p is None else p < ALPHA, max(abs(low), abs(high)),
    )  # fmt: skip


def _with(test: Equivalence, p_holm: float) -> Equivalence:
    return Equivalence(**{**vars(test), "p_holm": float(p_holm)})
