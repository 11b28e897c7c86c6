"""Registry of the study's tasks in simulation: rubric, time limit, scorer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

from smooth_operator.errors import UnknownNameError
from smooth_operator.simulation.tasks.scorers import (
    CardScorer,
    CubeScorer,
    Scorer,
    ScrewdriverScorer,
)
from smooth_operator.simulation.tasks.task import (
    CARD_PICKUP,
    CUBE_ROTATION,
    SCREWDRIVER_PIVOT,
    Task,
)


@dataclass(frozen=True)
class SimulatedTask:
    """A task that physics can score.

    Attributes:
        name: name of its scene in ``SCENES``.
        task: the task of the protocol, with its rubric.
        seconds: time limit of a trial [s].
        scorer: makes the scorer of a trial from its scene.
        after_reset: line of the rubric for success after the reset.
        after_stuck: line of the rubric for success after a reset that was the only way on.
    """

    name: str
    task: Task
    seconds: float
    scorer: Callable[[Any], Scorer]
    after_reset: str
    after_stuck: str


def _simulated(
    name: str,
    task: Task,
    seconds: float,
    scorer: Callable[[Any], Scorer],
    after: tuple[str, str],
) -> SimulatedTask:
    return SimulatedTask(name, replace(task, time_limit_s=seconds), seconds, scorer, *after)


_RESET: Final = "done-after-reset"
TASKS: Final[dict[str, SimulatedTask]] = {
    task.name: task
    for task in (
        _simulated("card", CARD_PICKUP, 60.0, CardScorer, (_RESET, "out-of-reach")),
        _simulated("cube", CUBE_ROTATION, 120.0, CubeScorer, ("misaligned", "misaligned")),
        _simulated("screwdriver", SCREWDRIVER_PIVOT, 60.0, ScrewdriverScorer, (_RESET, _RESET)),
    )
}
"""Name -> task."""


def task_named(name: str) -> SimulatedTask:
    """A task by its name here or in the paper (A, B, C).

    Raises:
        UnknownNameError: there is no such task.
    """
    for task in TASKS.values():
        if name in (task.name, task.task.name):
            return task
    raise UnknownNameError("task", name, TASKS)
