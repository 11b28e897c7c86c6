"""How much operators differ: the mean of each operator, and their distribution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from smooth_operator.study.analysis.results import OUTCOMES, Outcome
from smooth_operator.study.data.rows import StudyData

_SHOWN: Final = 4


@dataclass(frozen=True)
class OperatorMean:
    """Mean outcome of one operator with one retargeter in one task."""

    outcome: Outcome
    task: str
    retargeter: str
    operator: str
    n: int
    mean: float


def operator_means(data: StudyData) -> list[OperatorMean]:
    """Success rate, mean time of successes [s] and mean workload of each operator.

    Args:
        data: the study.

    Returns:
        Sorted by outcome, task, retargeter and operator; none without rows.
    """
    trials = data.trials
    columns: list[tuple[Outcome, Any, np.ndarray, np.ndarray]] = [
        ("success", trials, trials.success.astype(float), np.ones(len(trials), bool)),
        ("time", trials, trials.time, trials.success & np.isfinite(trials.time)),
    ]
    if data.questionnaires is not None:
        workload = data.questionnaires.workload
        columns.append(("tlx", data.questionnaires, workload, np.isfinite(workload)))
    found = []
    for outcome, table, values, rows in columns:
        groups: dict[tuple[str, str, str], list[float]] = {}
        for i in np.flatnonzero(rows):
            key = (str(table.task[i]), str(table.retargeter[i]), str(table.operator[i]))
            groups.setdefault(key, []).append(float(values[i]))
        found += [
            OperatorMean(outcome, *key, len(group), float(np.mean(group)))
            for key, group in sorted(groups.items())
        ]
    return found


def variance(data: StudyData) -> dict[str, Any]:
    """Distribution of the operators' means.

    Returns:
        By outcome, task and retargeter: ``operators``, ``mean``, ``sd``, ``min``, ``q25``,
        ``median``, ``q75`` and ``max``.
    """
    groups: dict[tuple[str, str, str], list[float]] = {}
    for one in operator_means(data):
        groups.setdefault((one.outcome, one.task, one.retargeter), []).append(one.mean)
    found: dict[str, Any] = {outcome: {} for outcome in OUTCOMES}
    for (outcome, task, retargeter), means in groups.items():
        low, q25, median, q75, high = np.percentile(means, [0, 25, 50, 75, 100])
        found[outcome].setdefault(task, {})[retargeter] = {
            "operators": len(means),
            "mean": float(np.mean(means)),
            "sd": float(np.std(means, ddof=1)) if len(means) > 1 else None,
            "min": float(low),
            "q25": float(q25),
            "median": float(median),
            "q75": float(q75),
            "max": float(high),
        }
    return found
