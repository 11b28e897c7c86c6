"""Task of a study with its rubric, and the paper's three tasks.

Source of the rubrics: the paper's supplement, task success rubric, in our words.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.simulation.tasks.scorers import (
    CardScorer,
    CubeScorer,
    Scorer,
    ScrewdriverScorer,
)

_MOST_TRIALS: Final = 1000
_SCORES: Final = (0.0, 0.5, 1.0)


_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def check_name(name: str, what: str) -> str:
    """A name that is valid in a table, a file name and an address.

    Raises:
        StudyError: it has other characters, or is too long.
    """
    if not _NAME.fullmatch(name) or len(name) > 64:
        raise StudyError(
            f"{what} {name!r}: use up to 64 letters, digits and '_', '.', '-', and a letter or "
            "digit first"
        )
    return name


def distinct(names: Sequence[str], what: str) -> None:
    """Raises StudyError if a name comes twice."""
    for name in names:
        if names.count(name) > 1:
            raise StudyError(f"{what} need different names; {name!r} comes twice")


def whole(value: int, least: int, most: int, what: str) -> None:
    """Raises StudyError unless the value is a whole number in a range."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise StudyError(f"{what} must be a whole number from {least} to {most}, not {value!r}")


def seconds(value: float, what: str, least: float = 0.0) -> None:
    """Raises StudyError unless the value is a time of up to a day [s]."""
    if not math.isfinite(value) or not least <= value <= 86_400:
        raise StudyError(f"{what} must be {least:g} to 86400 s, not {value}")


@dataclass(frozen=True)
class RubricLine:
    """One way for a trial to end.

    Attributes:
        name: name of the line in the data.
        score: 0 failed, 0.5 marginal, 1 done.
        text: condition of the line, as the experimenter reads it.
    """

    name: str
    score: float
    text: str = ""

    def __post_init__(self) -> None:
        check_name(self.name, "line of a rubric")
        if self.score not in _SCORES:
            raise StudyError(
                f"line {self.name!r} of a rubric: its score must be 0, 0.5 or 1, not {self.score}"
            )

    def possible(self, resets: int, cap: float) -> bool:
        """True if a trial can end with this line.

        Args:
            resets: number of resets; a line whose name ends in ``after-reset`` needs one.
        """
        return self.score <= cap if resets else not self.name.endswith("after-reset")


GENERAL_RUBRIC: Final = (
    RubricLine("done", 1.0, "done as instructed, without a reset"),
    RubricLine("marginal", 0.5, "done, after a reset or with an undesired state on the way"),
    RubricLine("failed", 0.0, "the object was dropped, or the operator gave up"),
)
"""Rubric of a task without one of its own."""


@dataclass(frozen=True)
class Task:
    """A task that an operator does with the robot hand.

    Attributes:
        name: short name in data and results.
        trials: number of trials in each block.
        operators: number of operators who do it; None for all of the study.
        title: title for people.
        instruction: text that is read to the operator.
        time_limit_s: time after which a trial counts as not done [s]; None for no limit.
        rubric: lines by which a trial is scored, at least one for failure and one for success.
    """

    name: str
    trials: int = 10
    operators: int | None = None
    title: str = ""
    instruction: str = ""
    time_limit_s: float | None = None
    rubric: tuple[RubricLine, ...] = GENERAL_RUBRIC

    def __post_init__(self) -> None:
        check_name(self.name, "task")
        whole(self.trials, 1, _MOST_TRIALS, f"task {self.name!r}: trials in a block")
        if self.operators is not None:
            whole(self.operators, 1, 10_000, f"task {self.name!r}: operators")
        if self.time_limit_s is not None:
            seconds(self.time_limit_s, f"task {self.name!r}: time limit", least=1.0)
        distinct([line.name for line in self.rubric], f"lines in the rubric of {self.name!r}")
        scores = {line.score for line in self.rubric}
        if 0.0 not in scores or not scores - {0.0}:
            raise StudyError(
                f"task {self.name!r}: the rubric needs a line that scores 0 and one that scores "
                f"more; it has {sorted(scores)}"
            )

    def line(self, name: str) -> RubricLine:
        """A line of the rubric by its name.

        Raises:
            UnknownNameError: there is no line of that name.
        """
        lines = {line.name: line for line in self.rubric}
        if name not in lines:
            raise UnknownNameError(f"line in the rubric of task {self.name!r}:", name, lines)
        return lines[name]


_DROPPED: Final = RubricLine("dropped", 0.0, "the object left the hand's workspace")
_GAVE_UP: Final = RubricLine("not-done", 0.0, "the operator gave up, or the time was over")
_RESET: Final = RubricLine("done-after-reset", 0.5, "done, after the one reset that is allowed")

CARD_PICKUP: Final = Task(
    "A",
    title="Card pickup",
    instruction="Slide the flat card over the edge of the platform and pinch it.",
    trials=10,
    operators=12,
    rubric=(
        RubricLine("done", 1.0, "slid over the edge and held in a pinch, without a reset"),
        _RESET,
        RubricLine(
            "out-of-reach", 0.5, "out of reach or flicked across the top; pinched after a reset"
        ),
        RubricLine("no-edge", 0.5, "pinched and lifted without having gone over the edge"),
        _DROPPED,
        _GAVE_UP,
    ),
)

CUBE_ROTATION: Final = Task(
    "B",
    title="Vertical cube rotation",
    instruction="Turn the cube by 90 degrees about the vertical axis.",
    trials=10,
    operators=8,
    rubric=(
        RubricLine("done", 1.0, "turned by 90 degrees about the vertical, without a reset"),
        RubricLine("misaligned", 0.5, "turned, after a reset for faces badly misaligned"),
        RubricLine("flipped", 0.5, "turned, but the cube flipped onto another face on the way"),
        _DROPPED,
        _GAVE_UP,
    ),
)

SCREWDRIVER_PIVOT: Final = Task(
    "C",
    title="Screwdriver pivot",
    instruction="Hold the screwdriver in four fingers, loosen the grip until it points down.",
    trials=20,
    operators=6,
    rubric=(
        RubricLine("done", 1.0, "points straight down, still held, without a reset"),
        RubricLine("nearly", 0.5, "nearly down, at a limit where no finer adjustment is possible"),
        _RESET,
        _DROPPED,
        _GAVE_UP,
    ),
)

PAPER_TASKS: Final = (CARD_PICKUP, CUBE_ROTATION, SCREWDRIVER_PIVOT)


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


TASKS: Final[dict[str, SimulatedTask]] = {
    task.name: task
    for task in (
        _simulated("card", CARD_PICKUP, 60.0, CardScorer, (_RESET.name, "out-of-reach")),
        _simulated("cube", CUBE_ROTATION, 120.0, CubeScorer, ("misaligned", "misaligned")),
        _simulated(
            "screwdriver", SCREWDRIVER_PIVOT, 60.0, ScrewdriverScorer, (_RESET.name, _RESET.name)
        ),
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
