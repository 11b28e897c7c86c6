"""Readers of a study: tables, JSON files, folders."""

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
from smooth_operator.study.data.rows import (
    Flow,
    Questionnaires,
    SimulationMetrics,
    StudyData,
    Trials,
    Withdrawal,
)
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import plan_of

_START: Final = "block_started"
"""Kind of the event with which an operator starts."""


def study_facts(content: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Reads plan, orders, flow and ranking of a study, by their names in ``StudyData``.

    Args:
        content: content of ``study.json``.
        name: name of the file, for messages.

    Returns:
        The values; empty if the file has no plan.

    Raises:
        StudyError: the plan is invalid, or the participants are not as an export writes them.
    """
    table = content.get("study")
    if not isinstance(table, Mapping) or "conditions" not in table:
        return {}
    plan = plan_of(dict(table), f"{name}, study")
    operators = content.get("operators", [])
    if not isinstance(operators, list) or not all(isinstance(one, Mapping) for one in operators):
        raise StudyError(f"{name}: 'operators' must be a list of objects, as study export writes")
    planned = {"plan": plan.protocol, "orders": plan.orders}
    if not operators:  # a plan alone
        return planned
    try:
        return planned | {
            "flow": _flow(plan, operators, content.get("trials", [])),
            "ranking": {
                str(one["operator"]): tuple(map(str, one["ranking"]))
                for one in operators
                if one.get("ranking")
            },
        }
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise StudyError(
            f"{name}: the participants are not as study export writes them: "
            f"{type(error).__name__}: {error}"
        ) from None


def _flow(plan: Plan, operators: list[Mapping[str, Any]], trials: Any) -> Flow:
    codes = tuple(str(one["operator"]) for one in operators)
    withdrawn = {
        str(one["operator"]): Withdrawal(
            bool(left["keep"]), str(left.get("reason") or ""), str(left.get("at") or "")
        )
        for one in operators
        if (left := one.get("withdrawn"))
    }
    names = plan.protocol.condition_names
    voids = Counter(entry["retargeter"] for one in operators for entry in one.get("voided") or ())
    undone: Counter[str] = Counter()
    for one in operators:
        undone.update(one.get("undone", {}))
    amended = Counter(str(row["retargeter"]) for row in trials if row.get("amended"))
    return Flow(
        logged=True,
        planned=plan.protocol.operators,
        enrolled=codes,
        started=tuple(
            str(one["operator"])
            for one in operators
            if any(event["kind"] == _START for event in one.get("events", ()))
        ),
        completed=tuple(
            str(o["operator"]) for o in operators if o.get("done") and not o.get("ended_early")
        ),
        withdrawn=withdrawn,
        voids={name: voids[name] for name in names},
        undone={name: undone[name] for name in names},
        amended={name: amended[name] for name in names},
        pauses=sum(len(one.get("pauses") or ()) for one in operators),
        recalibrations=sum(len(one.get("recalibrations") or ()) for one in operators),
        ended_early=sum(len(one.get("ended_early") or ()) for one in operators),
    )


NAMES: Final = ("trials.csv", "tlx.csv", "sim_metrics.csv")
"""Names of the tables in a folder."""
EXPORT: Final = "study.json"
"""Name of the JSON file of an export."""
KEYS: Final = ("trials", "questionnaires", "simulation_metrics")
"""Names of the tables in a JSON file."""
_KINDS: Final = {
    "trials": frozenset(TRIAL_COLUMNS),
    "questionnaires": frozenset(QUESTIONNAIRE_COLUMNS),
}
_SIMULATED: Final = "simulation.json"
"""Name of the file of virtual operators that holds their plan."""
_TELLING: Final = {"score": "trials", "trial_in_block": "trials", "point": "questionnaires"}
"""Columns that identify a table in which others are missing."""


def read_study(
    paths: Sequence[str | Path], *, exports: Mapping[str, Mapping[str, Any]] | None = None
) -> StudyData:
    """Reads the data of a study.

    Args:
        paths: folder with trials.csv and, if they exist, tlx.csv and sim_metrics.csv; or such
            tables under any name and in any order; or one JSON file.
        exports: name -> content of stores, as ``study_json`` returns it.

    Returns:
        The data with each value checked, and with plan and participants if a JSON file has them.

    Raises:
        StudyError: there are no trials, two tables of a kind, a column is missing, or a value does
            not fit its column; lists problems by row and column.
    """
    files = [file for path in paths for file in _files(Path(path))]
    tables: dict[str, tuple[str, Rows, str]] = {}
    facts: dict[str, Any] = {}
    read: list[tuple[str, list[tuple[str, Rows, str]]]] = []
    for name, content in (exports or {}).items():
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
    for name, contents in read:
        for kind, rows, unit in contents:
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
        files = [path / name for name in NAMES if (path / name).is_file()]
        if path / NAMES[0] not in files and (path / EXPORT).is_file():
            files = [path / EXPORT, *(file for file in files if file.name == NAMES[2])]
        if not files:
            raise StudyError(
                f"the folder {str(path)!r} holds no study: expected {', '.join(NAMES[:-1])} and, "
                f"if there is one, {NAMES[-1]}"
            )
        return files
    if not path.is_file():
        raise StudyError(f"no such file: {str(path)!r}; expected tables (.csv), JSON, or a folder")
    return [path]


def _facts_files(files: Sequence[Path]) -> list[Path]:
    """The file next to ``trials.csv`` that holds the plan."""
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
    tables: list[tuple[str, Rows, str]] = []
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
            required = dict.fromkeys([*needed[key], *columns])
            rows.append((number, {**required, **entry}))
        tables.append((key, rows, f"{key} entry"))
    return tables


def _strange_names(data: StudyData, files: Mapping[str, str]) -> tuple[str, ...]:
    """Notes on names in other tables that no trial has, which may be typing errors."""
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
            names = _distinct(data.trials, column)
            strange = [word for word in _distinct(table, column) if word not in names]
            if strange:
                more = f" and {len(strange) - 5} more" if len(strange) > 5 else ""
                notes.append(
                    f"{files[kind]}, column {column}: {listed(strange[:5])}{more} not in "
                    f"{files['trials']}; a typing error?"
                )
    return tuple(notes)


def _distinct(table: Trials | Questionnaires | SimulationMetrics, column: str) -> list[str]:
    return [str(word) for word in np.unique(getattr(table, column))]
