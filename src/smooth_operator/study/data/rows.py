"""Data of a study as columns: trials, questionnaires, metrics, ratings, flow of participants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Final, Literal, Self, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.study.design.protocol import Protocol


@dataclass(frozen=True)
class Withdrawal:
    """An operator who left the study.

    Attributes:
        keep: whether the data up to then may be analysed.
        reason: as the experimenter noted it.
        at: ISO date and time.
    """

    keep: bool
    reason: str = ""
    at: str = ""


@dataclass(frozen=True)
class Flow:
    """Participants from enrolment to analysis, as CONSORT counts them, and irregular events.

    Attributes:
        logged: whether a log of the study is known; without one, enrolled and started are those
            who have data, and the rest is unknown.
        planned: number of operators of the plan; None where unknown.
        enrolled: operators.
        started: those who have an event.
        completed: those who did all that was planned for them.
        withdrawn: operator -> how they left.
        replaces: operator -> the withdrawn one whose place they took.
        excluded: operator -> reason why their data are left out of the analysis.
        analysed: operators whose data are in the analysis.
        voids: retargeter -> trials that were declared void and repeated.
        undone: retargeter -> events that were taken back.
        amended: retargeter -> trials that were corrected later.
        pauses: of all operators.
        recalibrations: after the first calibration, of all operators.
        ended_early: blocks that were ended before their last trial.
    """

    logged: bool = False
    planned: int | None = None
    enrolled: tuple[str, ...] = ()
    started: tuple[str, ...] = ()
    completed: tuple[str, ...] = ()
    withdrawn: Mapping[str, Withdrawal] = field(default_factory=dict)
    replaces: Mapping[str, str] = field(default_factory=dict)
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
    """Columns of one length n."""

    operator: np.ndarray
    """Pseudonymous codes (n,) of str."""

    def __len__(self) -> int:
        return len(self.operator)

    def where(self, rows: Bool[np.ndarray, " n"]) -> Self:
        """Only some rows."""
        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(
            self, **{name: c[rows] for name, c in columns.items() if isinstance(c, np.ndarray)}
        )


@dataclass(frozen=True, eq=False)
class SecondRatings(_Table):
    """Scores that another rater gave, for instance from video.

    Attributes:
        task: names (n,) of str.
        block: which block of the operator's task, from 1 (n,).
        trial_in_block: from 1 (n,).
        score: 0, 0.5 or 1 (n,).
    """

    task: np.ndarray
    block: Int[np.ndarray, " n"]
    trial_in_block: Int[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]


ITEMS: Final = ("mental", "physical", "temporal", "performance", "effort", "frustration")
"""Scales of the NASA-TLX, each 0 to 100, higher is worse."""
PAIRS: Final = len(ITEMS) * (len(ITEMS) - 1) // 2
"""Pairs of scales: an operator says of each pair which added more to the workload."""
Workload: TypeAlias = Literal["raw", "weighted"]
"""``raw``: mean of the six answers (Hart 2006); ``weighted``: each as often as its scale was chosen
(Hart and Staveland 1988)."""
POINTS: Final = ("initial", "midpoint", "final")
"""When a questionnaire is filled in: after the first, middle and last trial of a block."""
SCORES: Final = (0.0, 0.5, 1.0)
"""Failure, marginal success, success."""
SUCCESS: Final = 0.5
"""Score from which a trial counts as a success."""


@dataclass(frozen=True, eq=False)
class Trials(_Table):
    """Trials, one a row.

    Attributes:
        task: names (n,) of str.
        retargeter: names (n,) of str.
        block: which block of the operator's task, from 1 (n,).
        trial_in_block: from 1 (n,).
        trial_global: count over all blocks of the operator's task, from 1 (n,).
        score: 0, 0.5 or 1 (n,).
        time: completion time [s], NaN where there is none (n,).
        duration: from the start to the score, of failures too [s], NaN where unknown (n,).
        line: of the rubric, "" where unknown (n,) of str.
    """

    task: np.ndarray
    retargeter: np.ndarray
    block: Int[np.ndarray, " n"]
    trial_in_block: Int[np.ndarray, " n"]
    trial_global: Int[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]
    duration: Float[np.ndarray, " n"] = field(default_factory=lambda: np.empty(0))
    line: np.ndarray = field(default_factory=lambda: np.empty(0, str))

    def __post_init__(self) -> None:
        for name, unknown in (("duration", np.nan), ("line", "")):
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.full(len(self), unknown))

    @property
    def success(self) -> np.ndarray:
        """Which trials have a score of 0.5 or 1 (n,)."""
        return np.asarray(self.score >= SUCCESS)


@dataclass(frozen=True, eq=False)
class Questionnaires(_Table):
    """NASA-TLX answers, one questionnaire a row.

    Attributes:
        task: names (n,) of str.
        retargeter: names (n,) of str.
        block: which block of the operator's task, from 1 (n,).
        point: 1, 2 or 3: initial, midpoint, final (n,).
        answers: of ``ITEMS``, 0 to 100, NaN where one was left out (n, 6).
        weights: how often each was chosen, 0 to 5, 15 together, NaN in rows without (n, 6); None
            if no row has them.
        kind: of the workload.
    """

    task: np.ndarray
    retargeter: np.ndarray
    block: Int[np.ndarray, " n"]
    point: Int[np.ndarray, " n"]
    answers: Float[np.ndarray, "n 6"]
    weights: Float[np.ndarray, "n 6"] | None = None
    kind: Workload = "raw"

    @property
    def workload(self) -> Float[np.ndarray, " n"]:
        """Raw or weighted TLX; NaN where an answer is missing, or the weights are (n,)."""
        if self.kind == "raw":
            return np.asarray(self.answers.mean(axis=1))
        if self.weights is None:
            return np.full(len(self), np.nan)
        return np.asarray((self.weights * self.answers).sum(axis=1) / PAIRS)

    @property
    def index(self) -> Int[np.ndarray, " n"]:
        """Count over all questionnaires of the operator's task, from 1 (n,)."""
        return np.asarray((self.block - 1) * len(POINTS) + self.point)


@dataclass(frozen=True, eq=False)
class SimulationMetrics(_Table):
    """Metrics of an operator's motion with a retargeter, from simulation.

    Attributes:
        retargeter: names (n,) of str.
        names: of the metrics (m,).
        values: NaN where one is missing (n, m).
    """

    retargeter: np.ndarray
    names: tuple[str, ...]
    values: Float[np.ndarray, "n m"]


@dataclass(frozen=True, eq=False)
class StudyData:
    """A study.

    Attributes:
        trials: all of them.
        questionnaires: None if none were given.
        metrics: from simulation; None if none were given.
        notes: what is odd in the data, but no reason to refuse them.
        sources: names of the files that they came from.
        plan: of the study; None where only tables are known.
        orders: rows of the plan's square; empty where unknown.
        flow: of the participants, from enrolment to analysis.
        ranking: operator -> retargeters, the preferred one first.
        second_ratings: scores by another rater; None if there are none.
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
    second_ratings: SecondRatings | None = None
