"""Scores by a second rater, from a table of their own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from smooth_operator.errors import StudyError
from smooth_operator.study.data.cells import Checked
from smooth_operator.study.data.participants import SecondRatings
from smooth_operator.study.data.reading import csv_rows
from smooth_operator.study.data.rows import SCORES, StudyData

SECOND_COLUMNS: Final = ("operator", "task", "block", "trial_in_block", "score")

_KEY: Final = SECOND_COLUMNS[:-1]


def with_second_ratings(data: StudyData, file: str | Path) -> StudyData:
    """The study with a second rater's scores of some or all trials.

    Args:
        data: the study.
        file: CSV with ``SECOND_COLUMNS``; further columns are ignored.

    Raises:
        StudyError: it can't be read, a column is missing, a value is none, or a trial is there
            twice or is none of the study.
    """
    file = Path(file)
    rows = csv_rows(file)
    missing = [column for column in SECOND_COLUMNS if column not in rows[0][1]]
    if missing:
        raise StudyError(
            f"{file.name}: a table of second ratings needs the columns "
            f"{', '.join(SECOND_COLUMNS)}; missing: {', '.join(missing)}"
        )
    table = Checked(file.name, rows)
    found = SecondRatings(
        operator=np.array(table.words("operator")),
        task=np.array(table.words("task")),
        block=np.array(table.counts("block"), int),
        trial_in_block=np.array(table.counts("trial_in_block"), int),
        score=np.array(
            table.numbers("score", "0, 0.5 or 1", lambda x: x in SCORES, optional=False)
        ),
    )
    table.unique(_KEY)
    trials = data.trials
    known = set(zip(trials.operator, trials.task, trials.block, trials.trial_in_block, strict=True))
    for k, (number, _) in enumerate(rows):
        key = (found.operator[k], found.task[k], found.block[k], found.trial_in_block[k])
        if key not in known:
            where = ", ".join(f"{c} {v}" for c, v in zip(_KEY, key, strict=True))
            table.problems.append(f"row {number}: the study has no trial of {where}")
    table.raise_if_any()
    return replace(data, second_ratings=found)
