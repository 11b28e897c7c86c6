"""Reading: time to success with failures included.

Only successes have a completion time, so a retargeter that succeeds in easy trials only looks fast.
Here each trial is followed up to a limit: cumulative incidence of success (Aalen and Johansen
1978), and mean time without success, once with failures that never succeed, once with trials that
were given up as censored. Tasks have equal weights. Intervals are from a bootstrap over operators
whose samples are computed together: sample k holds row i ``weights[k, i]`` times.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.results import (
    Drawn,
    drawn,
    operator_weights,
    refusable,
)
from smooth_operator.study.data.rows import Trials

CENSORED: Final = 0
SUCCESS: Final = 1
COMPETING: Final = 2
EARLY: Final = 30.0
"""Time at which the share of successes is reported, besides the limit [s]."""
_DROPPED: Final = ("drop", "lost", "fell")
"""Words in the rubric line of a failure that ended the trial for good."""


@dataclass(frozen=True, eq=False)
class Incidence:
    """Steps of the cumulative incidence of success.

    Attributes:
        times: times at which rows ended, ascending [s] (u,).
        reached: share that has succeeded by each time, in each sample (k, u); NaN in a sample
            without rows.
    """

    times: Float[np.ndarray, " u"]
    reached: Float[np.ndarray, "k u"]

    def at(self, time: float) -> Float[np.ndarray, " k"]:
        """Share that has succeeded by a time [s], in each sample (k,)."""
        place = int(np.searchsorted(self.times, time, side="right"))
        if place:
            return self.reached[:, place - 1]
        return np.where(np.isnan(self.reached[:, -1]), np.nan, 0.0)

    def restricted_mean(self, limit: float) -> Float[np.ndarray, " k"]:
        """Mean time without success up to a limit [s], in each sample (k,).

        Rows that never succeed count with the limit.
        """
        inside = self.times < limit
        ends = np.concatenate([self.times[inside], [limit]])
        starts = np.concatenate([[0.0], self.times[inside]])
        waiting = 1 - np.column_stack([self.at(-1.0), self.reached[:, inside]])
        return np.asarray(waiting @ (ends - starts))


def incidence(
    times: Float[np.ndarray, " n"],
    events: Int[np.ndarray, " n"],
    weights: Float[np.ndarray, "k n"],
) -> Incidence:
    """Estimates the cumulative incidence of success.

    Args:
        times: end of each row, above 0 [s] (n,), n >= 1.
        events: ``SUCCESS``, ``COMPETING`` (never a success) or ``CENSORED`` (the outcome is
            unknown; after other events at the same time) (n,).
        weights: count of each row in each sample (k, n).
    """
    levels, place = np.unique(times, return_inverse=True)
    shape = (len(times), len(levels))
    member = np.zeros(shape)
    member[np.arange(len(times)), place] = 1
    total = weights @ member
    won = weights @ (member * (events == SUCCESS)[:, None])
    ended = weights @ (member * (events != CENSORED)[:, None])
    at_risk = np.cumsum(total[:, ::-1], axis=1)[:, ::-1]
    some = at_risk > 0
    hazard = np.divide(ended, at_risk, out=np.zeros_like(ended), where=some)
    won_hazard = np.divide(won, at_risk, out=np.zeros_like(won), where=some)
    left = np.cumprod(1 - hazard, axis=1)
    before = np.column_stack([np.ones(len(left)), left[:, :-1]])
    reached = np.cumsum(before * won_hazard, axis=1)
    reached[at_risk[:, 0] == 0] = np.nan
    return Incidence(levels, reached)


@dataclass(frozen=True)
class TimeToSuccess:
    """Time without success of each retargeter, and differences from the baseline.

    Attributes:
        limits: limit of the trials of each task [s].
        planned: whether the limits are the plan's; if not, each is the longest time of its task.
        restricted_mean: mean time without success up to the limit; failures count with it [s].
        difference: difference of ``restricted_mean`` from the baseline.
        by_30_s: share that has succeeded within 30 s.
        by_30_s_difference: difference of ``by_30_s`` from the baseline.
        by_limit: share that has succeeded at the limit.
        if_gone_on: restricted mean with failures without a drop censored at their duration, which
            assumes that giving up is independent of the outcome. Empty without durations.
        if_gone_on_difference: difference of ``if_gone_on`` from the baseline.
        operators: number of operators.
        left_out: number of successes without a time.
    """

    limits: Mapping[str, float]
    planned: bool
    restricted_mean: Mapping[str, Drawn]
    difference: Mapping[str, Drawn]
    by_30_s: Mapping[str, Drawn]
    by_30_s_difference: Mapping[str, Drawn]
    by_limit: Mapping[str, Drawn]
    if_gone_on: Mapping[str, Drawn]
    if_gone_on_difference: Mapping[str, Drawn]
    operators: int
    left_out: int


@refusable
def time_to_success(
    trials: Trials,
    tasks: tuple[str, ...],
    retargeters: tuple[str, ...],
    *,
    limits: Mapping[str, float | None] | None = None,
    seed: int = 11,
) -> TimeToSuccess:
    """Analyses the time to success of all trials up to the limits of their tasks.

    Args:
        trials: trials of the study.
        tasks: names of the tasks to include.
        retargeters: names of the retargeters, the baseline first.
        limits: time limits of the plan by task [s].
        seed: seed of the bootstrap.
    """
    planned = limits or {}
    usable = np.isin(trials.task, tasks) & ~(trials.success & np.isnan(trials.time))
    left_out = int(np.sum(np.isin(trials.task, tasks)) - np.sum(usable))
    operators, group = np.unique(trials.operator[usable], return_inverse=True)
    if len(operators) < 2:
        raise StudyError(f"{len(operators)} operator(s): at least two are needed")
    weights = operator_weights(len(operators), seed=seed)[:, group]
    task, retargeter = trials.task[usable], trials.retargeter[usable]
    ended, given_up = _ends(trials, usable)
    ends_of: dict[str, float] = {}
    for name in tasks:
        ends = ended[(task == name) & np.isfinite(ended)]
        limit = planned.get(name) or (float(ends.max()) if len(ends) else None)
        if limit is None:
            raise StudyError(f"no trial of task {name} has a time")
        ends_of[name] = float(limit)
    samples: dict[str, dict[str, list[np.ndarray]]] = {
        figure: {name: [] for name in retargeters} for figure in ("mean", "early", "late", "gone")
    }
    events = np.where(trials.success[usable], SUCCESS, COMPETING)
    for name in retargeters:
        for one in tasks:
            rows = (task == one) & (retargeter == name)
            if not rows.any():
                raise StudyError(f"no trials of {name} in task {one}")
            limit = ends_of[one]
            # A failure never succeeds, whenever it ended: without a duration its time is the limit.
            times = np.where(np.isfinite(ended[rows]), ended[rows], limit)
            curve = incidence(times, events[rows], weights[:, rows])
            samples["mean"][name].append(curve.restricted_mean(limit))
            samples["early"][name].append(curve.at(min(EARLY, limit)))
            samples["late"][name].append(curve.at(limit))
            if np.isfinite(ended[rows]).all():
                onward = np.where(given_up[rows], CENSORED, events[rows])
                censored = incidence(ended[rows], onward, weights[:, rows])
                samples["gone"][name].append(censored.restricted_mean(limit))
    if any(len(parts) < len(tasks) for parts in samples["gone"].values()):
        samples["gone"] = {}
    mean, early, late, gone = (
        {name: np.mean(parts, axis=0) for name, parts in by_name.items()}
        for by_name in samples.values()
    )
    return TimeToSuccess(
        limits=ends_of,
        planned=all(planned.get(name) for name in tasks),
        restricted_mean=_drawn(mean),
        difference=_differences(mean),
        by_30_s=_drawn(early),
        by_30_s_difference=_differences(early),
        by_limit=_drawn(late),
        if_gone_on=_drawn(gone),
        if_gone_on_difference=_differences(gone),
        operators=len(operators),
        left_out=left_out,
    )


def _ends(
    trials: Trials, usable: np.ndarray
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Ends of the trials [s], NaN if unknown; and whether each is a failure without a drop."""
    ended = np.where(trials.success, trials.time, trials.duration)[usable]
    lines = trials.line[usable]
    dropped = np.array([any(word in str(line).lower() for word in _DROPPED) for line in lines])
    return ended, ~trials.success[usable] & ~dropped


def _drawn(samples: Mapping[str, np.ndarray]) -> dict[str, Drawn]:
    return {name: drawn(values[0], values[1:]) for name, values in samples.items()}


def _differences(samples: Mapping[str, np.ndarray]) -> dict[str, Drawn]:
    names = list(samples)
    return _drawn({name: samples[name] - samples[names[0]] for name in names[1:]})
