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
from typing import Any, Final

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from scipy.optimize import brentq
from scipy.special import expit

from smooth_operator.errors import StudyError
from smooth_operator_study.data.rows import StudyData, questionnaires_table, trials_table
from smooth_operator_study.design.plan import Block, Plan
from smooth_operator_study.design.protocol import POINTS
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES

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
                raise StudyError(f"a standard deviation can't be negative or infinite: {spread}")

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
        success: condition -> probability of success.
        time_s: condition -> mean time [s].
        workload: condition -> mean workload [points].
        more: other fields of ``Assumptions``.
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
                    f"{what} is set for {name!r}; the study's conditions are "
                    f"{', '.join(conditions)}"
                )
        lacking = [name for name in conditions if name not in values]
        if lacking:
            raise StudyError(
                f"the expected {what} of {', '.join(lacking)} is missing; set it, such as "
                f"{lacking[0]}=VALUE; only the four methods of the paper have default values"
            )
        values_of[what] = {name: float(values[name]) for name in conditions}
    return Assumptions(**values_of, **more)  # type: ignore[arg-type]


def planned_data(plan: Plan) -> StudyData:
    """Makes the rows of a planned study without dropouts; all trials fail and all answers are
    missing."""
    blocks = list(plan.schedule())
    trials = [
        _place(block)
        | {"trial_in_block": k, "trial_global": block.trial_global(k), "score": 0.0, "time": np.nan}
        for block in blocks
        for k in range(1, block.task.trials + 1)
    ]
    filled = [
        _place(block) | {"point": POINTS.index(point) + 1} | dict.fromkeys(SCALE_NAMES, np.nan)
        for block in blocks
        for point in block.questionnaires.values()
    ]
    return StudyData(
        trials_table(pd.DataFrame(trials)),
        questionnaires_table(pd.DataFrame(filled)) if filled else None,
    )


def _place(block: Block) -> dict[str, Any]:
    return {
        "operator": block.operator,
        "task": block.task.name,
        "retargeter": block.condition.name,
        "block": block.number,
    }


def codes_of(names: Sequence[str], column: pd.Series) -> Int[np.ndarray, " n"]:
    """Index into ``names`` of each element of a column (n,)."""
    return np.asarray(pd.Categorical(column, names).codes, int)


_CORRELATION: Final = np.array([[1.0, -0.4, -0.3], [-0.4, 1.0, 0.2], [-0.3, 0.2, 1.0]])
"""Correlation of success, time and workload: more success goes with less time and workload."""
_SHORTEST_S: Final = 2.0
_STEP: Final = 5.0
_SCALES: Final = np.array([8.0, -6.0, 0.0, 2.0, 4.0, -8.0])
"""Distances of the six scales of NASA-TLX from their mean [points]."""


class Simulator:
    """Draws studies of one plan.

    Args:
        plan: plan of the study.
        truth: assumptions of the simulation.
    """

    def __init__(self, plan: Plan, truth: Assumptions) -> None:
        self._data, self._truth = planned_data(plan), truth
        trials, filled = self._data.trials, self._data.questionnaires
        protocol = plan.protocol
        conditions = sorted(protocol.condition_names, key=lambda x: (x != protocol.baseline, x))
        tasks = [task.name for task in protocol.tasks]
        self._operators, self._conditions = len(plan.codes), len(conditions)
        nothing = Spread(0.0, 0.0, 0.0)
        offsets = np.array([_three(truth.tasks.get(name, nothing)) for name in tasks])
        offsets -= offsets.mean(axis=0)
        spread = float(np.hypot(truth.operators.success, truth.interaction.success))
        logit = [_logit(truth.success[x], tuple(offsets[:, 0]), spread) for x in conditions]
        seconds = [truth.time_s[name] for name in conditions]
        points = [truth.workload[name] for name in conditions]
        practice = _three(truth.practice)

        def mean(table: pd.DataFrame, values: list[float], column: str, k: int) -> Any:
            index = table[column].to_numpy()
            condition, task = (codes_of(conditions, table.retargeter), codes_of(tasks, table.task))
            own = (codes_of(plan.codes, table.operator), condition, k)
            about = offsets[task, k] + practice[k] * (index - index.mean())
            return np.array(values)[condition] + about, own

        self._logit = mean(trials, logit, "trial_global", 0)
        self._time = mean(trials, seconds, "trial_global", 1)
        self._workload = None if filled is None else mean(filled, points, "index", 2)
        self._root = np.linalg.cholesky(_CORRELATION)

    def draw(self, rng: np.random.Generator) -> StudyData:
        """Draws one study."""
        truth, data = self._truth, self._data
        between = rng.standard_normal((self._operators, 3)) @ self._root.T
        own = rng.standard_normal((self._operators, self._conditions, 3))
        shift = (between * _three(truth.operators))[:, None] + own * _three(truth.interaction)
        logit, time = (mean + shift[where] for mean, where in (self._logit, self._time))
        success = rng.random(len(logit)) < expit(logit)
        time = time + truth.trials.time_s * rng.standard_normal(len(time))
        trials = data.trials.assign(
            score=success.astype(float), success=success, time=np.maximum(time, _SHORTEST_S)
        )
        if self._workload is None or data.questionnaires is None:
            return replace(data, trials=trials)
        workload = self._workload[0] + shift[self._workload[1]]
        workload = workload + truth.trials.workload * rng.standard_normal(len(workload))
        scales = workload[:, None] + _SCALES
        scales = scales + truth.scales * rng.standard_normal(scales.shape)
        answers = np.clip(_STEP * np.round(scales / _STEP), 0.0, 100.0)
        filled = questionnaires_table(
            {**data.questionnaires, **dict(zip(SCALE_NAMES, answers.T, strict=True))}
        )
        return replace(data, trials=trials, questionnaires=filled)


def _three(spread: Spread) -> Float[np.ndarray, " 3"]:
    return np.array([spread.success, spread.time_s, spread.workload])


@lru_cache(maxsize=256)
def _logit(probability: float, offsets: tuple[float, ...], spread: float) -> float:
    """Finds the log-odds with a mean probability over operators and tasks."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    weights = weights / weights.sum()
    about = spread * nodes[:, None] + np.array(offsets)

    def excess(logit: float) -> float:
        return float(weights @ expit(logit + about).mean(axis=1)) - probability

    return float(brentq(excess, -60.0, 60.0, xtol=1e-12))
