"""Files of a study: CSV tables recognised by their columns, a folder of them, or one JSON file.

Next to ``trials.csv`` an export's ``study.json`` gives what tables don't hold: plan, participants.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.errors import DocumentError, StudyError, brief, listed
from smooth_operator.formats.csv_table import plain_cell
from smooth_operator.io.documents import parse_json, read_text
from smooth_operator.study.data.checked_tables import (
    METRIC_COLUMNS,
    QUESTIONNAIRE_COLUMNS,
    TRIAL_COLUMNS,
    Rows,
    make_metrics,
    make_questionnaires,
    make_trials,
)
from smooth_operator.study.data.rows import Questionnaires, SimulationMetrics, StudyData, Trials
from smooth_operator.study.data.study_facts import study_facts

NAMES: Final = ("trials.csv", "tlx.csv", "sim_metrics.csv")
"""Names of the tables in a folder."""
EXPORT: Final = "study.json"
"""What an export calls its JSON file."""
KEYS: Final = ("trials", "questionnaires", "simulation_metrics")
"""Names of the tables in a JSON file."""

_KINDS: Final = {
    "trials": frozenset(TRIAL_COLUMNS),
    "questionnaires": frozenset(QUESTIONNAIRE_COLUMNS),
}
_SIMULATED: Final = "simulation.json"
"""Of virtual operators: their plan is in it."""
_TELLING: Final = {"score": "trials", "trial_in_block": "trials", "point": "questionnaires"}
"""Columns that identify a table although others are missing."""


def read_study(paths: Sequence[str | Path], *, texts: Sequence[tuple[str, str]] = ()) -> StudyData:
    """Reads a study.

    Args:
        paths: a folder with trials.csv and, where there are, tlx.csv and sim_metrics.csv; or such
            tables under any name and in any order; or one JSON file.
        texts: (name, content) of JSON that is in no file, as a store exports it.

    Returns:
        The data, each value checked; with plan and participants, where a JSON file has them.

    Raises:
        StudyError: no trials among the files, two tables of a kind, a column is missing, or values
            are not what their columns hold; says which by row and column.
    """
    files = [file for path in paths for file in _files(Path(path))]
    tables: dict[str, tuple[str, Rows, str]] = {}
    facts: dict[str, Any] = {}
    read: list[tuple[str, list[tuple[str, Rows, str]]]] = []
    for name, text in texts:
        content = _content(name, text)
        facts |= study_facts(content, name)
        read.append((name, _from_json(name, content)))
    for file in files:
        text = _text(file)
        if file.suffix.lower() == ".json" or text.lstrip().startswith("{"):
            content = _content(file.name, text)
            facts |= study_facts(content, file.name)
            read.append((file.name, _from_json(file.name, content)))
        else:
            read.append((file.name, [_from_csv(file.name, text)]))
    for file in () if facts else _facts_files(files):
        facts |= study_facts(_plan_in(_content(file.name, _text(file))), file.name)
    for name, found in read:
        for kind, rows, unit in found:
            if kind in tables:
                raise StudyError(f"{name} and {tables[kind][0]} both hold {kind}; give one")
            tables[kind] = (name, rows, unit)
    if "trials" not in tables:
        raise StudyError(
            f"no trials in {', '.join(name for name, _ in read) or 'no files'}: expected a "
            f"table with the columns {', '.join(TRIAL_COLUMNS)}"
        )
    trials, notes = make_trials(*tables["trials"])
    data = StudyData(trials, notes=notes, sources=tuple(name for name, _ in read), **facts)
    if "questionnaires" in tables:
        questionnaires, more = make_questionnaires(*tables["questionnaires"])
        data = replace(data, questionnaires=questionnaires, notes=data.notes + more)
    if "simulation_metrics" in tables:
        data = replace(data, metrics=make_metrics(*tables["simulation_metrics"]))
    notes = _strange_names(data, {kind: table[0] for kind, table in tables.items()})
    return replace(data, notes=data.notes + notes)


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        found = [path / name for name in NAMES if (path / name).is_file()]
        if path / NAMES[0] not in found and (path / EXPORT).is_file():
            found = [path / EXPORT, *(file for file in found if file.name == NAMES[2])]
        if not found:
            raise StudyError(
                f"the folder {str(path)!r} holds no study: expected {', '.join(NAMES[:-1])} and, "
                f"if there is one, {NAMES[-1]}"
            )
        return found
    if not path.is_file():
        raise StudyError(f"no such file: {str(path)!r}; expected tables (.csv), JSON, or a folder")
    return [path]


def _facts_files(files: Sequence[Path]) -> list[Path]:
    """The file next to ``trials.csv`` that has the plan."""
    for file in files:
        if file.name == NAMES[0]:
            for name in (EXPORT, _SIMULATED):
                if file.with_name(name).is_file():
                    return [file.with_name(name)]
    return []


def _plan_in(content: Mapping[str, Any]) -> Mapping[str, Any]:
    return {"study": content["plan"]} if "plan" in content else content


def _text(file: Path) -> str:
    try:
        return read_text(file)
    except DocumentError as error:
        raise StudyError(f"{file.name}: {error}; expected a table (.csv) or JSON") from None
    except OSError as error:
        raise StudyError(f"can't read {str(file)!r}: {error.strerror or error}") from error


def csv_rows(file: Path) -> Rows:
    """Numbered rows of a table by column; one at least.

    Raises:
        StudyError: there is no such file, or it is no table.
    """
    if not file.is_file():
        raise StudyError(f"no such file: {str(file)!r}; expected a table (.csv)")
    rows = _csv(file.name, _text(file))[1]
    if not rows:
        raise StudyError(f"{file.name} holds a header and no rows")
    return rows


def _from_csv(name: str, text: str) -> tuple[str, Rows, str]:
    header, rows = _csv(name, text)
    kind = _kind(name, header)
    if not rows:
        raise StudyError(f"{name} holds a header and no rows")
    return kind, rows, "row"


def _csv(name: str, text: str) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    first = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=first.count)
    reader = csv.reader(io.StringIO(text), delimiter=delimiter)
    try:
        header = [plain_cell(word.strip()) for word in next(reader, [])]
        rows: list[tuple[int, dict[str, str]]] = []
        for values in reader:
            if not any(value.strip() for value in values):
                continue
            if len(values) != len(header):
                raise StudyError(
                    f"{name} can't be used:\n  row {reader.line_num}: expected {len(header)} "
                    f"fields as in the header, came {len(values)}"
                )
            cells = map(plain_cell, values)
            rows.append((reader.line_num, dict(zip(header, cells, strict=True))))
    except csv.Error as error:
        raise StudyError(f"{name}, row {reader.line_num}: no readable CSV: {error}") from None
    twice = sorted(word for word, count in Counter(header).items() if count > 1)
    if twice:
        raise StudyError(f"{name}: the column {brief(twice[0])} is there twice; keep one")
    return header, rows


def _kind(name: str, header: Sequence[str]) -> str:
    columns = set(header)
    for kind, needed in _KINDS.items():
        if needed <= columns:
            return kind
    for column, kind in _TELLING.items():
        if column in columns:
            missing = [word for word in _KINDS[kind] if word not in columns]
            raise StudyError(
                f"{name} looks like a table of {kind}, but has no column "
                f"{', '.join(repr(word) for word in sorted(missing))}; it has {listed(header)}"
            )
    if set(METRIC_COLUMNS) < columns and "task" not in columns:
        return "simulation_metrics"
    raise StudyError(
        f"{name} is no table of a study. Expected the columns {', '.join(TRIAL_COLUMNS)} (trials), "
        f"{', '.join(QUESTIONNAIRE_COLUMNS)} (questionnaires), or {', '.join(METRIC_COLUMNS)} and "
        f"metrics; came {listed(header) or 'nothing'}"
    )


def _content(name: str, text: str) -> Mapping[str, Any]:
    try:
        content = parse_json(text)
    except DocumentError as error:
        raise StudyError(f"{name}: no readable JSON: {error}") from None
    return content if isinstance(content, Mapping) else {}


def _from_json(name: str, content: Mapping[str, Any]) -> list[tuple[str, Rows, str]]:
    if not isinstance(content.get("trials"), list):
        raise StudyError(f"{name}: expected an object with a list of trials ({', '.join(KEYS)})")
    needed = {**{k: sorted(v) for k, v in _KINDS.items()}, KEYS[2]: list(METRIC_COLUMNS)}
    found: list[tuple[str, Rows, str]] = []
    for key in KEYS:
        entries = content.get(key)
        if not entries:
            continue
        if not isinstance(entries, list) or not all(isinstance(e, Mapping) for e in entries):
            raise StudyError(f"{name}: {key!r} must be a list of objects")
        rows: list[tuple[int, Mapping[str, Any]]] = []
        columns = list(dict.fromkeys(column for entry in entries for column in entry))
        for number, entry in enumerate(entries, 1):
            lacking = [column for column in needed[key] if column not in entry]
            if lacking and lacking != ["time_s"]:
                raise StudyError(f"{name}: entry {number} of {key!r} has no {lacking[0]!r}")
            wanted = dict.fromkeys([*needed[key], *columns])
            rows.append((number, {**wanted, **entry}))
        found.append((key, rows, f"{key} entry"))
    return found


def _strange_names(data: StudyData, files: Mapping[str, str]) -> tuple[str, ...]:
    """Names in other tables that no trial has: a typing error would go unseen."""
    others: list[tuple[str, Questionnaires | SimulationMetrics]] = []
    if data.questionnaires is not None:
        others.append(("questionnaires", data.questionnaires))
    if data.metrics is not None:
        others.append(("simulation_metrics", data.metrics))
    notes = []
    for kind, table in others:
        for column in ("operator", "task", "retargeter"):
            if not hasattr(table, column):
                continue
            known = _distinct(data.trials, column)
            strange = [word for word in _distinct(table, column) if word not in known]
            if strange:
                more = f" and {len(strange) - 5} more" if len(strange) > 5 else ""
                notes.append(
                    f"{files[kind]}, column {column}: {listed(strange[:5])}{more} not in "
                    f"{files['trials']}; a typing error?"
                )
    return tuple(notes)


def _distinct(table: Trials | Questionnaires | SimulationMetrics, column: str) -> list[str]:
    return [str(word) for word in np.unique(getattr(table, column))]
