"""Further readings of a study, next to the models that are reported.

Success as the full score only; equivalence by two one-sided tests (Schuirmann 1987); interaction of
retargeter and task; preference. Each has its figures, or the reason why it has
none.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.special import ndtr, stdtr

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.dunnett import holm, quantile
from smooth_operator.study.analysis.frame import (
    Frame,
    check_frame,
    success_frame,
    time_frame,
    tlx_frame,
    within,
)
from smooth_operator.study.analysis.models import WaldTest, fit_with
from smooth_operator.study.analysis.outcomes import observed
from smooth_operator.study.analysis.preference import Preference, preference
from smooth_operator.study.analysis.results import (
    OUTCOMES,
    POOLED,
    Outcome,
    Pair,
    Refused,
    ScopeResult,
    plain,
    refusable,
)
from smooth_operator.study.analysis.separated import split
from smooth_operator.study.data.rows import StudyData, Trials

ALPHA: Final = 0.05


def full_success(trials: Trials, scope: str, baseline: str) -> ScopeResult:
    """Analyses success as a score of 1, by the model of success in mode small-sample."""
    frame = success_frame(trials, scope, baseline)
    frame = replace(frame, outcome=(trials.score[within(trials, scope)] >= 1).astype(float))
    blank = ScopeResult(n=len(frame), operators=len(frame.operators), observed=observed(frame))
    try:
        rest, separated = split(frame)
        blank = replace(blank, separated=separated)
        if rest is None:
            raise StudyError("no retargeter has both full successes and other trials")
        compared = fit_with("success", rest).compare()
    except StudyError as error:
        return replace(blank, refused=str(error))
    return replace(
        blank,
        emm=compared.emm,
        dunnett=compared.dunnett,
        pairs=compared.pairs,
        n=len(rest),
        operators=len(rest.operators),
        warnings=compared.warnings,
    )


@dataclass(frozen=True)
class Interaction:
    """Joint test of retargeter x task in the model of all tasks."""

    test: WaldTest
    n: int
    operators: int

    @property
    def found(self) -> bool:
        """True if p is under 0.05."""
        return self.test.p < ALPHA


@refusable
def joint_interaction(outcome: Outcome, frame: Frame) -> Interaction:
    """Tests retargeter x task.

    Args:
        outcome: outcome of the model.
        frame: rows of all tasks.
    """
    check_frame(frame)
    if len(frame.tasks) < 2:
        raise StudyError("the study has one task")
    columns = []
    for j, name in enumerate(frame.retargeters):
        for k, task in enumerate(frame.tasks):
            cell = (frame.retargeter == j) & (frame.task == k)
            if not cell.any():
                raise StudyError(f"no rows of {name} in task {task}")
            if j and k:
                columns.append(cell.astype(float))
    fit = fit_with(outcome, frame, np.column_stack(columns))
    return Interaction(fit.joint(slice(-len(columns), None)), len(frame), len(frame.operators))


@dataclass(frozen=True)
class Equivalence:
    """Two one-sided tests of a pair, ``a`` minus ``b``.

    Attributes:
        difference: difference in the outcome's unit (success: a share).
        lower: lower end of the 90 % interval, which belongs to two tests at 5 %.
        upper: upper end of the 90 % interval.
        margin: margin of the plan; None without one.
        p: larger of the two one-sided p-values; None without a margin.
        p_holm: p corrected over the other retargeters against the baseline; None in other pairs.
        equivalent: whether p is under 0.05; None without a margin.
        smallest_margin: margin with a p of 0.05. It depends on the data, so it is no evidence.
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
    """Tests the equivalence of every pair of a scope.

    Args:
        result: result in mode small-sample.
        baseline: retargeter that the others are compared with.
        margin: margin of the plan in the outcome's unit; None without one.

    Returns:
        Tests by ``a-b``, those against the baseline first; empty if the result is refused.
    """
    pairs = result.pairs.values()
    against = [pair for pair in pairs if baseline in (pair.a, pair.b)]
    tests = [_equivalence(pair, margin, turn=pair.a == baseline) for pair in against]
    if margin is not None:
        adjusted = holm([one.p for one in tests if one.p is not None])
        tests = [replace(one, p_holm=p) for one, p in zip(tests, adjusted, strict=True)]
    tests += [_equivalence(pair, margin) for pair in pairs if baseline not in (pair.a, pair.b)]
    return {f"{one.a}-{one.b}": one for one in tests}


def _equivalence(pair: Pair, margin: float | None, *, turn: bool = False) -> Equivalence:
    a, b = (pair.b, pair.a) if turn else (pair.a, pair.b)
    difference, reach = (
        -pair.difference if turn else pair.difference,
        pair.se * quantile(pair.df, ALPHA),
    )
    low, high = difference - reach, difference + reach
    p = None
    if margin is not None:
        nearest = (abs(difference) - margin) / pair.se
        p = float(stdtr(pair.df, nearest) if np.isfinite(pair.df) else ndtr(nearest))
    return Equivalence(
        a, b, difference, pair.se, pair.df, low, high, margin, p, None,
        None if p is None else p < ALPHA, max(abs(low), abs(high)),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Readings:
    """Further readings. All but ``equivalence`` are sensitivity or secondary analyses.

    Attributes:
        full_success: success as a score of 1, by scope.
        equivalence: equivalence tests by outcome, scope and pair.
        interaction: test of retargeter x task by outcome.
        preference: analysis of the rankings; None without rankings.
    """

    full_success: Mapping[str, ScopeResult]
    equivalence: Mapping[Outcome, Mapping[str, Mapping[str, Equivalence]]]
    interaction: Mapping[Outcome, Interaction | Refused]
    preference: Preference | Refused | None = None


Results = Mapping[Outcome, Mapping[str, ScopeResult]]
"""Results of mode small-sample by outcome and scope."""


def read_further(
    data: StudyData,
    retargeters: tuple[str, ...],
    scopes: tuple[str, ...],
    results: Results,
    interaction: Mapping[Outcome, Interaction | Refused],
    *,
    seed: int = 11,
) -> Readings:
    """Computes all readings.

    Args:
        data: data of the study.
        retargeters: names of the retargeters, the baseline first.
        scopes: ``pooled`` and the tasks.
        results: results of mode small-sample.
        interaction: result of ``interactions``.
        seed: seed of the permutations.
    """
    trials, baseline = data.trials, retargeters[0]
    margins = data.plan.margins if data.plan else {}
    rankings = {who: tuple(order) for who, order in data.ranking.items()}
    return Readings(
        full_success={scope: full_success(trials, scope, baseline) for scope in scopes},
        equivalence={
            outcome: {
                scope: equivalences(results[outcome][scope], baseline, margins.get(outcome))
                for scope in scopes
            }
            for outcome in OUTCOMES
        },
        interaction=interaction,
        preference=preference(rankings, retargeters, seed=seed) if rankings else None,
    )


def interactions(data: StudyData, baseline: str) -> dict[Outcome, Interaction | Refused]:
    """Tests retargeter x task for every outcome.

    Args:
        data: data of the study.
        baseline: retargeter that the others are compared with.
    """
    frames = _frames(data, baseline)
    return {outcome: joint_interaction(outcome, frame) for outcome, frame in frames.items()}


def _frames(data: StudyData, baseline: str) -> dict[Outcome, Frame]:
    success = success_frame(data.trials, POOLED, baseline)
    frames: dict[Outcome, Frame] = {
        "success": split(success)[0] or success,  # without retargeters that never or always succeed
        "time": time_frame(data.trials, POOLED, baseline),
    }
    if data.questionnaires is not None:
        frames["tlx"] = tlx_frame(data.questionnaires, POOLED, baseline)
    return frames


Row = dict[str, Any]


def reading_rows(readings: Readings) -> list[Row]:
    """Returns the readings as table rows: ``reading``, ``where``, ``term``, and the figures.

    ``where`` is outcome, scope or field, joined by slashes. ``refused`` has the reason in rows
    without figures.
    """
    return [row for name, content in vars(readings).items() for row in _rows(name, content)]


def _rows(reading: str, content: Any) -> Iterator[Row]:
    if content is None:
        return
    yield from _descend(reading, (), plain(content))


def _descend(reading: str, path: tuple[str, ...], content: Any) -> Iterator[Row]:
    """Yields a row for each mapping with numbers, also for nested ones."""
    if not isinstance(content, Mapping):
        return
    numbers = {
        key: value for key, value in content.items() if not isinstance(value, (Mapping, list))
    }
    if numbers:
        yield {
            "reading": reading,
            "where": "/".join(path[:-1]),
            "term": "".join(path[-1:]),
        } | numbers
    for key, value in content.items():
        if key not in _NOT_IN_ROWS:
            yield from _descend(reading, (*path, str(key)), value)


_NOT_IN_ROWS = frozenset({"model", "diagnostics", "observed", "coefficients"})
"""Parts of a result that other tables hold."""
