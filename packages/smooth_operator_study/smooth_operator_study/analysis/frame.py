"""Frame of an analysis: rows of outcome, retargeter, task, operator and standardised trial
index."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from smooth_operator.errors import StudyError
from smooth_operator_study.analysis.results import POOLED, Outcome
from smooth_operator_study.data.rows import StudyData

INTERCEPT: Final = "(Intercept)"
INDEX: Final = "t"
_DEPENDENT: Final = 1e-9
"""Unexplained share of a column's length up to which it counts as determined by earlier columns."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Rows of one analysis, with treatment coding: the baseline and the first task are references.

    Attributes:
        outcome: outcome y (n,).
        retargeters: names of the retargeters, the baseline first if it has rows.
        retargeter: index into ``retargeters`` of each row (n,).
        tasks: names of the tasks.
        task: index into ``tasks`` of each row (n,).
        operators: codes of the operators.
        group: index into ``operators`` of each row (n,).
        index: number of the trial or questionnaire (n,).
        baseline: retargeter to compare with; it may have no rows.
    """

    outcome: Float[np.ndarray, " n"]
    retargeters: tuple[str, ...]
    retargeter: Int[np.ndarray, " n"]
    tasks: tuple[str, ...]
    task: Int[np.ndarray, " n"]
    operators: tuple[str, ...]
    group: Int[np.ndarray, " n"]
    index: Float[np.ndarray, " n"]
    baseline: str

    def __len__(self) -> int:
        return len(self.outcome)

    @property
    def index_mean(self) -> float:
        """Mean of the index."""
        return float(self.index.mean())

    @property
    def index_sd(self) -> float:
        """Standard deviation of the index (n - 1)."""
        return float(self.index.std(ddof=1)) if len(self) > 1 else 0.0

    @property
    def standardised(self) -> Float[np.ndarray, " n"]:
        """z-score of the index; zero if the index never varies."""
        centred = self.index - self.index_mean
        return centred / self.index_sd if self.index_sd > 0 else centred

    @property
    def levels(self) -> dict[str, Int[np.ndarray, " n"]]:
        """Groups of rows with a common random intercept, coarse to fine."""
        own = self.group * len(self.retargeters) + self.retargeter
        groups = {"operator": self.group, "operator:retargeter": own}
        if len(self.tasks) > 1:
            groups["block"] = own * len(self.tasks) + self.task
        return groups

    def factors(self) -> tuple[Float[np.ndarray, "n p"], list[str]]:
        """Columns of intercept, retargeters and tasks, and their names."""
        columns, names = [np.ones(len(self))], [INTERCEPT]
        for j, name in enumerate(self.retargeters[1:], 1):
            columns.append((self.retargeter == j).astype(float))
            names.append(f"retargeter{name}")
        for k, name in enumerate(self.tasks[1:], 1):
            columns.append((self.task == k).astype(float))
            names.append(f"task{name}")
        return np.column_stack(columns), names

    def design(self) -> tuple[Float[np.ndarray, "n p"], list[str]]:
        """Returns the factors and the standardised index, which is left out if it never varies."""
        columns, names = self.factors()
        if self.index_sd == 0:
            return columns, names
        return np.column_stack([columns, self.standardised]), [*names, INDEX]

    def grid(self, width: int) -> Float[np.ndarray, "r k p"]:
        """Rows of the design for each retargeter and task at the mean index.

        Args:
            width: number of columns; those beyond the factors are zero.
        """
        rows = np.zeros((len(self.retargeters), len(self.tasks), width))
        rows[:, :, 0] = 1
        for j in range(1, len(self.retargeters)):
            rows[j, :, j] = 1
        for k in range(1, len(self.tasks)):
            rows[:, k, len(self.retargeters) - 1 + k] = 1
        return rows


def make_frame(
    outcome: Float[np.ndarray, " n"],
    retargeter: np.ndarray,
    task: np.ndarray,
    operator: np.ndarray,
    index: np.ndarray,
    baseline: str,
) -> Frame:
    """Makes a frame of columns with names.

    Args:
        outcome: outcome y, without NaN (n,).
        baseline: retargeter that comes first, if it occurs.
    """
    names = sorted({*retargeter}, key=lambda name: (name != baseline, name))
    tasks, operators = (pd.factorize(column, sort=True) for column in (task, operator))
    return Frame(
        outcome=np.asarray(outcome, float),
        retargeters=tuple(map(str, names)),
        retargeter=pd.Categorical(retargeter, names).codes.astype(int),
        tasks=tuple(map(str, tasks[1])),
        task=tasks[0],
        operators=tuple(map(str, operators[1])),
        group=operators[0],
        index=np.asarray(index, float),
        baseline=baseline,
    )


def keep_rows(frame: Frame, rows: Bool[np.ndarray, " n"]) -> Frame:
    """Selects rows of a frame; names that no longer occur are dropped."""
    names = (frame.retargeters, frame.tasks, frame.operators)
    codes = (frame.retargeter, frame.task, frame.group)
    retargeter, task, operator = (
        np.array(one)[code[rows]] for one, code in zip(names, codes, strict=True)
    )
    index = frame.index[rows]
    return make_frame(frame.outcome[rows], retargeter, task, operator, index, frame.baseline)


def check_frame(frame: Frame) -> None:
    """Raises StudyError if the rows can't be analysed."""
    if not len(frame):
        raise StudyError("there are no rows to analyse")
    if len(frame.operators) < 2:
        raise StudyError(
            f"all rows are of one operator ({frame.operators[0]}): results can't be "
            "generalised to other operators; at least two are needed, and ten or more are "
            "recommended"
        )
    if len(frame.retargeters) < 2:
        raise StudyError(
            f"all rows are of one retargeter ({frame.retargeters[0]}): there is nothing to compare "
            "it with"
        )
    if np.ptp(frame.outcome) == 0:
        raise StudyError(
            f"all {len(frame)} values are {frame.outcome[0]:g}, so there is no difference to test"
        )
    design, names = frame.design()
    dependent = dependent_columns(design)
    if dependent:
        raise StudyError(
            f"{', '.join(names[j] for j in dependent)}: not independent of the other terms: "
            "methods, tasks and trials were not crossed in these rows"
        )
    if len(frame) <= len(names):
        raise StudyError(f"{len(frame)} rows are too few for {len(names)} coefficients")


def dependent_columns(design: Float[np.ndarray, "n p"]) -> list[int]:
    """Finds columns that are linear combinations of earlier ones."""
    lengths = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    left = np.zeros(design.shape[1])  # rows beyond those of the design are zero
    diagonal = np.diag(np.linalg.qr(design / lengths, mode="r"))
    left[: len(diagonal)] = np.abs(diagonal)
    return np.flatnonzero(left <= _DEPENDENT).tolist()


Index: TypeAlias = Literal["global", "in block"]
"""Number of a trial or questionnaire in the operator's task, or in its block."""
_INDICES: Final = {"global": ("trial_global", "index"), "in block": ("trial_in_block", "point")}


def frame_of(rows: pd.DataFrame, scope: str, baseline: str, index: Index = "global") -> Frame:
    """Makes a frame of the rows of an outcome in a scope.

    Args:
        rows: rows as those of ``StudyData.outcomes``.
        baseline: retargeter that comes first, if it occurs.
    """
    rows = rows if scope == POOLED else rows[rows.task == scope]
    number = next(column for column in _INDICES[index] if column in rows)
    names = ("value", "retargeter", "task", "operator", number)
    value, retargeter, task, operator, count = (rows[name].to_numpy() for name in names)
    return make_frame(value, retargeter, task, operator, count, baseline)


def outcome_frames(data: StudyData, scope: str, baseline: str) -> dict[Outcome, Frame]:
    """Makes the frame of each outcome that a study has."""
    return {name: frame_of(rows, scope, baseline) for name, rows in data.outcomes().items()}
