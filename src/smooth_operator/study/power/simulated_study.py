"""One simulated study: the data of operators under the assumptions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import brentq
from scipy.special import expit

from smooth_operator.study.power.assumptions import Assumptions, Spread
from smooth_operator.study.power.study_rows import Layout, Rows

_CORRELATION: Final = np.array([[1.0, -0.4, -0.3], [-0.4, 1.0, 0.2], [-0.3, 0.2, 1.0]])
"""Of an operator's success, time and workload: who succeeds more is quicker and less strained."""
_SHORTEST_S: Final = 2.0
_STEP: Final = 5.0
_SCALES: Final = np.array([8.0, -6.0, 0.0, 2.0, 4.0, -8.0])
"""How the six scales of NASA-TLX lie about their mean [points]."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """What came out.

    Attributes:
        success: of each trial (n,).
        time_s: of each trial [s]; means something where it succeeded (n,).
        workload: raw NASA-TLX of each questionnaire (m,).
    """

    success: Bool[np.ndarray, " n"]
    time_s: Float[np.ndarray, " n"]
    workload: Float[np.ndarray, " m"]


class Simulator:
    """Draws studies of one layout.

    Args:
        layout: rows of the study.
        truth: what is assumed.
    """

    def __init__(self, layout: Layout, truth: Assumptions) -> None:
        self._layout, self._truth = layout, truth
        offsets = _task_offsets(layout, truth)
        self._logit = np.array(
            [
                _logit_of(truth.success[name], tuple(offsets[:, 0]), truth)
                for name in layout.conditions
            ]
        )
        trials, asked = layout.trials, layout.questionnaires
        seconds = np.array([truth.time_s[name] for name in layout.conditions])
        points = np.array([truth.workload[name] for name in layout.conditions])
        self._mean_logit = (
            self._logit[trials.condition]
            + offsets[trials.task, 0]
            + truth.practice.success * _centred(trials)
        )
        self._mean_time = (
            seconds[trials.condition]
            + offsets[trials.task, 1]
            + truth.practice.time_s * _centred(trials)
        )
        self._mean_workload = (
            points[asked.condition]
            + offsets[asked.task, 2]
            + truth.practice.workload * _centred(asked)
        )
        self._root = np.linalg.cholesky(_CORRELATION)

    def draw(self, rng: np.random.Generator) -> Simulated:
        """One study."""
        truth, layout = self._truth, self._layout
        operators, conditions = len(layout.operators), len(layout.conditions)
        trials, asked = layout.trials, layout.questionnaires
        between = rng.standard_normal((operators, 3)) @ self._root.T * _three(truth.operators)
        own = rng.standard_normal((operators, conditions, 3)) * _three(truth.interaction)
        shift = between[:, None] + own
        logit = self._mean_logit + shift[trials.operator, trials.condition, 0]
        success = rng.random(len(logit)) < expit(logit)
        time = self._mean_time + shift[trials.operator, trials.condition, 1]
        time = time + truth.trials.time_s * rng.standard_normal(len(time))
        workload = self._mean_workload + shift[asked.operator, asked.condition, 2]
        workload = workload + truth.trials.workload * rng.standard_normal(len(workload))
        scales = workload[:, None] + _SCALES
        scales = scales + truth.scales * rng.standard_normal(scales.shape)
        answered = np.clip(_STEP * np.round(scales / _STEP), 0.0, 100.0)
        return Simulated(success, np.maximum(time, _SHORTEST_S), answered.mean(axis=1))


def _three(spread: Spread) -> Float[np.ndarray, " 3"]:
    return np.array([spread.success, spread.time_s, spread.workload])


def _centred(rows: Rows) -> Float[np.ndarray, " n"]:
    return rows.index - rows.index.mean() if len(rows.index) else rows.index.astype(float)


def _task_offsets(layout: Layout, truth: Assumptions) -> Float[np.ndarray, "k 3"]:
    none = Spread(0.0, 0.0, 0.0)
    table = np.array([_three(truth.tasks.get(name, none)) for name in layout.tasks])
    return np.asarray(table - table.mean(axis=0))


@lru_cache(maxsize=256)
def _logit(probability: float, offsets: tuple[float, ...], spread: float) -> float:
    """Log-odds whose probability, averaged over operators and tasks, is a given one."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    weights = weights / weights.sum()
    about = spread * nodes[:, None] + np.array(offsets)

    def excess(logit: float) -> float:
        return float(weights @ expit(logit + about).mean(axis=1)) - probability

    return float(brentq(excess, -60.0, 60.0, xtol=1e-12))


def _logit_of(probability: float, offsets: tuple[float, ...], truth: Assumptions) -> float:
    spread = float(np.hypot(truth.operators.success, truth.interaction.success))
    return _logit(probability, offsets, spread)
