"""Protocol of a study: conditions, tasks with rubrics, blocks, endpoints and margins."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias, get_args

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.simulation.tasks.task import RubricLine as RubricLine
from smooth_operator.simulation.tasks.task import Task as Task
from smooth_operator.simulation.tasks.task import check_name, distinct, seconds, whole
from smooth_operator_study.design.forms import Form

Outcome: TypeAlias = Literal["success", "time", "tlx"]
OUTCOMES: Final[tuple[Outcome, ...]] = get_args(Outcome)
"""Success rate (0 to 1), completion time [s], workload (0 to 100 points)."""
POOLED: Final = "pooled"
"""Name of the scope of all tasks together; the other scopes are the tasks."""
PRIMARY: Final = f"{OUTCOMES[0]}/{POOLED}"
FEW_OPERATORS: Final = 6
"""Number of operators below which only very large differences can be shown."""
ALPHA: Final = 0.05
"""Significance level of all tests."""
TESTED_OPERATORS: Final = 5
"""Smallest number of operators for which the error of the tests was checked by simulation."""
PAPER_MARGINS: Final = {"success": 0.10, "time": 5.0, "tlx": 10.0}
_LARGEST: Final = {"success": 1.0, "time": 86_400.0, "tlx": 100.0}


def check_primary(primary: str, tasks: Sequence[str], *, workload: bool) -> None:
    """Raises an error if the study does not measure the primary endpoint.

    Args:
        primary: ``OUTCOME/SCOPE``; empty for none.
    """
    if not primary:
        return
    outcome, slash, scope = primary.partition("/")
    if not slash or not scope:
        raise StudyError(
            f"the primary endpoint must be OUTCOME/SCOPE as in {PRIMARY!r}, not {primary!r}"
        )
    if outcome not in OUTCOMES:
        raise UnknownNameError("outcome of the primary endpoint:", outcome, OUTCOMES)
    if scope not in (POOLED, *tasks):
        raise UnknownNameError("scope of the primary endpoint:", scope, (POOLED, *tasks))
    if outcome == "tlx" and not workload:
        raise StudyError(f"the primary endpoint {primary!r} needs questionnaires; none are planned")


def check_margins(margins: Mapping[str, float]) -> None:
    """Checks margins of equivalence."""
    for outcome, margin in margins.items():
        if outcome not in OUTCOMES:
            raise UnknownNameError("outcome of a margin:", outcome, OUTCOMES)
        if not math.isfinite(margin) or not 0 < margin < _LARGEST[outcome]:
            raise StudyError(
                f"the margin of {outcome} must be above 0 and below {_LARGEST[outcome]:g}, "
                "in the outcome's unit (success is a fraction: 0.1 is 10 percentage "
                f"points), not {margin:g}"
            )


Point: TypeAlias = Literal["initial", "midpoint", "final"]
"""Time of a questionnaire: after the first, the middle or the last trial of a block."""
POINTS: Final[tuple[Point, ...]] = get_args(Point)
SCORES: Final = (0.0, 0.5, 1.0)
"""Possible scores of a trial: failure, marginal success and success."""


@dataclass(frozen=True)
class Condition:
    """Condition of a study: a retargeting method with its preset.

    Attributes:
        name: name in data and results; letters, digits and ``_ . -``.
        method: retargeting method that the running teleoperation is switched to.
        preset: preset of the method; None for its default.
        label: neutral name for operators and blind experimenters.
    """

    name: str
    method: str = ""
    preset: str | None = None
    label: str = ""

    def __post_init__(self) -> None:
        check_name(self.name, "condition")
        if not self.method:
            object.__setattr__(self, "method", self.name)

    @classmethod
    def of(cls, text: str) -> Condition:
        """Parses ``NAME``, ``NAME=METHOD`` or ``NAME=METHOD:PRESET``."""
        name, _, what = text.partition("=")
        method, _, preset = what.partition(":")
        return cls(name, method or name, preset or None)


@dataclass(frozen=True)
class Protocol:
    """Protocol of a study. The orders and the rows of the operators are in ``Plan``.

    Attributes:
        name: name of the study.
        conditions: two conditions or more.
        tasks: one task or more.
        baseline: name of the condition that the others are compared with.
        operators: planned number of operators.
        familiarisation_s: free movement before the trials of each block, without the task [s].
        questionnaires: trials of a block that NASA-TLX follows; empty for none.
        resets: number of times that the object may be put back in a trial.
        reset_cap: best score of a trial after a reset.
        break_s: length of a break between blocks [s].
        task_order: ``balanced`` or ``listed`` order of an operator's tasks.
        seed: seed of the square, orders and labels.
        rate_hz: commands a second to the hand in every condition [Hz]; None for the rate that the
            teleoperation was started with.
        primary: primary endpoint ``OUTCOME/SCOPE``: success, time or tlx, and pooled or a task;
            all else is exploratory. Empty without one.
        margins: outcome -> difference below which two conditions are equivalent, in the outcome's
            unit: share, s, points.
        break_every: number of blocks between two breaks; 0 for no breaks.
        forms: forms before the first block and after the last one.
        tlx_language: file in the folder of the study with NASA-TLX in another language; empty
            for the published wording.
    """

    name: str
    conditions: tuple[Condition, ...]
    tasks: tuple[Task, ...]
    baseline: str
    operators: int
    familiarisation_s: float = 120.0
    questionnaires: tuple[Point, ...] = POINTS
    resets: int = 1
    reset_cap: float = 0.5
    break_s: float = 120.0
    task_order: Literal["balanced", "listed"] = "balanced"
    seed: int = 0
    rate_hz: float | None = None
    primary: str = PRIMARY
    margins: Mapping[str, float] = field(default_factory=dict, hash=False)
    break_every: int = 1
    forms: tuple[Form, ...] = ()
    tlx_language: str = ""

    def __post_init__(self) -> None:
        if not self.name.strip() or not self.name.isprintable():
            raise StudyError(f"a study needs a name of printable characters, not {self.name!r}")
        if len(self.conditions) < 2:
            raise StudyError(
                f"a study needs at least two conditions; it has {len(self.conditions)}"
            )
        if not self.tasks:
            raise StudyError("a study needs at least one task")
        distinct(list(self.condition_names), "conditions")
        labels = [condition.label for condition in self.conditions if condition.label]
        distinct(labels, "labels of conditions")
        distinct([task.name for task in self.tasks], "tasks")
        if self.baseline not in self.condition_names:
            raise UnknownNameError("baseline", self.baseline, self.condition_names)
        whole(self.operators, 1, 10_000, "operators")
        seconds(self.familiarisation_s, "familiarisation")
        seconds(self.break_s, "break")
        whole(self.resets, 0, 100, "resets of a trial")
        whole(self.break_every, 0, 1000, "blocks between two breaks")
        distinct([form.name for form in self.forms], "forms")
        if self.reset_cap not in SCORES:
            raise StudyError(f"the score after a reset must be 0, 0.5 or 1, not {self.reset_cap}")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise StudyError(f"the seed must be a whole number, 0 or more, not {self.seed!r}")
        if self.rate_hz is not None and not 1.0 <= self.rate_hz <= 1000.0:
            raise StudyError(f"the rate of commands must be 1 to 1000 Hz, not {self.rate_hz}")
        names = [task.name for task in self.tasks]
        check_primary(self.primary, names, workload=bool(self.questionnaires))
        check_margins(self.margins)
        self._check_enrolment()
        for task in self.tasks:
            self.questionnaire_trials(task)

    def _check_enrolment(self) -> None:
        planned = [self.planned(task) for task in self.tasks]
        for task, count in zip(self.tasks, planned, strict=True):
            if count > self.operators:
                raise StudyError(
                    f"task {task.name!r} is planned for {count} operators, but the study has "
                    f"{self.operators}"
                )
        if sum(planned) < self.operators:
            raise StudyError(
                f"{self.operators} operators, but the tasks take only {sum(planned)}: some "
                "operators would have no task"
            )

    @property
    def condition_names(self) -> tuple[str, ...]:
        """Names of the conditions in their listed order."""
        return tuple(condition.name for condition in self.conditions)

    def condition(self, name: str) -> Condition:
        """Finds a condition by its name, which the protocol has."""
        return next(condition for condition in self.conditions if condition.name == name)

    def task(self, name: str) -> Task:
        """Finds a task by its name."""
        by_name = {task.name: task for task in self.tasks}
        if name not in by_name:
            raise UnknownNameError("task", name, by_name)
        return by_name[name]

    def planned(self, task: Task) -> int:
        """Planned number of operators of a task."""
        return self.operators if task.operators is None else task.operators

    def questionnaire_trials(self, task: Task) -> dict[int, Point]:
        """Returns trial of a block, from 1 -> questionnaire that follows it."""
        after: dict[Point, int] = {
            "initial": 1,
            "midpoint": (task.trials + 1) // 2,
            "final": task.trials,
        }
        trials: dict[int, Point] = {}
        for point in self.questionnaires:
            trial = after[point]
            if trial in trials:
                raise StudyError(
                    f"task {task.name!r}: with {task.trials} trial(s) per block, "
                    f"questionnaires {trials[trial]!r} and {point!r} would both follow trial "
                    f"{trial}; plan more trials or fewer questionnaires"
                )
            trials[trial] = point
        return dict(sorted(trials.items()))
