"""Simulated studies: assumptions, rows of the plan, and the data of one study under them.

The defaults of the conditions are the means in the paper. The defaults of the differences between
operators, trials and tasks are assumptions that give results similar to the paper's (operators
differ by about 13 points of success, 4 s and 10 points of workload). Replace them by the results of
a pilot study.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import brentq
from scipy.special import expit

from smooth_operator.errors import StudyError
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.protocol import POINTS

PAPER_SUCCESS: Final = {"sbr": 0.541, "dexpilot": 0.440, "geort": 0.266, "hybrid": 0.521}
"""Probability of a score of 0.5 or 1."""
PAPER_TIME_S: Final = {"sbr": 29.7, "dexpilot": 23.3, "geort": 33.3, "hybrid": 21.6}
"""Mean time of successful trials [s]."""
PAPER_WORKLOAD: Final = {"sbr": 36.4, "dexpilot": 44.0, "geort": 56.4, "hybrid": 38.4}
"""Mean raw NASA-TLX."""


@dataclass(frozen=True)
class Spread:
    """One number for each outcome.

    Attributes:
        success: number on the logit scale.
        time_s: time [s].
        workload: points of NASA-TLX.
    """

    success: float
    time_s: float
    workload: float


@dataclass(frozen=True)
class Assumptions:
    """Assumptions of a simulated study.

    Attributes:
        success: condition -> probability of success, averaged over operators and tasks.
        time_s: condition -> mean time of successful trials [s].
        workload: condition -> mean raw NASA-TLX, 0 to 100.
        operators: standard deviation between operators.
        interaction: standard deviation of an operator's preference for single conditions; people
            have preferences, so it is not zero.
        trials: standard deviation between trials of an operator. That of success is in its
            probability; that of workload is common to the six scales.
        scales: further standard deviation of each scale of NASA-TLX [points].
        practice: change per trial, or per questionnaire for workload, centred.
        tasks: task -> difference from the mean of the tasks.
    """

    success: Mapping[str, float]
    time_s: Mapping[str, float]
    workload: Mapping[str, float]
    operators: Spread = Spread(0.6, 4.0, 10.0)
    interaction: Spread = Spread(0.3, 2.0, 5.0)
    trials: Spread = Spread(0.0, 7.0, 6.0)
    scales: float = 8.0
    practice: Spread = Spread(0.012, -0.06, -0.4)
    tasks: Mapping[str, Spread] = field(
        default_factory=lambda: {
            "A": Spread(0.55, -5.0, -4.0),
            "B": Spread(-0.1, 0.5, 0.0),
            "C": Spread(-0.45, 4.5, 4.0),
        }
    )

    def __post_init__(self) -> None:
        for name, p in self.success.items():
            if not 0.005 <= p <= 0.995:
                raise StudyError(
                    f"success of {name}: expected a probability from 0.005 to 0.995, not {p}"
                )
        for name, seconds in self.time_s.items():
            if not (math.isfinite(seconds) and seconds > 0):
                raise StudyError(f"time of {name}: expected seconds above 0, not {seconds}")
        for name, points in self.workload.items():
            if not 0 <= points <= 100:
                raise StudyError(f"workload of {name}: expected 0 to 100 points, not {points}")
        for spread in (self.operators, self.interaction, self.trials):
            if not all(0 <= x < 1e4 for x in (spread.success, spread.time_s, spread.workload)):
                raise StudyError(f"a standard deviation can't be negative or endless: {spread}")

    def null(self, baseline: str) -> Assumptions:
        """Returns the assumptions with every condition as good as the baseline."""
        return replace(
            self,
            success=dict.fromkeys(self.success, self.success[baseline]),
            time_s=dict.fromkeys(self.time_s, self.time_s[baseline]),
            workload=dict.fromkeys(self.workload, self.workload[baseline]),
        )


def assumptions_for(
    conditions: Sequence[str],
    *,
    success: Mapping[str, float] | None = None,
    time_s: Mapping[str, float] | None = None,
    workload: Mapping[str, float] | None = None,
    **more: object,
) -> Assumptions:
    """Makes assumptions for all conditions, with the paper's values as defaults.

    Args:
        conditions: names of the study's conditions.
        success: condition -> probability of success.
        time_s: condition -> mean time [s].
        workload: condition -> mean workload [points].
        more: other fields of ``Assumptions``.

    Raises:
        StudyError: a value is for an unknown condition, or a condition has no value.
    """
    values_of: dict[str, Mapping[str, float]] = {}
    for what, overrides, published in (
        ("success", success, PAPER_SUCCESS),
        ("time_s", time_s, PAPER_TIME_S),
        ("workload", workload, PAPER_WORKLOAD),
    ):
        values = {**published, **(overrides or {})}
        for name in overrides or {}:
            if name not in conditions:
                raise StudyError(
                    f"{what} is given for {name!r}; the study's conditions are "
                    f"{', '.join(conditions)}"
                )
        lacking = [name for name in conditions if name not in values]
        if lacking:
            raise StudyError(
                f"what {what} of {', '.join(lacking)} is to be expected? Give it, as "
                f"{lacking[0]}=VALUE; only the paper's four methods have their own values"
            )
        values_of[what] = {name: float(values[name]) for name in conditions}
    return Assumptions(**values_of, **more)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Rows:
    """Trials or questionnaires as columns of numbers.

    Attributes:
        operator: index into the codes (n,).
        task: index into the tasks (n,).
        condition: index into the conditions, the baseline first (n,).
        index: number in the operator's task, from 1 (n,).
    """

    operator: Int[np.ndarray, " n"]
    task: Int[np.ndarray, " n"]
    condition: Int[np.ndarray, " n"]
    index: Int[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Layout:
    """Rows of a planned study without dropouts.

    Attributes:
        conditions: names of the conditions, the baseline first.
        tasks: names of the tasks.
        operators: codes of the operators.
        trials: rows of trials.
        questionnaires: rows of questionnaires; the index counts three for each block.
    """

    conditions: tuple[str, ...]
    tasks: tuple[str, ...]
    operators: tuple[str, ...]
    trials: Rows
    questionnaires: Rows


def layout(plan: Plan) -> Layout:
    """Makes the rows of a plan."""
    protocol = plan.protocol
    baseline = protocol.baseline
    conditions = (baseline, *sorted(set(protocol.condition_names) - {baseline}))
    tasks = tuple(task.name for task in protocol.tasks)
    trials: list[tuple[int, int, int, int]] = []
    questionnaires: list[tuple[int, int, int, int]] = []
    for block in plan.schedule():
        key = (
            plan.codes.index(block.operator),
            tasks.index(block.task.name),
            conditions.index(block.condition.name),
        )
        trials += [(*key, block.trial_global(k)) for k in range(1, block.task.trials + 1)]
        questionnaires += [
            (*key, (block.number - 1) * len(POINTS) + POINTS.index(point) + 1)
            for point in block.questionnaires.values()
        ]
    return Layout(conditions, tasks, plan.codes, _rows(trials), _rows(questionnaires))


def _rows(rows: list[tuple[int, int, int, int]]) -> Rows:
    table = np.array(rows, int).reshape(-1, 4)
    return Rows(table[:, 0], table[:, 1], table[:, 2], table[:, 3])


_CORRELATION: Final = np.array([[1.0, -0.4, -0.3], [-0.4, 1.0, 0.2], [-0.3, 0.2, 1.0]])
"""Correlation of success, time and workload: more success goes with less time and workload."""
_SHORTEST_S: Final = 2.0
_STEP: Final = 5.0
_SCALES: Final = np.array([8.0, -6.0, 0.0, 2.0, 4.0, -8.0])
"""Distances of the six scales of NASA-TLX from their mean [points]."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """Data of a simulated study.

    Attributes:
        success: success of each trial (n,).
        time_s: time of each trial [s]; valid for successful trials only (n,).
        workload: raw NASA-TLX of each questionnaire (m,).
    """

    success: Bool[np.ndarray, " n"]
    time_s: Float[np.ndarray, " n"]
    workload: Float[np.ndarray, " m"]


class Simulator:
    """Draws studies of one layout.

    Args:
        layout: rows of the study.
        truth: assumptions of the simulation.
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
        seconds = np.array([truth.time_s[name] for name in layout.conditions])
        points = np.array([truth.workload[name] for name in layout.conditions])
        rows = (layout.trials, layout.trials, layout.questionnaires)
        self._mean_logit, self._mean_time, self._mean_workload = (
            values[own.condition] + offsets[own.task, k] + practice * _centred(own)
            for k, (values, own, practice) in enumerate(
                zip((self._logit, seconds, points), rows, _three(truth.practice), strict=True)
            )
        )
        self._root = np.linalg.cholesky(_CORRELATION)

    def draw(self, rng: np.random.Generator) -> Simulated:
        """Draws one study."""
        truth, layout = self._truth, self._layout
        operators, conditions = len(layout.operators), len(layout.conditions)
        trials, questionnaires = layout.trials, layout.questionnaires
        between = rng.standard_normal((operators, 3)) @ self._root.T * _three(truth.operators)
        own = rng.standard_normal((operators, conditions, 3)) * _three(truth.interaction)
        shift = between[:, None] + own
        logit = self._mean_logit + shift[trials.operator, trials.condition, 0]
        success = rng.random(len(logit)) < expit(logit)
        time = self._mean_time + shift[trials.operator, trials.condition, 1]
        time = time + truth.trials.time_s * rng.standard_normal(len(time))
        workload = self._mean_workload + shift[questionnaires.operator, questionnaires.condition, 2]
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
    """Finds the log-odds with a mean probability over operators and tasks."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    weights = weights / weights.sum()
    about = spread * nodes[:, None] + np.array(offsets)

    def excess(logit: float) -> float:
        return float(weights @ expit(logit + about).mean(axis=1)) - probability

    return float(brentq(excess, -60.0, 60.0, xtol=1e-12))


def _logit_of(probability: float, offsets: tuple[float, ...], truth: Assumptions) -> float:
    spread = float(np.hypot(truth.operators.success, truth.interaction.success))
    return _logit(probability, offsets, spread)
