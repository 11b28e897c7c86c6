"""Tables of a study, with every cell checked and errors listed by row and column."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.errors import StudyError, brief, listed
from smooth_operator.study.data.rows import (
    ITEMS,
    POINTS,
    SCORES,
    SUCCESS,
    Questionnaires,
    SimulationMetrics,
    Trials,
)

_MISSING = frozenset({"", "na", "n/a", "nan", "none", "null"})
_SHOWN = 8
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_MOST_COUNT = 10**9
"""Largest number of a block or trial; whole numbers of a table fit into 64 bits."""


@dataclass
class Checked:
    """Rows of one table, and all of their problems.

    Attributes:
        name: name of the file.
        rows: number of each row, and its values by column.
        unit: unit of these numbers: "row" of a file with a header in row 1, or "entry".
        problems: problems so far.
    """

    name: str
    rows: Sequence[tuple[int, Mapping[str, Any]]]
    unit: str = "row"
    problems: list[str] = field(default_factory=list)

    def complain(self, number: int, column: str, text: str) -> None:
        """Adds a problem of one value."""
        self.problems.append(f"{self.unit} {number}, column {column}: {text}")

    def raise_if_any(self) -> None:
        """Refuses the table if it has problems.

        Raises:
            StudyError: lists the first problems by row and column.
        """
        if not self.problems:
            return
        shown = "\n  ".join(self.problems[:_SHOWN])
        more = len(self.problems) - _SHOWN
        rest = f"\n  and {more} more" if more > 0 else ""
        raise StudyError(f"{self.name} can't be used:\n  {shown}{rest}")

    def words(self, column: str) -> np.ndarray:
        """Reads names (n,) of str; none is empty, and two differ by more than case."""
        texts: list[str] = []
        first: dict[str, tuple[int, str]] = {}
        for number, row in self.rows:
            text = str(row[column]).strip() if row[column] is not None else ""
            if not text:
                self.complain(number, column, "expected a name; the field is empty")
            at, spelling = first.setdefault(text.casefold(), (number, text))
            if spelling != text:
                self.complain(
                    number,
                    column,
                    f"{brief(text)} and {brief(spelling)} of {self.unit} {at} differ only in case; "
                    "write both the same way",
                )
            texts.append(text)
        return np.array(texts, str)

    def counts(self, column: str) -> Int[np.ndarray, " n"]:
        """Reads whole numbers from 1."""
        wholes = []
        for number, row in self.rows:
            value = _number(row[column])
            if value is None or not 1 <= value <= _MOST_COUNT or value != int(value):
                self.complain(
                    number, column, f"expected a whole number from 1 on, came {brief(row[column])}"
                )
                value = 1.0
            wholes.append(int(value))
        return np.array(wholes, int)

    def numbers(
        self, column: str, expected: str, allowed: Any, *, optional: bool = True
    ) -> Float[np.ndarray, " n"]:
        """Reads numbers; NaN where the field is empty.

        Args:
            column: name of the column.
            expected: description of the allowed values, for messages.
            allowed: function of a number that returns whether it is allowed.
            optional: whether the field may be empty.
        """
        floats = []
        for number, row in self.rows:
            if is_missing(row[column]):
                if not optional:
                    self.complain(number, column, f"expected {expected}; the field is empty")
                floats.append(math.nan)
                continue
            value = _number(row[column])
            if value is None or not allowed(value):
                self.complain(number, column, f"expected {expected}, came {brief(row[column])}")
                value = math.nan
            floats.append(value)
        return np.array(floats, float)

    def unique(self, columns: Sequence[str]) -> None:
        """Adds a problem for each row whose values in these columns occur twice."""
        rows_of: dict[tuple[str, ...], int] = {}
        for number, row in self.rows:
            key = tuple(str(row[column]).strip() for column in columns)
            if key in rows_of:
                what = listed(f"{c} {k}" for c, k in zip(columns, key, strict=True))
                self.problems.append(
                    f"{self.unit} {number}: the same {what} as {self.unit} {rows_of[key]}; every "
                    "trial and questionnaire may be there once"
                )
            rows_of.setdefault(key, number)


def is_missing(value: Any) -> bool:
    """True if a field is empty or holds a word for a missing value."""
    return (
        value is None
        or (isinstance(value, str) and value.strip().lower() in _MISSING)
        or (isinstance(value, float) and math.isnan(value))
    )


def _number(value: Any) -> float | None:
    """Reads a finite number; None if the value is none."""
    if isinstance(value, bool) or is_missing(value):
        return None
    if isinstance(value, str) and not _NUMBER.fullmatch(value.strip()):
        return None  # Python would take 1_0 for 10
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


TRIAL_COLUMNS: Final = (
    "operator", "task", "retargeter", "block", "trial_in_block", "trial_global", "score", "time_s",
)  # fmt: skip
MORE_TRIAL_COLUMNS: Final = ("duration_s", "line", "resets", "started_at", "place", "amended")
"""Further columns of exported trials, which the analysis does not read."""
QUESTIONNAIRE_COLUMNS: Final = ("operator", "task", "retargeter", "block", "point", *ITEMS)
METRIC_COLUMNS: Final = ("operator", "retargeter")
"""Columns of metrics, followed by one column for each metric."""
Rows = Sequence[tuple[int, Mapping[str, Any]]]


def make_trials(name: str, rows: Rows, unit: str = "row") -> tuple[Trials, tuple[str, ...]]:
    """Makes checked trials of rows.

    Args:
        name: name of the file, for messages.
        rows: rows with all of ``TRIAL_COLUMNS``.
        unit: unit of the row numbers.

    Returns:
        The trials, and notes on their oddities.

    Raises:
        StudyError: a value does not fit its column; lists problems by row and column.
    """
    table = Checked(name, rows, unit)
    trials = Trials(
        operator=table.words("operator"),
        task=table.words("task"),
        retargeter=table.words("retargeter"),
        block=table.counts("block"),
        trial_in_block=table.counts("trial_in_block"),
        trial_global=table.counts("trial_global"),
        score=table.numbers("score", "0, 0.5 or 1", lambda x: x in SCORES, optional=False),
        time=table.numbers("time_s", "a time in seconds above 0, or nothing", lambda x: x > 0),
    )
    table.unique(("operator", "task", "block", "trial_in_block"))
    table.unique(("operator", "task", "trial_global"))
    table.raise_if_any()
    notes = []
    untimed = [
        number
        for (number, _), score, time in zip(rows, trials.score, trials.time, strict=True)
        if score >= SUCCESS and np.isnan(time)
    ]
    if untimed:
        shown = ", ".join(str(number) for number in untimed[:8])
        shown += f" and {len(untimed) - 8} more" if len(untimed) > 8 else ""
        plural = "trials have" if len(untimed) > 1 else "trial has"
        notes.append(
            f"{len(untimed)} successful {plural} no time_s and can't enter the analysis of time "
            f"({name}, {unit} {shown})"
        )
    notes += _mixed_blocks(name, trials)
    return trials, tuple(notes)


def make_questionnaires(
    name: str, rows: Rows, unit: str = "row"
) -> tuple[Questionnaires, tuple[str, ...]]:
    """Makes checked questionnaires of rows.

    Args:
        name: name of the file, for messages.
        rows: rows with all of ``QUESTIONNAIRE_COLUMNS``.
        unit: unit of the row numbers.

    Returns:
        The questionnaires, and notes on their oddities.

    Raises:
        StudyError: a value does not fit its column; lists problems by row and column.
    """
    table = Checked(name, rows, unit)
    points = []
    for (number, _), word in zip(rows, table.words("point").tolist(), strict=True):
        if word.lower() not in POINTS:
            table.complain(number, "point", f"expected {', '.join(POINTS)}; came {brief(word)}")
        points.append(POINTS.index(word.lower()) + 1 if word.lower() in POINTS else 1)
    answers = [
        table.numbers(item, "0 to 100, or nothing", lambda x: 0 <= x <= 100) for item in ITEMS
    ]
    filled = Questionnaires(
        operator=table.words("operator"),
        task=table.words("task"),
        retargeter=table.words("retargeter"),
        block=table.counts("block"),
        point=np.array(points, int),
        answers=np.array(answers).T.reshape(-1, len(ITEMS)),
    )
    table.unique(("operator", "task", "block", "point"))
    table.raise_if_any()
    missing = int(np.isnan(filled.workload).sum())
    notes = []
    if missing:
        notes.append(
            f"{missing} of {len(filled)} questionnaires have an answer left out and can't enter "
            f"the analysis of workload ({name})"
        )
    return filled, tuple(notes)


def make_metrics(name: str, rows: Rows, unit: str = "row") -> SimulationMetrics:
    """Makes checked metrics from simulation of rows.

    Raises:
        StudyError: a value does not fit its column; lists problems by row and column.
    """
    table = Checked(name, rows, unit)
    names = tuple(column for column in rows[0][1] if column not in METRIC_COLUMNS)
    if not names:
        table.problems.append("expected a column for each metric next to operator and retargeter")
    values = [table.numbers(metric, "a number, or nothing", lambda x: True) for metric in names]
    metrics = SimulationMetrics(
        operator=table.words("operator"),
        retargeter=table.words("retargeter"),
        names=names,
        values=np.array(values).T.reshape(-1, len(names)),
    )
    table.unique(METRIC_COLUMNS)
    table.raise_if_any()
    return metrics


def _mixed_blocks(name: str, trials: Trials) -> list[str]:
    """Notes on blocks with trials of several retargeters, whose trial numbers mean little."""
    first: dict[tuple[str, str, int], str] = {}
    mixed = set()
    for operator, task, block, retargeter in zip(
        trials.operator, trials.task, trials.block, trials.retargeter, strict=True
    ):
        key = (str(operator), str(task), int(block))
        if first.setdefault(key, str(retargeter)) != retargeter:
            mixed.add(key)
    if not mixed:
        return []
    operator, task, block = min(mixed)
    return [
        f"{len(mixed)} block(s) hold trials of more than one retargeter, the first is block "
        f"{block} of operator {operator} in task {task} ({name})"
    ]
