"""Reads the data of a study from tables, JSON files or folders; lists errors by row and column."""

from __future__ import annotations

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from smooth_operator.errors import DocumentError, StudyError, brief, listed
from smooth_operator.formats.csv_table import plain_cell
from smooth_operator.io.documents import parse_json
from smooth_operator.io.plain_files import read_text
from smooth_operator_study.data.rows import (
    Flow,
    StudyData,
    Withdrawal,
    questionnaires_table,
    trials_table,
)
from smooth_operator_study.design.plan import Plan
from smooth_operator_study.design.plan_file import plan_of
from smooth_operator_study.design.protocol import POINTS, SCORES
from smooth_operator_study.store.export import QUESTIONNAIRE_COLUMNS, TRIAL_COLUMNS, study_json
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES
from smooth_operator_study.store.study_store import FILE, open_study

_MISSING = frozenset({"", "na", "n/a", "nan", "none", "null"})
_SHOWN = 8
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_MOST_COUNT = 10**9
"""Largest accepted block or trial number, so that whole numbers of a table fit into 64 bits."""


@dataclass
class Checked:
    """Rows of one table, and all of their problems.

    Attributes:
        kind: kind of table, one of ``KEYS``.
        name: name of the file.
        rows: number of each row, and its values by column.
        unit: unit of these numbers: "row" of a file with a header in row 1, or "entry".
        problems: problems so far.
    """

    kind: str
    name: str
    rows: Sequence[tuple[int, Mapping[str, Any]]]
    unit: str = "row"
    problems: list[str] = field(default_factory=list)

    def complain(self, number: int, column: str, text: str) -> None:
        """Adds a problem of one value."""
        self.problems.append(f"{self.unit} {number}, column {column}: {text}")

    def raise_if_any(self) -> None:
        """Raises StudyError if the table has problems."""
        if not self.problems:
            return
        shown = "\n  ".join(self.problems[:_SHOWN])
        more = len(self.problems) - _SHOWN
        rest = f"\n  and {more} more" if more > 0 else ""
        raise StudyError(f"{self.name} can't be used:\n  {shown}{rest}")

    def words(self, column: str) -> list[str]:
        """Reads names; none is empty, and two differ by more than case."""
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
                    f"{brief(text)} and {brief(spelling)} of {self.unit} {at} differ only in "
                    "case; use the same spelling for both",
                )
            texts.append(text)
        return texts

    def counts(self, column: str) -> list[int]:
        """Reads whole numbers from 1."""
        values = self.numbers(
            column,
            "a whole number of at least 1",
            lambda x: 1 <= x <= _MOST_COUNT and x.is_integer(),
            optional=False,
        )
        return [1 if math.isnan(value) else int(value) for value in values]

    def numbers(
        self, column: str, expected: str, allowed: Any, *, optional: bool = True
    ) -> list[float]:
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
                self.complain(number, column, f"expected {expected}, not {brief(row[column])}")
                value = math.nan
            floats.append(value)
        return floats

    def unique(self, columns: Sequence[str]) -> None:
        """Adds a problem for each row whose values in these columns occur twice."""
        rows_of: dict[tuple[str, ...], int] = {}
        for number, row in self.rows:
            key = tuple(str(row[column]).strip() for column in columns)
            if key in rows_of:
                what = listed(f"{c} {k}" for c, k in zip(columns, key, strict=True))
                self.problems.append(
                    f"{self.unit} {number}: the same {what} as {self.unit} {rows_of[key]}; "
                    "every trial and questionnaire may occur only once"
                )
            rows_of.setdefault(key, number)


def is_missing(value: Any) -> bool:
    """True if a field is empty or contains a word for a missing value."""
    return (
        value is None
        or (isinstance(value, str) and value.strip().lower() in _MISSING)
        or (isinstance(value, float) and math.isnan(value))
    )


def _number(value: Any) -> float | None:
    """Reads a finite number; None if the value is not a finite number."""
    if isinstance(value, bool) or is_missing(value):
        return None
    if isinstance(value, str) and not _NUMBER.fullmatch(value.strip()):
        return None  # Python would take 1_0 for 10
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


METRIC_COLUMNS: Final = ("operator", "retargeter")
"""Columns of metrics, followed by one column for each metric."""


def make_trials(table: Checked) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Makes trials from a table with all of ``TRIAL_COLUMNS``.

    Returns:
        The trials, and notes on their oddities.
    """
    columns = {
        **{column: table.words(column) for column in ("operator", "task", "retargeter")},
        **{column: table.counts(column) for column in ("block", "trial_in_block", "trial_global")},
        "score": table.numbers("score", "0, 0.5 or 1", lambda x: x in SCORES, optional=False),
        "time": table.numbers(
            "time_s", "a time in seconds above 0, or an empty field", lambda x: x > 0
        ),
    }
    table.unique(("operator", "task", "block", "trial_in_block"))
    table.unique(("operator", "task", "trial_global"))
    table.raise_if_any()
    trials, notes = trials_table(columns), []
    untimed = [
        table.rows[i][0] for i in np.flatnonzero(trials.success & trials.time.isna()).tolist()
    ]
    if untimed:
        shown = ", ".join(str(number) for number in untimed[:8])
        shown += f" and {len(untimed) - 8} more" if len(untimed) > 8 else ""
        plural = "trials have" if len(untimed) > 1 else "trial has"
        notes.append(
            f"{len(untimed)} successful {plural} no time_s and can't enter the analysis of time "
            f"({table.name}, {table.unit} {shown})"
        )
    mixed = trials.groupby(["operator", "task", "block"]).retargeter.nunique()
    if len(mixed := mixed[mixed > 1]):
        operator, task, block = min(mixed.index)
        notes.append(
            f"{len(mixed)} block(s) hold trials of more than one retargeter, the first is block "
            f"{block} of operator {operator} in task {task} ({table.name})"
        )
    return trials, tuple(notes)


def make_questionnaires(table: Checked) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Makes questionnaires from a table with all of ``QUESTIONNAIRE_COLUMNS``.

    Returns:
        The questionnaires, and notes on their oddities.
    """
    points = []
    for (number, _), word in zip(table.rows, table.words("point"), strict=True):
        if word.lower() not in POINTS:
            table.complain(number, "point", f"expected {', '.join(POINTS)}, not {brief(word)}")
        points.append(POINTS.index(word.lower()) + 1 if word.lower() in POINTS else 1)
    columns = {
        **{column: table.words(column) for column in ("operator", "task", "retargeter")},
        "block": table.counts("block"),
        "point": points,
        **{
            scale: table.numbers(scale, "0 to 100, or an empty field", lambda x: 0 <= x <= 100)
            for scale in SCALE_NAMES
        },
    }
    table.unique(("operator", "task", "block", "point"))
    table.raise_if_any()
    filled = questionnaires_table(columns)
    missing = int(filled.workload.isna().sum())
    notes = []
    if missing:
        notes.append(
            f"{missing} of {len(filled)} questionnaires have a missing answer and can't "
            f"enter the analysis of workload ({table.name})"
        )
    return filled, tuple(notes)


def make_metrics(table: Checked) -> pd.DataFrame:
    """Makes simulation metrics from a table."""
    names = [column for column in table.rows[0][1] if column not in METRIC_COLUMNS]
    if not names:
        table.problems.append("expected operator, retargeter, and one column per metric")
    columns: dict[str, Any] = {column: table.words(column) for column in METRIC_COLUMNS}
    columns |= {
        one: table.numbers(one, "a number, or an empty field", lambda x: True) for one in names
    }
    table.unique(METRIC_COLUMNS)
    table.raise_if_any()
    return pd.DataFrame(columns)


_START: Final = "block_started"
"""Kind of the event with which an operator starts."""


def study_facts(content: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Reads plan, orders, flow and ranking of a study, by their names in ``StudyData``.

    Args:
        content: content of ``study.json``.
        name: name of the file, for messages.

    Returns:
        The values; empty if the file has no plan.
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
"""Name of the file that contains the plan of virtual operators."""
_TELLING: Final = {"score": "trials", "trial_in_block": "trials", "point": "questionnaires"}
"""Columns that identify a table in which others are missing."""


def read_study(paths: Sequence[str | Path]) -> StudyData:
    """Reads the data of a study.

    Args:
        paths: folder or database of a study that was run; or folder with trials.csv and, if they
            exist, tlx.csv and sim_metrics.csv; or such tables under any name and in any order; or
            one JSON file. Next to trials.csv and to a database, sim_metrics.csv is read too.

    Returns:
        The data with each value checked, and with plan and participants if a database or a JSON
        file has them.

    Raises:
        StudyError: there are no trials, two tables of a kind, a column is missing, or a value does
            not fit its column; lists problems by row and column.
    """
    files = [file for path in paths for file in _files(Path(path))]
    if all(file.name != NAMES[2] for file in files):
        homes = [file for file in files if _is_store(file) or file.name == NAMES[0]]
        metrics = [(home if home.is_dir() else home.parent) / NAMES[2] for home in homes]
        files += [file for file in metrics if file.is_file()]
    tables: dict[str, Checked] = {}
    facts: dict[str, Any] = {}
    for file in files:
        text = None if _is_store(file) else _text(file)
        if text is not None and file.suffix.lower() != ".json" and text.lstrip()[:1] != "{":
            parts = [_from_csv(file.name, text)]
        else:
            content = _stored(file) if text is None else _content(file.name, text)
            facts |= study_facts(content, file.name)
            parts = _from_json(file.name, content)
        for part in parts:
            if part.kind in tables:
                first = tables[part.kind].name
                raise StudyError(
                    f"{file.name} and {first} both contain {part.kind}; use only one of them"
                )
            tables[part.kind] = part
    for file in () if facts else _facts_files(files):
        facts |= study_facts(_plan_in(_content(file.name, _text(file))), file.name)
    names = tuple(file.name for file in files)
    if "trials" not in tables:
        if any(map(_is_store, files)):
            raise StudyError(
                f"no trial of {', '.join(names)} is scored yet: run the trials with "
                "smooth-operator study run"
            )
        raise StudyError(
            f"no trials in {', '.join(names) or 'no files'}: expected a table with the columns "
            f"{', '.join(TRIAL_COLUMNS)}"
        )
    trials, notes = make_trials(tables["trials"])
    data = StudyData(trials, notes=notes, sources=names, **facts)
    if "questionnaires" in tables:
        questionnaires, more = make_questionnaires(tables["questionnaires"])
        data = replace(data, questionnaires=questionnaires, notes=data.notes + more)
    if "simulation_metrics" in tables:
        data = replace(data, metrics=make_metrics(tables["simulation_metrics"]))
    return replace(data, notes=data.notes + _strange_names(data, tables))


def _files(path: Path) -> list[Path]:
    if _is_store(path):
        return [path]
    if path.is_dir():
        files = [path / name for name in NAMES if (path / name).is_file()]
        if path / NAMES[0] not in files and (path / EXPORT).is_file():
            files = [path / EXPORT, *(file for file in files if file.name == NAMES[2])]
        if not files:
            raise StudyError(
                f"the folder {str(path)!r} contains no study: expected "
                f"{', '.join(NAMES[:-1])} and, if there is one, {NAMES[-1]}"
            )
        return files
    if not path.is_file():
        raise StudyError(
            f"no such file: {str(path)!r}; expected the folder of a study, tables (.csv) or JSON"
        )
    return [path]


def _is_store(path: Path) -> bool:
    """True for the database of a study, or the folder of one."""
    if path.is_dir():
        return (path / FILE).is_file()
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(6) == b"SQLite"


def _stored(path: Path) -> Mapping[str, Any]:
    """Data of a database, as ``study export`` writes it."""
    with open_study(path) as store:
        return study_json(store)


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


def _from_csv(name: str, text: str) -> Checked:
    header, rows = _csv(name, text)
    kind = _kind(name, header)
    if not rows:
        raise StudyError(f"{name} has a header but no rows")
    return Checked(kind, name, rows)


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
                    f"fields as in the header, not {len(values)}"
                )
            cells = map(plain_cell, values)
            rows.append((reader.line_num, dict(zip(header, cells, strict=True))))
    except csv.Error as error:
        raise StudyError(f"{name}, row {reader.line_num}: not readable as CSV: {error}") from None
    twice = sorted(word for word, count in Counter(header).items() if count > 1)
    if twice:
        raise StudyError(f"{name}: the column {brief(twice[0])} occurs twice; keep one")
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
        f"{name} is not a table of a study. Expected the columns {', '.join(TRIAL_COLUMNS)} "
        f"(trials), {', '.join(QUESTIONNAIRE_COLUMNS)} (questionnaires), or "
        f"{', '.join(METRIC_COLUMNS)} and metrics; found {listed(header) or 'nothing'}"
    )


def _content(name: str, text: str) -> Mapping[str, Any]:
    try:
        content = parse_json(text)
    except DocumentError as error:
        raise StudyError(f"{name}: not readable as JSON: {error}") from None
    return content if isinstance(content, Mapping) else {}


def _from_json(name: str, content: Mapping[str, Any]) -> list[Checked]:
    if not isinstance(content.get("trials"), list):
        raise StudyError(f"{name}: expected an object with a list of trials ({', '.join(KEYS)})")
    needed = {**{k: sorted(v) for k, v in _KINDS.items()}, KEYS[2]: list(METRIC_COLUMNS)}
    tables = []
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
        tables.append(Checked(key, name, rows, f"{key} entry"))
    return tables


def _strange_names(data: StudyData, tables: Mapping[str, Checked]) -> tuple[str, ...]:
    """Notes on names in other tables that no trial has, which may be typing errors."""
    notes = []
    for kind, table in zip(KEYS[1:], (data.questionnaires, data.metrics), strict=True):
        for column in ("operator", "task", "retargeter"):
            if table is None or column not in table:
                continue
            strange = sorted({*table[column]} - {*data.trials[column]})
            if strange:
                more = f" and {len(strange) - 5} more" if len(strange) > 5 else ""
                notes.append(
                    f"{tables[kind].name}, column {column}: {listed(strange[:5])}{more} not "
                    f"in {tables['trials'].name}; check the spelling"
                )
    return tuple(notes)
