"""Verdict of the analysis on simulated studies: which differences are significant, and how often.

The same models and tests as ``study analyze``, without what a report needs and a verdict does not:
intervals, effect sizes, diagnostics. A test holds the two to the same verdicts. Dunnett's integral
is worked out only where its bounds leave the verdict open.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.dunnett import quantile
from smooth_operator.study.analysis.frame import Frame, check_frame
from smooth_operator.study.analysis.gee import one_sided_levels
from smooth_operator.study.analysis.models import ONE_SIDED, Fit, fit_modes
from smooth_operator.study.analysis.results import (
    MODES,
    POOLED,
    Mode,
    Outcome,
    Refused,
    Separated,
)
from smooth_operator.study.analysis.separated import split
from smooth_operator.study.power.simulated_study import Assumptions, Layout, Rows, Simulated

ALPHA: Final = 0.05
_Z: Final = 1.959963984540054
Counts = dict[str, int]
"""Name of a count, see ``count`` -> number of studies."""


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
            frame = self._frame(trials, study.success.astype(float), rows)
            yield from self._verdicts("success", frame, scope)
            frame = self._frame(trials, study.time_s, rows & study.success)
            yield from self._verdicts("time", frame, scope)
            if len(questionnaires.index):
                frame = self._frame(
                    questionnaires, study.workload, self._within(questionnaires, scope)
                )
                yield from self._verdicts("tlx", frame, scope)

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

    def _verdicts(self, outcome: Outcome, frame: Frame, scope: str) -> Iterator[Verdict]:
        separated: dict[str, Separated] = {}
        fits: Mapping[Mode, Fit | Refused]
        try:
            check_frame(frame)
            if outcome == "success":
                rest, separated = split(frame)
                if rest is None:
                    raise StudyError(ONE_SIDED)
                frame = rest
                check_frame(frame, retargeters=1)
                if one_sided_levels(frame):
                    raise StudyError("separation: a condition or task always or never succeeds")
            fits = fit_modes(outcome, frame)
        except StudyError as error:
            fits = dict.fromkeys(MODES, Refused(str(error)))
        for mode, fit in fits.items():
            yield _verdict(Verdict(outcome, scope, mode, {}, {}), fit, separated, frame.baseline)


def _verdict(
    blank: Verdict, fit: Fit | Refused, separated: Mapping[str, Separated], baseline: str
) -> Verdict:
    """The decisions of a fit's tests, and of exact tests of retargeters that are in no model."""
    if isinstance(fit, Refused):
        return replace(blank, refused=fit.refused)
    compared = fit.compare(limits=False, decide=ALPHA)
    count = len(compared.emm)
    if len(compared.pairs) < count * (count - 1) // 2:
        return replace(blank, refused="a difference has no estimated error")
    pairs = {(one.a, one.b): _sign(one.difference, one.p_holm) for one in compared.pairs.values()}
    against = {name: _sign(one.difference, one.p_dunnett) for name, one in compared.dunnett.items()}
    margins = {
        name: abs(one.difference) + one.se * quantile(one.df, ALPHA)
        for name, one in compared.dunnett.items()
    }
    for name, result in separated.items():
        for other, test in result.against.items():
            # As the pairs of the analysis are named: the baseline first, then by name.
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
    """A share of the studies with its error.

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
    """Counts what one verdict got right and wrong.

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
