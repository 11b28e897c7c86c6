"""Readers of a study: tables, JSON files, folders; errors are listed by row and column."""

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
from jaxtyping import Float, Int

from smooth_operator.errors import DocumentError, StudyError, brief, listed
from smooth_operator.formats.csv_table import plain_cell
from smooth_operator.io.documents import parse_json, read_text
from smooth_operator.study.data.rows import (
    ITEMS,
    POINTS,
    SCORES,
    SUCCESS,
    Flow,
    Questionnaires,
    SimulationMetrics,
    StudyData,
    Trials,
    Withdrawal,
)
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import plan_of

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
        if exports:
            raise StudyError(
                f"no trial of {', '.join(exports)} is scored yet: smooth-operator study run leads "
                "through them"
            )
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
