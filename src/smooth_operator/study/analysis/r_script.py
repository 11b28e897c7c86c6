"""``analysis.R``, ``readings.R`` and the rows that they read: the same analysis again, in R."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.atomic_files import atomic_write
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.study.analysis import spearman
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.readings import Refused
from smooth_operator.study.analysis.readings.covariates import field_answers, usable_fields
from smooth_operator.study.analysis.readings.resampling import (
    DRAWS,
    operator_signs,
    operator_weights,
)
from smooth_operator.study.data.rows import Questionnaires, SimulationMetrics, StudyData

SCRIPT: Final = "analysis.R"
READINGS: Final = "readings.R"
"""What the first script goes on with."""
TRIALS: Final = "rows_trials.csv"
TLX: Final = "rows_tlx.csv"
METRICS: Final = "rows_metrics.csv"
RANKINGS: Final = "rows_rankings.csv"
FORMS: Final = "rows_forms.csv"
DRAWN: Final = "rows_draws.csv"
SIGNS: Final = "rows_signs.csv"


def write_r_script(analysis: Analysis, folder: Path) -> list[str]:
    """Writes scripts and rows.

    Args:
        analysis: of the study.
        folder: exists, with the tables of the analysis.

    Returns:
        Names of the files. A table that the study does not have is not written, and an older one
        removed.

    Raises:
        OutputError: a file can't be written.
    """
    data, asked, seed = analysis.data, analysis.data.questionnaires, analysis.seed
    drawn, of_rho = _sizes(analysis)
    filled = {
        "@BASELINE@": json.dumps(analysis.baseline),
        "@LIMITS@": _named(_limits(analysis)),
        "@MARGINS@": _named(data.plan.margins if data.plan else {}),
        "@WORKLOAD@": json.dumps(f"{asked.kind}_tlx" if asked else ""),
    }
    texts: dict[str, str | None] = {
        SCRIPT: _script(SCRIPT, filled),
        READINGS: _script(READINGS, filled),
        TRIALS: _csv(_trials(analysis)),
        TLX: None if asked is None else _csv(_questionnaires(asked)),
        METRICS: None if data.metrics is None else _csv(_metrics(data.metrics)),
        RANKINGS: None,
        FORMS: None,
        DRAWN: _samples(
            drawn, lambda count, draws: operator_weights(count, seed=seed, draws=draws)[1:]
        ),
        SIGNS: _samples(of_rho, lambda count, draws: operator_signs(count, seed=seed, draws=draws)),
    }
    if fields := usable_fields(data.forms, data.plan.forms if data.plan else ()):
        answers = list(_answers(data, fields))
        texts[FORMS] = csv_text(list(answers[0]), answers)
    if data.ranking:
        texts[RANKINGS] = csv_text(["operator", "retargeter", "rank"], _rankings(data.ranking))
    for name, text in texts.items():
        if text is None:
            (folder / name).unlink(missing_ok=True)
            continue
        with atomic_write(folder / name) as file:
            file.write(text.encode("utf-8"))
    return [name for name, text in texts.items() if text is not None]


def _script(name: str, filled: Mapping[str, str]) -> str:
    script = files("smooth_operator.study.analysis").joinpath(name).read_text("utf-8")
    for mark, text in filled.items():
        script = script.replace(mark, text)
    return script


def _named(numbers: Mapping[str, float]) -> str:
    """Elements of a vector of R with names."""
    return ", ".join(f"{json.dumps(name)} = {value!r}" for name, value in numbers.items())


def _limits(analysis: Analysis) -> dict[str, float]:
    """Up to which trials of each task are followed [s]."""
    found: dict[str, float] = {}
    for reading in analysis.readings.time_to_success.values():
        if not isinstance(reading, Refused):
            found |= reading.limits
    return found


def _trials(analysis: Analysis) -> dict[str, np.ndarray]:
    rows, second = analysis.data.trials, _second_scores(analysis.data)
    return {
        "operator": rows.operator,
        "task": rows.task,
        "retargeter": rows.retargeter,
        "block": rows.block,
        "trial_in_block": rows.trial_in_block,
        "trial_global": rows.trial_global,
        "score": rows.score,
        "success": rows.success.astype(int),
        "time_s": rows.time,
        "duration_s": rows.duration,
        "line": rows.line,
        **({} if second is None else {"second_score": second}),
    }


def _second_scores(data: StudyData) -> np.ndarray | None:
    """Of each trial, by the second rater; NaN where there is none."""
    second, trials = data.second_ratings, data.trials
    if second is None:
        return None
    columns = (second.operator, second.task, second.block, second.trial_in_block)
    given = dict(zip(zip(*columns, strict=True), second.score, strict=True))
    keys = zip(trials.operator, trials.task, trials.block, trials.trial_in_block, strict=True)
    return np.array([given.get(key, np.nan) for key in keys], float)


def _questionnaires(rows: Questionnaires) -> dict[str, np.ndarray]:
    return {
        "operator": rows.operator,
        "task": rows.task,
        "retargeter": rows.retargeter,
        "block": rows.block,
        "point": rows.point,
        "index": rows.index,
        "workload": rows.workload,
    }


def _metrics(rows: SimulationMetrics) -> dict[str, np.ndarray]:
    names = {"operator": rows.operator, "retargeter": rows.retargeter}
    return names | {name: rows.values[:, j] for j, name in enumerate(rows.names)}


def _rankings(ranking: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
    return [
        {"operator": who, "retargeter": name, "rank": place}
        for who, order in ranking.items()
        for place, name in enumerate(order, 1)
    ]


def _answers(data: StudyData, fields: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Answers to forms, as far as they are covariates."""
    for name in fields:
        answers, kind = field_answers(data.forms, name)
        for who, answer in answers.items():
            yield {"operator": who, "field": name, "kind": kind, "answer": answer}


def _samples(sizes: Mapping[int, int], draw: Callable[[int, int], np.ndarray]) -> str | None:
    """Samples of each number of operators, a row each; further columns than operators are empty."""
    most = max(sizes, default=0)
    rows = [
        {"operators": count, "draw": number} | {str(j): x for j, x in enumerate(sample, 1)}
        for count, draws in sorted(sizes.items())
        for number, sample in enumerate(draw(count, draws).astype(int).tolist(), 1)
    ]
    columns = ["operators", "draw", *(str(j) for j in range(1, most + 1))]
    return csv_text(columns, rows) if rows else None


def _sizes(analysis: Analysis) -> tuple[dict[int, int], dict[int, int]]:
    """Operators that readings drew, and how many samples; and of correlations alone."""
    of_rho = {
        int(entry["operators"]): spearman.DRAWS
        for entry in analysis.spearman.values()
        if "rho" in entry
    }
    readings = analysis.readings
    drew = (*readings.time_to_success.values(), readings.second_rater, readings.preference)
    return {
        one.operators: DRAWS for one in drew if one is not None and not isinstance(one, Refused)
    } | of_rho, of_rho


def _csv(columns: dict[str, np.ndarray]) -> str:
    values = [column.tolist() for column in columns.values()]
    rows: list[dict[str, Any]] = [
        {name: None if cell != cell else cell for name, cell in zip(columns, row, strict=True)}
        for row in zip(*values, strict=True)
    ]
    return csv_text(list(columns), rows)
