"""Further analyses of a study (readings), in addition to the models that are reported.

Success as the full score only; the logarithm of times; equivalence by two one-sided tests
(Schuirmann 1987); interaction of retargeter and task; the operators' rankings (Friedman's test,
Kendall's W). Each has its figures, or the reason why it has none.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.special import ndtr, stdtr
from scipy.stats import chi2, skew

from smooth_operator.errors import StudyError
from smooth_operator_study.analysis.dunnett import holm, quantile
from smooth_operator_study.analysis.frame import (
    Frame,
    check_frame,
    frame_of,
    outcome_frames,
)
from smooth_operator_study.analysis.mixed import MixedFit
from smooth_operator_study.analysis.models import WaldTest, fit_with
from smooth_operator_study.analysis.outcomes import observed, separated, without_separated
from smooth_operator_study.analysis.results import (
    OUTCOMES,
    POOLED,
    Outcome,
    Pair,
    Refused,
    ScopeResult,
    plain,
    refusable,
)
from smooth_operator_study.data.rows import StudyData, times
from smooth_operator_study.design.protocol import ALPHA

_PERMUTATIONS: Final = 20_000


@dataclass(frozen=True)
class Preference:
    """Analysis of the operators' rankings of all retargeters, where rank 1 is the best.

    Attributes:
        mean_rank: mean rank of each retargeter.
        wins: retargeter -> other retargeter -> number of operators who prefer the first.
        friedman: statistic of Friedman's test (1937).
        p: p-value by seeded permutations of the ranks within operators.
        p_chi_squared: p-value by the limiting distribution.
        kendall_w: agreement of the operators, 0 to 1.
        operators: number of operators who ranked all retargeters.
        left_out: number of operators who did not rank all.
    """

    mean_rank: Mapping[str, float]
    wins: Mapping[str, Mapping[str, int]]
    friedman: float
    p: float
    p_chi_squared: float
    kendall_w: float
    operators: int
    left_out: int


@refusable
def preference(
    rankings: Mapping[str, Sequence[str]], retargeters: tuple[str, ...], *, seed: int = 11
) -> Preference:
    """Analyses the operators' rankings.

    Args:
        rankings: operator -> retargeters, the best first.
    """
    whole = [list(order) for order in rankings.values() if sorted(order) == sorted(retargeters)]
    if len(whole) < 2:
        raise StudyError(
            f"{len(whole)} operator(s) ranked all retargeters: at least two are needed"
        )
    ranks = np.array([[order.index(name) + 1.0 for name in retargeters] for order in whole])
    operators, count = ranks.shape
    statistic = _friedman(ranks.sum(axis=0), operators)
    rng = np.random.default_rng(seed)
    shuffled = rng.permuted(np.broadcast_to(ranks, (_PERMUTATIONS, *ranks.shape)), axis=2)
    as_far = int(np.sum(_friedman(shuffled.sum(axis=1), operators) >= statistic - 1e-9))
    wins = np.sum(ranks[:, :, None] < ranks[:, None, :], axis=0)
    return Preference(
        mean_rank=dict(zip(retargeters, map(float, ranks.mean(axis=0)), strict=True)),
        wins={
            name: {other: int(wins[i, j]) for j, other in enumerate(retargeters) if j != i}
            for i, name in enumerate(retargeters)
        },
        friedman=float(statistic),
        p=(1 + as_far) / (1 + _PERMUTATIONS),
        p_chi_squared=float(chi2.sf(statistic, count - 1)),
        kendall_w=float(statistic / (operators * (count - 1))),
        operators=operators,
        left_out=len(rankings) - operators,
    )


def _friedman(sums: Float[np.ndarray, "*k r"], operators: int) -> Float[np.ndarray, "*k"]:
    count = sums.shape[-1]
    apart = sums - operators * (count + 1) / 2
    return np.asarray(12 * np.sum(apart**2, axis=-1) / (operators * count * (count + 1)))


def full_success(trials: pd.DataFrame, scope: str, baseline: str) -> ScopeResult:
    """Analyses success as a score of 1, by the model of success in mode small-sample."""
    frame = frame_of(trials.assign(value=(trials.score >= 1).astype(float)), scope, baseline)
    return _compared("success", frame, observed=observed(frame), separated=separated(frame))


def log_time(trials: pd.DataFrame, scope: str, baseline: str) -> ScopeResult:
    """Analyses the logarithm of times of successful trials, by the model of time.

    Times have a floor and a long tail, so their logarithms are often nearer to normal. The
    exponential of a mean is a geometric mean [s], that of a difference a ratio of times.

    Returns:
        Means and differences of ln(time / 1 s), mode small-sample; ``diagnostics`` has the skewness
        of the residuals.
    """
    rows = times(trials)
    return _compared("time", frame_of(rows.assign(value=np.log(rows.value)), scope, baseline))


def _compared(outcome: Outcome, frame: Frame, **facts: Any) -> ScopeResult:
    result = ScopeResult(n=len(frame), operators=len(frame.operators), **facts)
    try:
        fit = fit_with(outcome, frame)
    except StudyError as error:
        return replace(result, refused=str(error))
    if isinstance(fit.model, MixedFit):
        result = replace(result, diagnostics={"skewness": float(skew(fit.model.residuals))})
    compared = fit.compare()
    return replace(
        result,
        emm=compared.emm,
        dunnett=compared.dunnett,
        pairs=compared.pairs,
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
    """Tests retargeter x task."""
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
        smallest_margin: margin with a p of 0.05. It depends on the data, so it is not evidence.
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
        a,
        b,
        difference,
        pair.se,
        pair.df,
        low,
        high,
        margin,
        p,
        None,
        None if p is None else p < ALPHA,
        max(abs(low), abs(high)),
    )


@dataclass(frozen=True, eq=False)
class Readings:
    """Further readings. All but ``equivalence`` are sensitivity or secondary analyses.

    Attributes:
        full_success: success as a score of 1, by scope.
        log_time: logarithm of times, by scope.
        equivalence: equivalence tests by outcome, scope and pair.
        interaction: test of retargeter x task by outcome.
        preference: analysis of the rankings; None without rankings.
    """

    full_success: Mapping[str, ScopeResult]
    log_time: Mapping[str, ScopeResult]
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
        retargeters: names of the retargeters, the baseline first.
        scopes: ``pooled`` and the tasks.
        interaction: result of ``interactions``.
    """
    trials, baseline = data.trials, retargeters[0]
    margins = data.plan.margins if data.plan else {}
    return Readings(
        full_success={scope: full_success(trials, scope, baseline) for scope in scopes},
        log_time={scope: log_time(trials, scope, baseline) for scope in scopes},
        equivalence={
            outcome: {
                scope: equivalences(results[outcome][scope], baseline, margins.get(outcome))
                for scope in scopes
            }
            for outcome in OUTCOMES
        },
        interaction=interaction,
        preference=preference(data.ranking, retargeters, seed=seed) if data.ranking else None,
    )


def interactions(data: StudyData, baseline: str) -> dict[Outcome, Interaction | Refused]:
    """Tests retargeter x task for every outcome.

    Args:
        baseline: retargeter that the others are compared with.
    """
    frames = outcome_frames(data, POOLED, baseline)
    # without retargeters that never or always succeed
    frames["success"] = without_separated(frames["success"]) or frames["success"]
    return {outcome: joint_interaction(outcome, frame) for outcome, frame in frames.items()}


Row = dict[str, Any]


def reading_rows(readings: Readings) -> list[Row]:
    """Returns the readings as table rows: ``reading``, ``where``, ``term``, and the figures.

    ``where`` is outcome, scope or field, joined by slashes. ``refused`` has the reason in rows
    without figures.
    """
    return [
        row
        for name, content in vars(readings).items()
        for row in _descend(name, (), plain(content))
    ]


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
"""Parts of a result that are in other tables."""
