"""Data of a study as columns: trials, questionnaires, metrics, flow of participants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Final, Self

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.study.design.protocol import Protocol


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


@dataclass(frozen=True, eq=False)
class _Table:
    """Columns of equal length n."""

    operator: np.ndarray
    """Pseudonyms (n,) of str."""

    def __len__(self) -> int:
        return len(self.operator)

    def where(self, rows: Bool[np.ndarray, " n"]) -> Self:
        """Selects rows."""
        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(
            self, **{name: c[rows] for name, c in columns.items() if isinstance(c, np.ndarray)}
        )


ITEMS: Final = ("mental", "physical", "temporal", "performance", "effort", "frustration")
"""Scales of the NASA-TLX, each 0 to 100, higher is worse."""
POINTS: Final = ("initial", "midpoint", "final")
"""Times of questionnaires: after the first, middle and last trial of a block."""
SCORES: Final = (0.0, 0.5, 1.0)
"""Failure, marginal success, success."""
SUCCESS: Final = 0.5
"""Smallest score of a successful trial."""


@dataclass(frozen=True, eq=False)
class Trials(_Table):
    """Trials, one a row.

    Attributes:
        task: names of tasks (n,) of str.
        retargeter: names of retargeters (n,) of str.
        block: number of the block in the operator's task, from 1 (n,).
        trial_in_block: number of the trial in its block, from 1 (n,).
        trial_global: number of the trial in the operator's task, from 1 (n,).
        score: 0, 0.5 or 1 (n,).
        time: completion time [s], NaN where there is none (n,).
    """

    task: np.ndarray
    retargeter: np.ndarray
    block: Int[np.ndarray, " n"]
    trial_in_block: Int[np.ndarray, " n"]
    trial_global: Int[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]

    @property
    def success(self) -> np.ndarray:
        """True for trials with a score of 0.5 or 1 (n,)."""
        return np.asarray(self.score >= SUCCESS)


@dataclass(frozen=True, eq=False)
class Questionnaires(_Table):
    """NASA-TLX answers, one questionnaire a row.

    Attributes:
        task: names of tasks (n,) of str.
        retargeter: names of retargeters (n,) of str.
        block: number of the block in the operator's task, from 1 (n,).
        point: 1, 2 or 3: initial, midpoint, final (n,).
        answers: answers to ``ITEMS``, 0 to 100, NaN where one is missing (n, 6).
    """

    task: np.ndarray
    retargeter: np.ndarray
    block: Int[np.ndarray, " n"]
    point: Int[np.ndarray, " n"]
    answers: Float[np.ndarray, "n 6"]

    @property
    def workload(self) -> Float[np.ndarray, " n"]:
        """Raw TLX, the mean of the six answers (Hart 2006); NaN where one is missing (n,)."""
        return np.asarray(self.answers.mean(axis=1))

    @property
    def index(self) -> Int[np.ndarray, " n"]:
        """Number of the questionnaire in the operator's task, from 1 (n,)."""
        return np.asarray((self.block - 1) * len(POINTS) + self.point)


@dataclass(frozen=True, eq=False)
class SimulationMetrics(_Table):
    """Metrics of an operator's motion with a retargeter, from simulation.

    Attributes:
        retargeter: names of retargeters (n,) of str.
        names: names of the metrics (m,).
        values: values of the metrics, NaN where one is missing (n, m).
    """

    retargeter: np.ndarray
    names: tuple[str, ...]
    values: Float[np.ndarray, "n m"]


@dataclass(frozen=True, eq=False)
class StudyData:
    """Data of a study.

    Attributes:
        trials: all trials.
        questionnaires: all questionnaires; None without any.
        metrics: metrics from simulation; None without any.
        notes: oddities of the data that are no reason to refuse them.
        sources: names of the files.
        plan: protocol of the study; None if only tables are known.
        orders: orders of the conditions in the plan; empty if unknown.
        flow: flow of participants.
        ranking: operator -> retargeters, the best first.
    """

    trials: Trials
    questionnaires: Questionnaires | None = None
    metrics: SimulationMetrics | None = None
    notes: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    plan: Protocol | None = None
    orders: tuple[tuple[str, ...], ...] = ()
    flow: Flow = field(default_factory=Flow)
    ranking: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
