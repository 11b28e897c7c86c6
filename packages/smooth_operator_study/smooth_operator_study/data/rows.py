"""Data of a study: tables of trials, questionnaires and metrics, and the flow of participants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import pandas as pd

from smooth_operator_study.design.protocol import POINTS, Outcome, Protocol
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES


@dataclass(frozen=True)
class Withdrawal:
    """Withdrawal of an operator.

    Attributes:
        keep: whether the data so far may be analysed.
        reason: reason that the experimenter noted.
        at: ISO date and time.
    """

    keep: bool
    reason: str = ""
    at: str = ""


@dataclass(frozen=True)
class Flow:
    """Flow of participants from enrolment to analysis (CONSORT), and numbers of irregular events.

    Attributes:
        logged: whether the log of the study is known. Without it, operators with data count as
            enrolled and started, and the rest is unknown.
        planned: number of operators of the plan; None if unknown.
        enrolled: operators who were enrolled.
        started: operators who started a block.
        completed: operators who did all of their plan.
        withdrawn: operator -> withdrawal.
        excluded: operator -> reason why their data are left out of the analysis.
        analysed: operators whose data are in the analysis.
        voids: retargeter -> number of trials that were declared void and repeated.
        undone: retargeter -> number of events that were undone.
        amended: retargeter -> number of trials that were corrected later.
        pauses: number of pauses.
        recalibrations: number of calibrations after the first ones.
        ended_early: number of blocks that were ended before their last trial.
    """

    logged: bool = False
    planned: int | None = None
    enrolled: tuple[str, ...] = ()
    started: tuple[str, ...] = ()
    completed: tuple[str, ...] = ()
    withdrawn: Mapping[str, Withdrawal] = field(default_factory=dict)
    excluded: Mapping[str, str] = field(default_factory=dict)
    analysed: tuple[str, ...] = ()
    voids: Mapping[str, int] = field(default_factory=dict)
    undone: Mapping[str, int] = field(default_factory=dict)
    amended: Mapping[str, int] = field(default_factory=dict)
    pauses: int = 0
    recalibrations: int = 0
    ended_early: int = 0


SUCCESS: Final = 0.5
"""Smallest score of a successful trial."""


def trials_table(columns: Mapping[str, Any]) -> pd.DataFrame:
    """Makes the table of trials, with one row per trial.

    Args:
        columns: ``operator``, ``task`` and ``retargeter``, names; ``block``, ``trial_in_block`` and
            ``trial_global``, the number of the trial in the operator's task, from 1; ``score``, 0,
            0.5 or 1; ``time``, completion time [s], NaN where there is none.

    Returns:
        The columns, and ``success``, True for a score of 0.5 or 1.
    """
    return pd.DataFrame(columns).assign(success=lambda table: table.score >= SUCCESS)


def questionnaires_table(columns: Mapping[str, Any]) -> pd.DataFrame:
    """Makes the table of NASA-TLX answers, with one row per questionnaire.

    Args:
        columns: ``operator``, ``task`` and ``retargeter``, names; ``block``, from 1; ``point``, 1,
            2 or 3 for initial, midpoint and final; ``SCALE_NAMES``, answers of 0 to 100, NaN where
            one is missing.

    Returns:
        The columns; ``workload``, the mean of the six answers (raw TLX, Hart 2006), NaN where one
        is missing; ``index``, the number of the questionnaire in the operator's task, from 1.
    """
    table = pd.DataFrame(columns)
    return table.assign(
        workload=table[[*SCALE_NAMES]].to_numpy().mean(axis=1),
        index=(table.block - 1) * len(POINTS) + table.point,
    )


def successes(trials: pd.DataFrame) -> pd.DataFrame:
    """Returns all trials; ``value`` is 1 for a score of 0.5 or 1."""
    return trials.assign(value=trials.success.astype(float))


def times(trials: pd.DataFrame) -> pd.DataFrame:
    """Returns the successful trials with a time; ``value`` is the time [s]."""
    return trials[trials.success & trials.time.notna()].assign(value=lambda table: table.time)


def answers(questionnaires: pd.DataFrame, scale: str = "workload") -> pd.DataFrame:
    """Returns the questionnaires with an answer; ``value`` is the workload, or one scale."""
    return questionnaires.assign(value=questionnaires[scale]).dropna(subset="value")


@dataclass(frozen=True, eq=False)
class StudyData:
    """Data of a study.

    Attributes:
        trials: all trials, see ``trials_table``.
        questionnaires: all questionnaires, see ``questionnaires_table``; None without any.
        metrics: metrics of an operator's motion with a retargeter, from simulation: ``operator``,
            ``retargeter`` and a column for each metric, NaN where one is missing; None without any.
        notes: oddities in the data that are not a reason to refuse them.
        sources: names of the files.
        plan: protocol of the study; None if only tables are known.
        orders: orders of the conditions in the plan; empty if unknown.
        flow: flow of participants.
        ranking: operator -> retargeters, the best first.
    """

    trials: pd.DataFrame
    questionnaires: pd.DataFrame | None = None
    metrics: pd.DataFrame | None = None
    notes: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    plan: Protocol | None = None
    orders: tuple[tuple[str, ...], ...] = ()
    flow: Flow = field(default_factory=Flow)
    ranking: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def outcomes(self) -> dict[Outcome, pd.DataFrame]:
        """Returns the rows of each outcome, with its ``value``."""
        rows: dict[Outcome, pd.DataFrame] = {
            "success": successes(self.trials),
            "time": times(self.trials),
        }
        if self.questionnaires is not None:
            rows["tlx"] = answers(self.questionnaires)
        return rows
