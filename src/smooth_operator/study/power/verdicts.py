"""Verdict of the analysis on simulated studies: which differences are significant, and how often.

The same models and tests as ``study analyze``, without what a report needs and a verdict does not:
intervals, effect sizes, diagnostics. A test holds the two to the same verdicts. Dunnett's integral
is worked out only where its bounds leave the verdict open.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.contrasts import MarginalMeans, linear_means, response_means
from smooth_operator.study.analysis.dunnett import holm, outside, quantile, two_sided
from smooth_operator.study.analysis.frame import Frame, check_frame
from smooth_operator.study.analysis.gee import fit_gee
from smooth_operator.study.analysis.mixed import fit_mixed
from smooth_operator.study.analysis.results import POOLED, Mode, Outcome, Separated
from smooth_operator.study.analysis.separated import split
from smooth_operator.study.power.simulated_study import Assumptions, Layout, Rows, Simulated

ALPHA: Final = 0.05


Freedom = Callable[[Float[np.ndarray, " p"]], float]


@dataclass(frozen=True)
class Verdict:
    """One outcome in one scope and mode.

    Attributes:
        outcome: which.
        scope: ``pooled`` or a task.
        mode: of the analysis.
        against: condition -> sign of its significant difference from the baseline, else 0; by
            Dunnett.
        pairs: (condition, condition) -> likewise, of the first minus the second; by Holm.
        smallest_margin: condition -> end of the 90 % interval of its difference from the baseline
            that is further from zero: by two one-sided tests at 5 %, both are equivalent within any
            margin that is larger.
        refused: why the analysis gives no figures; None if it does.
    """

    outcome: Outcome
    scope: str
    mode: Mode
    against: dict[str, int]
    pairs: dict[tuple[str, str], int]
    refused: str | None = None
    smallest_margin: dict[str, float] = field(default_factory=dict)


class Analyst:
    """Analyses simulated studies of one layout.

    Args:
        layout: rows of the study.
        scopes: ``pooled`` and tasks.
    """

    def __init__(self, layout: Layout, scopes: tuple[str, ...] = (POOLED,)) -> None:
        self._layout = layout
        self._scopes = scopes

    def verdicts(self, study: Simulated) -> Iterator[Verdict]:
        """All outcomes and scopes, in both modes."""
        trials, questionnaires = self._layout.trials, self._layout.questionnaires
        for scope in self._scopes:
            rows = self._within(trials, scope)
            yield from self._success(self._frame(trials, study.success.astype(float), rows), scope)
            yield from self._linear(
                self._frame(trials, study.time_s, rows & study.success), "time", scope
            )
            if len(questionnaires.index):
                frame = self._frame(
                    questionnaires, study.workload, self._within(questionnaires, scope)
                )
                yield from self._linear(frame, "tlx", scope)

    def _within(self, rows: Rows, scope: str) -> Bool[np.ndarray, " n"]:
        if scope == POOLED:
            return np.ones(len(rows.index), bool)
        return np.asarray(rows.task == self._layout.tasks.index(scope))

    def _frame(
        self, rows: Rows, outcome: Float[np.ndarray, " n"], used: Bool[np.ndarray, " n"]
    ) -> Frame:
        conditions, condition = np.unique(rows.condition[used], return_inverse=True)
        tasks, task = np.unique(rows.task[used], return_inverse=True)
        operators, group = np.unique(rows.operator[used], return_inverse=True)
        return Frame(
            outcome=outcome[used],
            retargeters=tuple(self._layout.conditions[k] for k in conditions),
            retargeter=condition,
            tasks=tuple(self._layout.tasks[k] for k in tasks),
            task=task,
            operators=tuple(self._layout.operators[k] for k in operators),
            group=group,
            index=rows.index[used].astype(float),
            baseline=self._layout.conditions[0],
        )

    def _success(self, frame: Frame, scope: str) -> Iterator[Verdict]:
        separated: dict[str, Separated] = {}
        try:
            check_frame(frame)
            rest, separated = split(frame)
            if rest is None:
                raise StudyError("no retargeter has both successes and failures")
            frame = rest
            check_frame(frame, retargeters=1)
            for codes in (frame.retargeter, frame.task):
                rates = np.bincount(codes, frame.outcome) / np.bincount(codes)
                if np.any((rates == 0) | (rates == 1)):
                    raise StudyError("separation: a condition or task always or never succeeds")
            fit = fit_gee(frame.design()[0], frame.outcome, frame.group)
            fit.check_correlation()
        except StudyError as error:
            yield from _refusals("success", scope, str(error))
            return
        means = response_means(frame, fit.beta)
        verdict = _verdict("success", scope, "paper", frame, means, fit.robust, lambda _: np.inf)
        yield _with_separated(verdict, separated, frame)
        if fit.mancl_derouen is None:
            reason = "an operator's leverage can't be corrected"
            yield Verdict("success", scope, "small-sample", {}, {}, reason)
            return
        df = float(fit.operators - 1)
        verdict = _verdict(
            "success", scope, "small-sample", frame, means, fit.mancl_derouen, lambda _: df
        )
        yield _with_separated(verdict, separated, frame)

    def _linear(self, frame: Frame, outcome: Outcome, scope: str) -> Iterator[Verdict]:
        try:
            check_frame(frame)
            design = frame.design()[0]
            fit = fit_mixed(design, frame.outcome, {"operator": frame.group})
        except StudyError as error:
            yield from _refusals(outcome, scope, str(error))
            return
        means = linear_means(frame, fit.beta)
        yield _verdict(outcome, scope, "paper", frame, means, fit.covariance, lambda _: np.inf)
        try:
            nested = fit_mixed(design, frame.outcome, frame.levels)
        except StudyError as error:
            yield Verdict(outcome, scope, "small-sample", {}, {}, str(error))
            return
        means = linear_means(frame, nested.beta)
        yield _verdict(
            outcome, scope, "small-sample", frame, means, nested.covariance, nested.satterthwaite
        )


def _refusals(outcome: Outcome, scope: str, reason: str) -> Iterator[Verdict]:
    blank = Verdict(outcome, scope, "paper", {}, {}, reason)
    yield blank
    yield replace(blank, mode="small-sample")


def _with_separated(verdict: Verdict, separated: dict[str, Separated], frame: Frame) -> Verdict:
    """With the exact comparisons of retargeters that are in no model."""
    if not separated or verdict.refused is not None:
        return verdict
    against, pairs = dict(verdict.against), dict(verdict.pairs)
    for name, result in separated.items():
        for other, test in result.against.items():
            # As the pairs of the analysis are named: the baseline first, then by name.
            turned = other == frame.baseline or (name != frame.baseline and other < name)
            key = (other, name) if turned else (name, other)
            pairs[key] = _sign(
                -test.difference if turned else test.difference, test.p_holm <= ALPHA
            )
            if test.p_dunnett is None:
                continue
            sign = _sign(test.difference, test.p_dunnett <= ALPHA)
            if other == frame.baseline:
                against[name] = sign
            else:
                against[other] = -sign
    return replace(verdict, against=against, pairs=pairs)


def _verdict(
    outcome: Outcome,
    scope: str,
    mode: Mode,
    frame: Frame,
    means: MarginalMeans,
    covariance: Float[np.ndarray, "p p"],
    freedom: Freedom,
) -> Verdict:
    names = means.names
    statistics: dict[tuple[int, int], tuple[float, float]] = {}
    for a, b in combinations(range(len(names)), 2):
        contrast = means.gradient[a] - means.gradient[b]
        variance = float(contrast @ covariance @ contrast)
        if not variance > 0:
            return Verdict(outcome, scope, mode, {}, {}, "a difference has no estimated error")
        difference = float(means.values[a] - means.values[b])
        statistics[a, b] = (difference / np.sqrt(variance), freedom(contrast))
    raw = {key: two_sided(*test) for key, test in statistics.items()}
    adjusted = dict(zip(raw, holm(list(raw.values())), strict=True))
    pairs = {
        (names[a], names[b]): _sign(statistics[a, b][0], adjusted[a, b] <= ALPHA)
        for a, b in statistics
    }
    against: dict[str, int] = {}
    margins: dict[str, float] = {}
    if names[0] == frame.baseline:
        others = range(1, len(names))
        correlation = _correlation(means.covariance(covariance))
        for j in others:
            statistic, df = statistics[0, j]
            significant = _dunnett_rejects(statistic, raw[0, j], correlation, df)
            against[names[j]] = _sign(-statistic, significant)
            difference = abs(float(means.values[0] - means.values[j]))
            error = difference / abs(statistic) if statistic else float("nan")
            margins[names[j]] = difference + error * quantile(df, ALPHA)
    return Verdict(outcome, scope, mode, against, pairs, smallest_margin=margins)


def _dunnett_rejects(
    statistic: float, raw: float, correlation: Float[np.ndarray, "m m"], df: float
) -> bool:
    if raw > ALPHA:  # the adjusted p is no lower than the raw one,
        return False
    if len(correlation) * raw <= ALPHA:  # and no higher than Bonferroni's
        return True
    return outside(abs(statistic), correlation, df)[0] <= ALPHA


def _correlation(covariance: Float[np.ndarray, "r r"]) -> Float[np.ndarray, "m m"]:
    """Of each mean minus the first."""
    spread = covariance[1:, 1:] + covariance[0, 0] - covariance[1:, :1] - covariance[:1, 1:]
    scale = np.sqrt(np.diag(spread))
    return np.asarray(spread / np.outer(scale, scale))


def _sign(statistic: float, significant: bool) -> int:
    return int(np.sign(statistic)) if significant else 0


_Z: Final = 1.959963984540054


Counts = dict[str, int]
"""What was counted -> how often; see ``count``."""


@dataclass(frozen=True)
class Rate:
    """How often something happened.

    Attributes:
        rate: share of the studies.
        se: its Monte-Carlo standard error.
        lower: of the 95 % interval (Wilson 1927).
        upper: of it.
    """

    rate: float
    se: float
    lower: float
    upper: float


@dataclass
class Tally:
    """Counts of one number of operators and one truth, which can be added up.

    Attributes:
        studies: how many.
        counts: ``outcome/scope/mode`` -> counts.
    """

    studies: int = 0
    counts: dict[str, Counter[str]] = field(default_factory=dict)

    def add(
        self,
        verdicts: Iterable[Verdict],
        truth: Assumptions,
        baseline: str,
        margins: Mapping[str, float],
    ) -> None:
        """One study more."""
        self.studies += 1
        for verdict in verdicts:
            key = f"{verdict.outcome}/{verdict.scope}/{verdict.mode}"
            self.counts.setdefault(key, Counter()).update(count(verdict, truth, baseline, margins))

    def merge(self, studies: int, counts: Mapping[str, Mapping[str, int]]) -> None:
        """The counts of other studies."""
        self.studies += studies
        for key, more in counts.items():
            self.counts.setdefault(key, Counter()).update(more)


def count(
    verdict: Verdict, truth: Assumptions, baseline: str, margins: Mapping[str, float] | None = None
) -> Counts:
    """What one verdict got right and wrong.

    Args:
        verdict: of one outcome.
        truth: what was assumed.
        baseline: condition that others are compared with.
        margins: outcome -> largest difference of equivalent conditions, in its unit.

    Returns:
        ``dunnett:NAME`` and ``holm:A-B``: a true difference was found, with its right sign;
        ``dunnett:all`` and ``holm:all``: all of them; ``family:dunnett`` and ``family:holm``: a
        difference was found that is none, or with the wrong sign; ``equivalent:NAME``: its
        difference from the baseline was shown to be below the margin; ``refused``.
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
    """A share with its error."""
    p = hits / studies
    spread = _Z * math.sqrt(p * (1 - p) / studies + _Z**2 / (4 * studies**2))
    centre, scale = p + _Z**2 / (2 * studies), 1 + _Z**2 / studies
    return Rate(
        p,
        math.sqrt(p * (1 - p) / studies),
        (centre - spread) / scale if hits else 0.0,
        (centre + spread) / scale if hits < studies else 1.0,
    )


def rates(tally: Tally) -> dict[str, dict[str, Any]]:
    """``outcome/scope/mode`` -> what was counted -> ``Rate``."""
    return {
        key: {
            what: rate(counts[what], tally.studies)
            for what in sorted({*counts, "family:dunnett", "family:holm", "refused"})
        }
        for key, counts in tally.counts.items()
    }
