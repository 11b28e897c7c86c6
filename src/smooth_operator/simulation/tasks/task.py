"""A task of a study and its rubric: what an operator does, and how a trial of it is scored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.simulation.tasks.checks import check_name, distinct, seconds, whole

_MOST_TRIALS: Final = 1000
_SCORES: Final = (0.0, 0.5, 1.0)


@dataclass(frozen=True)
class RubricLine:
    """One way for a trial to end.

    Attributes:
        name: in the data.
        score: 0 failed, 0.5 marginal, 1 done.
        text: what must have been seen.
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
        """Whether a trial can end by it.

        Args:
            resets: how often the object was put back; a line whose name ends in ``after-reset``
                needs one.
            cap: the best score after that.
        """
        return self.score <= cap if resets else not self.name.endswith("after-reset")


GENERAL_RUBRIC: Final = (
    RubricLine("done", 1.0, "done as instructed, without a reset"),
    RubricLine("marginal", 0.5, "done, after a reset or with an undesired state on the way"),
    RubricLine("failed", 0.0, "the object was dropped, or the operator gave up"),
)
"""For a task that has none of its own."""


@dataclass(frozen=True)
class Task:
    """What is to be done with the hand.

    Attributes:
        name: short, in data and results.
        trials: in each block.
        operators: how many are to do it; None for all of the study.
        title: for people.
        instruction: read to the operator.
        time_limit_s: after which a trial counts as not done [s]; None for no limit.
        rubric: how a trial is scored; a line for failure and one for success at least.
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
        """A line of the rubric.

        Raises:
            UnknownNameError: there is none of that name.
        """
        lines = {line.name: line for line in self.rubric}
        if name not in lines:
            raise UnknownNameError(f"line in the rubric of task {self.name!r}:", name, lines)
        return lines[name]
