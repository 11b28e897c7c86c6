"""All further readings of a study, each with its figures or the reason why it has none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from smooth_operator.study.analysis.frame import Frame
from smooth_operator.study.analysis.outcome_frames import (
    success_frame,
    time_frame,
    tlx_frame,
)
from smooth_operator.study.analysis.readings.covariates import (
    Covariate,
    covariate,
    usable_fields,
)
from smooth_operator.study.analysis.readings.equivalence import Equivalence, equivalences
from smooth_operator.study.analysis.readings.interaction import Interaction, interaction
from smooth_operator.study.analysis.readings.log_time import LogTime, log_time
from smooth_operator.study.analysis.readings.order_effects import (
    FIRST,
    Balance,
    OrderEffects,
    balance,
    blocks_of,
    order_effects,
)
from smooth_operator.study.analysis.readings.parts import Refused
from smooth_operator.study.analysis.readings.preference import Preference, preference
from smooth_operator.study.analysis.readings.rater_agreement import Agreement, agreement
from smooth_operator.study.analysis.readings.score_levels import (
    OrdinalReading,
    full_success,
    ordinal,
)
from smooth_operator.study.analysis.readings.time_to_success import (
    TimeToSuccess,
    time_to_success,
)
from smooth_operator.study.analysis.results import OUTCOMES, POOLED, Outcome, ScopeResult
from smooth_operator.study.analysis.separated import split
from smooth_operator.study.data.rows import Questionnaires, StudyData, Trials


@dataclass(frozen=True, eq=False)
class Readings:
    """What else the data say. All but ``equivalence`` are sensitivity or secondary readings.

    Attributes:
        full_success: by scope, success as a score of 1.
        ordinal: by scope, proportional odds over the scores.
        time_to_success: by scope, with failures.
        log_time: by scope.
        equivalence: by outcome, scope and pair.
        interaction: by outcome, retargeter x task.
        balance: realised order of the blocks.
        order: by outcome, period and carry-over, all tasks together.
        covariates: by field of the forms and outcome.
        second_rater: None without second ratings.
        preference: None without rankings.
    """

    full_success: Mapping[str, ScopeResult]
    ordinal: Mapping[str, OrdinalReading | Refused]
    time_to_success: Mapping[str, TimeToSuccess | Refused]
    log_time: Mapping[str, LogTime | Refused]
    equivalence: Mapping[Outcome, Mapping[str, Mapping[str, Equivalence]]]
    interaction: Mapping[Outcome, Interaction | Refused]
    balance: Balance
    order: Mapping[Outcome, OrderEffects | Refused]
    covariates: Mapping[str, Mapping[Outcome, Covariate | Refused]] = field(default_factory=dict)
    second_rater: Agreement | Refused | None = None
    preference: Preference | Refused | None = None


Results = Mapping[Outcome, Mapping[str, ScopeResult]]
"""Outcome and scope -> result in mode small-sample."""


def read_further(
    data: StudyData,
    retargeters: tuple[str, ...],
    scopes: tuple[str, ...],
    results: Results,
    depending: Mapping[Outcome, Interaction | Refused],
    *,
    seed: int = 11,
) -> Readings:
    """Computes all readings.

    Args:
        data: the study.
        retargeters: the baseline first.
        scopes: ``pooled`` and the tasks.
        results: those of mode small-sample.
        depending: retargeter x task, of ``interactions``.
        seed: of bootstraps and permutations.
    """
    trials, baseline, tasks = data.trials, retargeters[0], scopes[1:]
    limits = {task.name: task.time_limit_s for task in data.plan.tasks} if data.plan else {}
    margins = data.plan.margins if data.plan else {}
    frames = _frames(data, baseline)
    rankings = {who: tuple(order) for who, order in data.ranking.items()}
    return Readings(
        full_success={scope: full_success(trials, scope, baseline) for scope in scopes},
        ordinal={scope: ordinal(trials, scope, baseline) for scope in scopes},
        time_to_success={
            scope: time_to_success(
                trials, tasks if scope == POOLED else (scope,), retargeters,
                limits=limits, seed=seed,
            )
            for scope in scopes
        },
        log_time={
            scope: log_time(
                time_frame(trials, scope, baseline),
                results["time"][scope].diagnostics.get("skewness"),
            )
            for scope in scopes
        },
        equivalence={
            outcome: {
                scope: equivalences(results[outcome][scope], baseline, margins.get(outcome))
                for scope in scopes
            }
            for outcome in OUTCOMES
        },
        interaction=depending,
        balance=balance(blocks_of(trials), retargeters),
        order=_order(data, frames),
        covariates={
            name: {
                outcome: covariate(outcome, frame, data.forms, name)
                for outcome, frame in frames.items()
            }
            for name in usable_fields(data.forms, data.plan.forms if data.plan else ())
        },
        second_rater=_second_rater(data, seed),
        preference=preference(rankings, retargeters, seed=seed) if rankings else None,
    )  # fmt: skip


def interactions(data: StudyData, baseline: str) -> dict[Outcome, Interaction | Refused]:
    """Retargeter x task of every outcome.

    Args:
        data: the study.
        baseline: the retargeter that others are compared with.
    """
    frames = _frames(data, baseline)
    return {outcome: interaction(outcome, frame) for outcome, frame in frames.items()}


def _frames(data: StudyData, baseline: str) -> dict[Outcome, Frame]:
    success = success_frame(data.trials, POOLED, baseline)
    found: dict[Outcome, Frame] = {
        "success": split(success)[0] or success,  # without those that never or always succeed
        "time": time_frame(data.trials, POOLED, baseline),
    }
    if data.questionnaires is not None:
        found["tlx"] = tlx_frame(data.questionnaires, POOLED, baseline)
    return found


def _order(
    data: StudyData, frames: Mapping[Outcome, Frame]
) -> dict[Outcome, OrderEffects | Refused]:
    blocks = blocks_of(data.trials)
    found: dict[Outcome, OrderEffects | Refused] = {}
    for outcome, frame in frames.items():
        table: Trials | Questionnaires = data.trials
        rows, inside = np.isin(table.retargeter, frame.retargeters), data.trials.trial_in_block
        if outcome == "time":
            rows = data.trials.success & np.isfinite(data.trials.time)
        elif outcome == "tlx" and data.questionnaires is not None:
            table = data.questionnaires
            rows, inside = np.isfinite(table.workload), data.questionnaires.point
        before = np.array(
            [
                blocks.get((str(who), str(task), int(block) - 1), FIRST)
                for who, task, block in zip(
                    table.operator[rows], table.task[rows], table.block[rows], strict=True
                )
            ]
        )
        found[outcome] = order_effects(outcome, frame, table.block[rows], before, inside[rows])
    return found


def _second_rater(data: StudyData, seed: int) -> Agreement | Refused | None:
    second = data.second_ratings
    if second is None:
        return None
    given = {
        (str(who), str(task), int(block), int(trial)): float(score)
        for who, task, block, trial, score in zip(
            second.operator, second.task, second.block, second.trial_in_block, second.score,
            strict=True,
        )
    }  # fmt: skip
    trials = data.trials
    scores = [
        given.get((str(who), str(task), int(block), int(trial)), np.nan)
        for who, task, block, trial in zip(
            trials.operator, trials.task, trials.block, trials.trial_in_block, strict=True
        )
    ]
    return agreement(trials.score, np.array(scores), trials.operator, seed=seed)
