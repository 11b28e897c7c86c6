"""Does a logistic model have finite coefficients? Separation, by linear programming.

If some combination of the columns is never negative for successes and never positive for failures,
and not always zero, its coefficient is infinite: no standard error means anything then. An
iteration may still claim to have converged (Albert and Anderson 1984; Konis 2007).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog

from smooth_operator.study.analysis.frame import Frame

_ANY: Final = 1e-7


def separating(
    design: Float[np.ndarray, "n p"], success: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " p"] | None:
    """A direction that separates successes from failures, wholly or in part.

    Args:
        design: columns of the model (n, p).
        success: 0 or 1 (n,).

    Returns:
        Its coefficients in -1 .. 1; None if there is none.
    """
    signed = design * np.where(success > 0, 1.0, -1.0)[:, None]
    # Equal rows say the same; a study has few distinct ones, apart from the index of the trial.
    signed = np.unique(signed, axis=0)
    found = linprog(
        -signed.sum(axis=0),
        A_ub=-signed,
        b_ub=np.zeros(len(signed)),
        bounds=[(-1, 1)] * design.shape[1],
        method="highs",
    )
    if found.status != 0 or -found.fun <= _ANY:
        return None
    return np.asarray(found.x)


def one_sided_levels(frame: Frame) -> list[str]:
    """Retargeters and tasks with nothing but successes, or nothing but failures, in words."""
    said = []
    for kind, names, codes in (
        ("retargeter", frame.retargeters, frame.retargeter),
        ("task", frame.tasks, frame.task),
    ):
        for j, name in enumerate(names):
            outcome = frame.outcome[codes == j]
            if len(outcome) and np.ptp(outcome) == 0:
                said.append(f"{kind} {name} has {_count(outcome)}")
    return said


def one_sided_cells(frame: Frame) -> list[str]:
    """Cells of retargeter and task with nothing but successes, or nothing but failures."""
    said = []
    for j, name in enumerate(frame.retargeters):
        for k, task in enumerate(frame.tasks):
            outcome = frame.outcome[(frame.retargeter == j) & (frame.task == k)]
            if len(outcome) and np.ptp(outcome) == 0:
                said.append(f"{name} in task {task} has {_count(outcome)}")
    return said


def _count(outcome: Float[np.ndarray, " n"]) -> str:
    return f"{int(outcome.sum())} successes in {len(outcome)} trials"
