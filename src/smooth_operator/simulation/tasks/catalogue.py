"""Lists the simulated tasks: those of the study, with the hand on a fixture, and those with a
moving wrist."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from smooth_operator.errors import UnknownNameError
from smooth_operator.simulation.tasks.relocate import RELOCATE, RelocateScorer
from smooth_operator.simulation.tasks.task import (
    AFTER_RESET,
    CARD_PICKUP,
    CUBE_ROTATION,
    SCREWDRIVER_PIVOT,
    CardScorer,
    CubeScorer,
    Scorer,
    ScrewdriverScorer,
    SimulatedTask,
    Task,
)
from smooth_operator.simulation.tasks.tools import HAMMER, TONGS, HammerScorer, TongsScorer


def _simulated(
    name: str,
    task: Task,
    seconds: float,
    scorer: Callable[[Any], Scorer],
    after: tuple[str, str] = (AFTER_RESET.name, AFTER_RESET.name),
    moves_wrist: bool = False,
) -> SimulatedTask:
    limited = replace(task, time_limit_s=seconds)
    return SimulatedTask(name, limited, seconds, scorer, *after, moves_wrist)


TASKS: Final[dict[str, SimulatedTask]] = {
    task.name: task
    for task in (
        _simulated("card", CARD_PICKUP, 60.0, CardScorer, (AFTER_RESET.name, "out-of-reach")),
        _simulated("cube", CUBE_ROTATION, 120.0, CubeScorer, ("misaligned", "misaligned")),
        _simulated("screwdriver", SCREWDRIVER_PIVOT, 60.0, ScrewdriverScorer),
        _simulated("relocate", RELOCATE, 15.0, RelocateScorer, moves_wrist=True),
        _simulated("hammer", HAMMER, 20.0, HammerScorer, moves_wrist=True),
        _simulated("tongs", TONGS, 20.0, TongsScorer, moves_wrist=True),
    )
}
"""Name -> task."""

FIXED_WRIST: Final = tuple(name for name, task in TASKS.items() if not task.moves_wrist)
"""Names of the study's tasks, in which the hand is on a fixture."""


def task_named(name: str) -> SimulatedTask:
    """Returns a task by its name, or by its letter in the Smooth Operator paper (A, B, C);
    UnknownNameError if there is no such task."""
    for task in TASKS.values():
        if name in (task.name, task.task.name):
            return task
    raise UnknownNameError("task", name, TASKS)
