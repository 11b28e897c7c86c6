"""The rows that a plan will yield: which operator does which task with what, in which order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.protocol import POINTS


@dataclass(frozen=True, eq=False)
class Rows:
    """Trials, or questionnaires, as columns of numbers.

    Attributes:
        operator: index into the codes (n,).
        task: index into the tasks (n,).
        condition: index into the conditions, the baseline first (n,).
        index: count over the operator's task, from 1 (n,).
    """

    operator: Int[np.ndarray, " n"]
    task: Int[np.ndarray, " n"]
    condition: Int[np.ndarray, " n"]
    index: Int[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Layout:
    """What a study of a plan will hold, if nobody drops out.

    Attributes:
        conditions: the baseline first.
        tasks: names.
        operators: codes.
        trials: rows of trials.
        questionnaires: rows of questionnaires; the index counts three a block.
    """

    conditions: tuple[str, ...]
    tasks: tuple[str, ...]
    operators: tuple[str, ...]
    trials: Rows
    questionnaires: Rows


def layout(plan: Plan) -> Layout:
    """The rows of a plan."""
    protocol = plan.protocol
    baseline = protocol.baseline
    conditions = (baseline, *sorted(set(protocol.condition_names) - {baseline}))
    tasks = tuple(task.name for task in protocol.tasks)
    trials: list[tuple[int, int, int, int]] = []
    asked: list[tuple[int, int, int, int]] = []
    for block in plan.schedule():
        key = (
            plan.codes.index(block.operator),
            tasks.index(block.task.name),
            conditions.index(block.condition.name),
        )
        trials += [(*key, block.trial_global(k)) for k in range(1, block.task.trials + 1)]
        asked += [
            (*key, (block.number - 1) * len(POINTS) + POINTS.index(point) + 1)
            for point in block.questionnaires.values()
        ]
    return Layout(conditions, tasks, plan.codes, _rows(trials), _rows(asked))


def _rows(rows: list[tuple[int, int, int, int]]) -> Rows:
    table = np.array(rows, int).reshape(-1, 4)
    return Rows(table[:, 0], table[:, 1], table[:, 2], table[:, 3])
