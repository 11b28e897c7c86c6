"""Reading: do the differences between retargeters depend on the task?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.frame import Frame, check_frame
from smooth_operator.study.analysis.readings.clusters import WaldTest
from smooth_operator.study.analysis.readings.fits import fit_with
from smooth_operator.study.analysis.readings.parts import Refused, found_or_refused
from smooth_operator.study.analysis.results import Outcome

ALPHA = 0.05


@dataclass(frozen=True)
class Interaction:
    """Joint test of retargeter x task in the model of all tasks."""

    test: WaldTest
    n: int
    operators: int

    @property
    def found(self) -> bool:
        """Whether p is under 0.05."""
        return self.test.p < ALPHA


def interaction(outcome: Outcome, frame: Frame) -> Interaction | Refused:
    """Tests retargeter x task.

    Args:
        outcome: decides on the model.
        frame: rows of all tasks.
    """
    return found_or_refused(lambda: _interaction(outcome, frame))


def _interaction(outcome: Outcome, frame: Frame) -> Interaction:
    check_frame(frame)
    if len(frame.tasks) < 2:
        raise StudyError("the study has one task")
    columns = []
    for j, name in enumerate(frame.retargeters):
        for k, task in enumerate(frame.tasks):
            cell = (frame.retargeter == j) & (frame.task == k)
            if not cell.any():
                raise StudyError(f"no rows of {name} in task {task}")
            if j and k:
                columns.append(cell.astype(float))
    fit = fit_with(outcome, frame, np.column_stack(columns))
    return Interaction(fit.joint(slice(-len(columns), None)), len(frame), len(frame.operators))
