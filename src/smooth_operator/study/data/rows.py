"""What a study measured, as columns of equal length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int

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
class Trials:
    """Trials, one a row.

    Attributes:
        operator: pseudonymous codes (n,) of str.
        task: names (n,) of str.
        retargeter: names (n,) of str.
        block: which block of the operator's task, from 1 (n,).
        trial_in_block: from 1 (n,).
        trial_global: count over all blocks of the operator's task, from 1 (n,).
        score: 0, 0.5 or 1 (n,).
        time: completion time [s], NaN where there is none (n,).
    """

    operator: np.ndarray
    task: np.ndarray
    retargeter: np.ndarray
    block: Int[np.ndarray, " n"]
    trial_in_block: Int[np.ndarray, " n"]
    trial_global: Int[np.ndarray, " n"]
    score: Float[np.ndarray, " n"]
    time: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.score)

    @property
    def success(self) -> np.ndarray:
        """Which trials have a score of 0.5 or 1 (n,)."""
        return np.asarray(self.score >= SUCCESS)


@dataclass(frozen=True, eq=False)
class Questionnaires:
    """NASA-TLX answers, one questionnaire a row.

    Attributes:
        operator: pseudonymous codes (n,) of str.
        task: names (n,) of str.
        retargeter: names (n,) of str.
        block: which block of the operator's task, from 1 (n,).
        point: 1, 2 or 3: initial, midpoint, final (n,).
        answers: of ``ITEMS``, 0 to 100, NaN where one was left out (n, 6).
        weights: how often each was chosen, 0 to 5, 15 together, NaN in rows without (n, 6); None
            if no row has them.
        kind: of the workload.
    """

    operator: np.ndarray
    task: np.ndarray
    retargeter: np.ndarray
    block: Int[np.ndarray, " n"]
    point: Int[np.ndarray, " n"]
    answers: Float[np.ndarray, "n 6"]
    weights: Float[np.ndarray, "n 6"] | None = None
    kind: Workload = "raw"

    def __len__(self) -> int:
        return len(self.point)

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
class SimulationMetrics:
    """Metrics of an operator's motion with a retargeter, from simulation.

    Attributes:
        operator: pseudonymous codes (n,) of str.
        retargeter: names (n,) of str.
        names: of the metrics (m,).
        values: NaN where one is missing (n, m).
    """

    operator: np.ndarray
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
    """

    trials: Trials
    questionnaires: Questionnaires | None = None
    metrics: SimulationMetrics | None = None
    notes: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
