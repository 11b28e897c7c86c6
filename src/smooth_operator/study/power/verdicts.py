"""Verdicts of the analysis on simulated studies: significant differences and their rates.

The analysis is that of ``study analyze``, limited to what decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.stats import binomtest

from smooth_operator.study.analysis.dunnett import quantile
from smooth_operator.study.analysis.frame import outcome_frames
from smooth_operator.study.analysis.outcomes import analyze
from smooth_operator.study.analysis.results import POOLED, Mode, Outcome, ScopeResult
from smooth_operator.study.data.rows import StudyData
from smooth_operator.study.power.simulated_study import Assumptions

ALPHA: Final = 0.05
Counts = dict[str, int]
"""Name of a count (see ``count``) -> number of studies."""


@dataclass(frozen=True)
class Verdict:
    """Significant differences of one outcome in one scope and mode.

    Attributes:
        outcome: success, time or tlx.
        scope: ``pooled`` or a task.
        mode: mode of the analysis.
        against: condition -> sign of its significant difference from the baseline by Dunnett, or 0.
        pairs: (condition, condition) -> sign of the significant difference by Holm, the first minus
            the second, or 0.
        smallest_margin: condition -> larger absolute end of the 90 % interval of its difference
            from the baseline. By two one-sided tests at 5 % both are equivalent within any larger
            margin.
        refused: reason why the analysis has no figures; None if it has.
    """

    outcome: Outcome
    scope: str
    mode: Mode
    against: dict[str, int]
    pairs: dict[tuple[str, str], int]
    refused: str | None = None
    smallest_margin: dict[str, float] = field(default_factory=dict)


def verdicts(
    study: StudyData, baseline: str, scopes: Sequence[str] = (POOLED,)
) -> Iterator[Verdict]:
    """Yields the verdicts on all outcomes of a study, in both modes.

    Args:
        baseline: retargeter that the others are compared with.
        scopes: ``pooled`` and tasks.
    """
    for scope in scopes:
        for outcome, frame in outcome_frames(study, scope, baseline).items():
            for mode, result in analyze(outcome, frame, decide=ALPHA).items():
                yield _verdict(Verdict(outcome, scope, mode, {}, {}), result, baseline)


def _verdict(blank: Verdict, result: ScopeResult, baseline: str) -> Verdict:
    """Decides by the tests of a model, and by the exact tests of separated retargeters."""
    count = len(result.emm)
    if result.refused is not None or len(result.pairs) < count * (count - 1) // 2:
        return replace(blank, refused=result.refused or "a difference has no estimated error")
    pairs = {(one.a, one.b): _sign(one.difference, one.p_holm) for one in result.pairs.values()}
    against = {name: _sign(one.difference, one.p_dunnett) for name, one in result.dunnett.items()}
    margins = {
        name: abs(one.difference) + one.se * quantile(one.df, ALPHA)
        for name, one in result.dunnett.items()
    }
    for name, exact in result.separated.items():
        for other, test in exact.against.items():
            # Pairs of the analysis have the baseline first, then the order of names.
            turned = other == baseline or (name != baseline and other < name)
            sign = _sign(test.difference, test.p_holm)
            pairs[(other, name) if turned else (name, other)] = -sign if turned else sign
            if test.p_dunnett is not None:
                sign = _sign(test.difference, test.p_dunnett)
                against[name if other == baseline else other] = sign if other == baseline else -sign
    return replace(blank, against=against, pairs=pairs, smallest_margin=margins)


def _sign(difference: float, p: float) -> int:
    return int(np.sign(difference)) if p <= ALPHA else 0


@dataclass(frozen=True)
class Rate:
    """Share of the simulated studies, with its error.

    Attributes:
        rate: share of the studies.
        se: Monte-Carlo standard error of the share.
        lower: lower end of the 95 % interval (Wilson 1927).
        upper: upper end of the 95 % interval.
    """

    rate: float
    se: float
    lower: float
    upper: float


def count(
    verdict: Verdict, truth: Assumptions, baseline: str, margins: Mapping[str, float] | None = None
) -> Counts:
    """Counts the right and wrong decisions of a verdict.

    Args:
        baseline: condition that the others are compared with.
        margins: outcome -> margin of equivalence in its unit.

    Returns:
        ``dunnett:NAME`` and ``holm:A-B``: a true difference was significant with its sign;
        ``dunnett:all`` and ``holm:all``: all true differences were; ``family:dunnett`` and
        ``family:holm``: a difference was significant that does not exist, or with the wrong sign;
        ``equivalent:NAME``: the difference from the baseline was shown to be below the margin;
        ``refused``: the analysis was refused.
    """
    if verdict.refused is not None:
        return {"refused": 1}
    values = {"success": truth.success, "time": truth.time_s, "tlx": truth.workload}
    value = values[verdict.outcome]
    counts: Counts = {}
    margin = (margins or {}).get(verdict.outcome)
    if margin is not None:
        for name, smallest in verdict.smallest_margin.items():
            if smallest < margin:
                counts[f"equivalent:{name}"] = 1
    families = {
        "dunnett": {name: (name, baseline, sign) for name, sign in verdict.against.items()},
        "holm": {f"{a}-{b}": (a, b, sign) for (a, b), sign in verdict.pairs.items()},
    }
    for family, tests in families.items():
        wrong, true, right = False, 0, 0
        for name, (a, b, sign) in tests.items():
            really = int(np.sign(value[a] - value[b]))
            true += really != 0
            if sign and sign == really:
                counts[f"{family}:{name}"] = 1
                right += 1
            wrong = wrong or (sign != 0 and sign != really)
        if wrong:
            counts[f"family:{family}"] = 1
        if true and right == true:
            counts[f"{family}:all"] = 1
    return counts


def rate(hits: int, studies: int) -> Rate:
    """Computes a share with its error."""
    p = hits / studies
    interval = binomtest(hits, studies).proportion_ci(method="wilson")
    return Rate(p, float(np.sqrt(p * (1 - p) / studies)), *map(float, interval))
