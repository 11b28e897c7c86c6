"""Verdicts of the analysis on simulated studies: significant differences and their rates.

The models and tests are those of ``study analyze``, without intervals, effect sizes and
diagnostics; a test checks that both give the same verdicts. Dunnett's integral is computed only if
its bounds do not decide.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.dunnett import quantile
from smooth_operator.study.analysis.frame import (
    Frame,
    check_frame,
    success_frame,
    time_frame,
    tlx_frame,
)
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
from smooth_operator.study.data.rows import StudyData
from smooth_operator.study.power.simulated_study import Assumptions

ALPHA: Final = 0.05
_Z: Final = 1.959963984540054
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
        frames: dict[Outcome, Frame] = {
            "success": success_frame(study.trials, scope, baseline),
            "time": time_frame(study.trials, scope, baseline),
        }
        if study.questionnaires is not None:
            frames["tlx"] = tlx_frame(study.questionnaires, scope, baseline)
        for outcome, frame in frames.items():
            yield from _verdicts(outcome, frame, scope)


def _verdicts(outcome: Outcome, frame: Frame, scope: str) -> Iterator[Verdict]:
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
    """Decides by the tests of a fit, and by the exact tests of separated retargeters."""
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


@dataclass
class Tally:
    """Counts of the verdicts for one number of operators and one truth.

    Attributes:
        studies: number of studies.
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
        """Adds the verdicts on one study."""
        self.studies += 1
        for verdict in verdicts:
            key = f"{verdict.outcome}/{verdict.scope}/{verdict.mode}"
            self.counts.setdefault(key, Counter()).update(count(verdict, truth, baseline, margins))

    def merge(self, studies: int, counts: Mapping[str, Mapping[str, int]]) -> None:
        """Adds the counts of other studies."""
        self.studies += studies
        for key, more in counts.items():
            self.counts.setdefault(key, Counter()).update(more)


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
    spread = _Z * math.sqrt(p * (1 - p) / studies + _Z**2 / (4 * studies**2))
    centre, scale = p + _Z**2 / (2 * studies), 1 + _Z**2 / studies
    return Rate(
        p,
        math.sqrt(p * (1 - p) / studies),
        (centre - spread) / scale if hits else 0.0,
        (centre + spread) / scale if hits < studies else 1.0,
    )


def rates(tally: Tally) -> dict[str, dict[str, Any]]:
    """Computes ``outcome/scope/mode`` -> name of a count -> ``Rate``."""
    return {
        key: {
            what: rate(counts[what], tally.studies)
            for what in sorted({*counts, "family:dunnett", "family:holm", "refused"})
        }
        for key, counts in tally.counts.items()
    }
