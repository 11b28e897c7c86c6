"""Reads and writes a plan as ``study.toml``, and its schedule and pre-registration."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import StudyError
from smooth_operator.formats.toml_writer import toml_key, toml_value
from smooth_operator.io.entries import Entries, read_entries
from smooth_operator.reporting.report_page import templates
from smooth_operator.version import __version__
from smooth_operator_study.design.forms import KINDS
from smooth_operator_study.design.plan import (
    Enrolment,
    Orders,
    Plan,
    balanced_rows,
    make_plan,
    schedule_csv,
)
from smooth_operator_study.design.protocol import (
    POOLED,
    PRIMARY,
    Condition,
    Protocol,
    Task,
)
from smooth_operator_study.records import record

FORMAT: Final = 1
"""Version of the format."""
NAME: Final = "study.toml"
"""Name of the file in the folder of a study."""
EARLIER: Final = "PREREGISTRATION.before.md"
"""Name of the pre-registration of an earlier plan."""
_MOST_BYTES: Final = 4_000_000
_COMMENTS: Final[Mapping[type, Mapping[str, str]]] = {
    Protocol: {
        "name": "",
        "baseline": "condition with which the others are compared",
        "operators": "",
        "familiarisation_s": "free movement before a block",
        "questionnaires": "NASA-TLX, after these trials",
        "resets": "resets of the object, in a trial",
        "reset_cap": "best score after that",
        "break_s": "breaks, offered between blocks",
        "break_every": "blocks between two breaks",
        "task_order": "",
        "seed": "",
        "rate_hz": "commands per second, in every condition",
        "primary": "primary endpoint; all others are exploratory",
        "tlx_language": "wording of NASA-TLX",
    },
    Condition: {"method": "", "label": "information that operators may see"},
    Task: {"trials": "in a block", "rubric": ""},
}
"""Entries that are written even if they have their default value, and their comments."""


def read_plan(path: str | Path) -> Plan:
    """Reads a plan; draws orders and labels that the file leaves out.

    Args:
        path: the file, or the folder that holds ``study.toml``.
    """
    path = Path(path)
    path = path / NAME if path.is_dir() else path
    hint = f"; smooth-operator study new {path.parent if path.name == NAME else path} creates one"
    return _plan(read_entries(path, "plan", StudyError, most_bytes=_MOST_BYTES, hint=hint))


def plan_of(table: dict[str, Any], file: str) -> Plan:
    """Makes a plan from the content of its file.

    Args:
        table: table that TOML or JSON gives.
        file: name of the file for messages.
    """
    return _plan(Entries(file, table, StudyError))


def write_plan(plan: Plan, path: str | Path) -> Path:
    """Writes ``study.toml`` atomically.

    Args:
        plan: plan of the study.
        path: file, or folder of ``study.toml``.

    Returns:
        The file.
    """
    path = Path(path)
    if path.is_dir():
        path = path / NAME
    with atomic_write(path) as file:
        file.write(plan_text(plan).encode("utf-8"))
    return path


def plan_text(plan: Plan) -> str:
    """Returns the content of ``study.toml``."""
    return "\n".join(_lines(plan)) + "\n"


def plan_table(plan: Plan) -> dict[str, Any]:
    """Returns the plan as a table, which ``plan_of`` reads."""
    return tomllib.loads(plan_text(plan))


def _plan(entries: Entries) -> Plan:
    entries.check_format(FORMAT)
    with entries.name_file():
        protocol = _protocol(entries)
        if "orders" not in entries.names:
            if "enrolled" in entries.names:
                raise entries.error("enrolled", "rows need [orders]; add them")
            return make_plan(protocol)
        return Plan(protocol, _orders(entries), _enrolled(entries))


def _protocol(entries: Entries) -> Protocol:
    conditions, tasks = entries.table("conditions"), entries.table("tasks")
    # A file with orders was written by this program: without an endpoint none was planned.
    primary = entries.text("primary", "" if "orders" in entries.names else PRIMARY)
    return record(
        Protocol,
        entries,
        ("format", "primary", "conditions", "tasks", "orders", "enrolled"),
        conditions=tuple(
            record(Condition, conditions.table(name), name=name) for name in conditions.names
        ),
        tasks=tuple(
            record(
                Task,
                table := tasks.table(name),
                ("trials",),
                name=name,
                trials=table.whole("trials"),
            )
            for name in tasks.names
        ),
        primary=primary,
    )


def _orders(entries: Entries) -> Orders:
    orders = entries.table("orders")
    for number, name in enumerate(orders.names, 1):
        if name != str(number):
            raise orders.error(name, f"rows are numbered 1, 2, ...; expected {number} here")
    return tuple(tuple(orders.texts(name)) for name in orders.names)


def _enrolled(entries: Entries) -> tuple[Enrolment, ...]:
    operators = entries.table("enrolled", {})
    tables = {code: operators.table(code) for code in operators.names}
    return tuple(
        Enrolment(code, {task: rows.whole(task) - 1 for task in rows.names})
        for code, rows in tables.items()
    )


def _lines(plan: Plan) -> Iterator[str]:
    protocol = plan.protocol
    yield "# A user study. Do not change names and rows of operators who have begun."
    yield f"format = {FORMAT}"
    yield from _settings(protocol, ("conditions", "tasks", "forms", "margins"))
    if protocol.margins:
        yield "\n[margins]  # of equivalence: share of successes, seconds, points of workload"
        for name, margin in protocol.margins.items():
            yield f"{name} = {toml_value(float(margin))}"
    for table, items in (("conditions", protocol.conditions), ("tasks", protocol.tasks)):
        for item in items:
            yield f"\n[{table}.{toml_key(item.name)}]"
            yield from _settings(item, ("name",))
    if protocol.forms:
        yield "\n# Forms on the operator's page, before the first block or after the last."
        yield f"# Kinds of fields: {', '.join(KINDS)}."
    for form in protocol.forms:
        yield "[[forms]]"
        yield from _settings(form)
    yield "\n[orders]  # a balanced Latin square: conditions of the first block, the second, ..."
    for number, order in enumerate(plan.orders, 1):
        yield f"{number} = {toml_value(order)}"
    yield "\n[enrolled]  # operator = { task = row of orders }, tasks in the order they are done"
    for one in plan.enrolled:
        rows = ", ".join(f"{toml_key(task)} = {row + 1}" for task, row in one.rows.items())
        yield f"{toml_key(one.code)} = {{ {rows} }}"


def _settings(item: Any, skip: tuple[str, ...] = ()) -> Iterator[str]:
    """Yields lines of TOML for the fields of a dataclass that differ from their default."""
    comments = _COMMENTS.get(type(item), {})
    for f in fields(item):
        value = getattr(item, f.name)
        empty = value is None or value == "" or (value == f.default and f.name not in comments)
        if empty or f.name in skip:
            continue
        value = float(value) if str(f.type).startswith("float") else value
        comment = comments.get(f.name, "")
        yield f"{f.name} = {_toml(value)}" + (f"  # {comment}" if comment else "")


def _toml(value: Any) -> str:
    """Formats a value in TOML; dataclasses are inline tables."""
    if is_dataclass(value):
        return f"{{ {', '.join(_settings(value))} }}"
    if isinstance(value, tuple) and value and is_dataclass(value[0]):
        return "[\n" + "".join(f"  {_toml(one)},\n" for one in value) + "]"
    return toml_value(value)


def write_plan_files(plan: Plan, folder: Path) -> list[Path]:
    """Writes plan and schedule; replaces earlier ones.

    Args:
        plan: plan of the study.
        folder: existing folder.

    Returns:
        The files.
    """
    schedule = folder / "schedule.csv"
    with atomic_write(schedule) as file:
        file.write(schedule_csv(plan).encode("utf-8"))
    return [write_plan(plan, folder / NAME), schedule]


def write_preregistration(plan: Plan, folder: Path) -> Path:
    """Writes ``PREREGISTRATION.md``; an earlier one is renamed to ``EARLIER``."""
    path = folder / PREREGISTRATION
    try:
        if path.is_file():
            path.replace(folder / EARLIER)
    except OSError as error:
        raise output_error(path, error) from error
    with atomic_write(path) as file:
        file.write(preregistration(plan).encode())
    return path


PREREGISTRATION: Final = "PREREGISTRATION.md"
_TITLES: Final = {
    "success": "success rate (fraction of trials that score 0.5 or 1)",
    "time": "completion time of successful trials [s]",
    "tlx": "workload (NASA-TLX, 0 to 100 points)",
}
_UNITS: Final = {
    "success": (100.0, "percentage points"),
    "time": (1.0, "s"),
    "tlx": (1.0, "points"),
}


def preregistration(plan: Plan) -> str:
    """Writes the pre-registration of a plan in Markdown.

    Args:
        plan: the plan before anyone has begun.

    Returns:
        Hypotheses, design, operators, tasks, outcomes, models, corrections, exclusions, stopping
        rule and versions, with [square brackets] for facts that only the authors know.
    """
    protocol = plan.protocol
    outcome, _, scope = protocol.primary.partition("/")
    where = "over all tasks together" if scope == POOLED else f"in task {scope}"
    others = [name for name in protocol.condition_names if name != protocol.baseline]
    template = templates(__package__).get_template("preregistration.md.j2")
    return template.render(
        protocol=protocol,
        version=__version__,
        orders=plan.orders,
        williams=len(plan.orders) == len(balanced_rows(len(protocol.conditions))),
        endpoint=outcome and f"{_TITLES[outcome]}, {where}",
        others=" and ".join(filter(None, [", ".join(others[:-1]), others[-1]])),
        margins=", ".join(
            f"{outcome} {_UNITS[outcome][0] * margin:g} {_UNITS[outcome][1]}"
            for outcome, margin in protocol.margins.items()
        ),
        outcomes=", ".join(
            title for name, title in _TITLES.items() if name != "tlx" or protocol.questionnaires
        ),
        fixed=f"retargeter {'+ task ' if len(protocol.tasks) > 1 else ''}+ t",
    )
