"""Plan as ``study.toml``, and the files next to it."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import StudyError
from smooth_operator.io.entries import Entries, read_entries
from smooth_operator.study.design.forms import form_lines, read_forms
from smooth_operator.study.design.plan import (
    Enrolment,
    Orders,
    Plan,
    make_plan,
    schedule_csv,
    schedule_text,
)
from smooth_operator.study.design.preregistration import NAME as PREREGISTRATION
from smooth_operator.study.design.preregistration import preregistration
from smooth_operator.study.design.protocol import (
    POINTS,
    PRIMARY,
    Condition,
    Protocol,
    RubricLine,
    Task,
)

FORMAT: Final = 1
"""Version of the format that this program reads and writes."""


NAME: Final = "study.toml"
"""Name of the file in the folder of a study."""


_MOST_BYTES: Final = 4_000_000


def read_plan(path: str | Path) -> Plan:
    """Reads a plan; draws what the file leaves to be drawn.

    Args:
        path: the file, or the folder that holds ``study.toml``.

    Raises:
        StudyError: there is no such file, it is no TOML, or what it says is no study; the message
            names the entry and what is expected there.
    """
    path = Path(path)
    path = path / NAME if path.is_dir() else path
    hint = f"; smooth-operator study new {path.parent} makes one"
    return _plan(read_entries(path, "plan", StudyError, most_bytes=_MOST_BYTES, hint=hint))


def plan_of(table: dict[str, Any], file: str) -> Plan:
    """A plan from the contents of its file.

    Args:
        table: as TOML or JSON gives it.
        file: as messages call it.

    Raises:
        StudyError: it is no plan; the message names the entry.
    """
    return _plan(Entries(file, table, StudyError))


def write_plan(plan: Plan, path: str | Path) -> Path:
    """Writes ``study.toml``, whole or not at all.

    Args:
        plan: what to write.
        path: the file, or the folder for ``study.toml``.

    Returns:
        The file.

    Raises:
        OutputError: it can't be written.
    """
    path = Path(path)
    if path.is_dir():
        path = path / NAME
    with atomic_write(path) as file:
        file.write(plan_text(plan).encode("utf-8"))
    return path


def plan_text(plan: Plan) -> str:
    """The file as text."""
    return "\n".join(_lines(plan)) + "\n"


def plan_table(plan: Plan) -> dict[str, Any]:
    """The file as a table; ``plan_of`` makes the plan of it again."""
    return tomllib.loads(plan_text(plan))


def _plan(entries: Entries) -> Plan:
    entries.check_format(FORMAT)
    with entries.name_file():
        protocol = _protocol(entries)
        if "orders" not in entries.names:
            if "enrolled" in entries.names:
                raise entries.error("enrolled", "rows mean nothing without [orders]; add those")
            return make_plan(protocol)
        return Plan(protocol, _orders(entries), _enrolled(entries))


def _protocol(entries: Entries) -> Protocol:
    entries.only(
        "format", "name", "baseline", "operators", "familiarisation_s", "break_s",
        "questionnaires", "weights", "resets", "reset_cap", "task_order", "seed", "rate_hz",
        "break_every", "tlx_language", "primary", "margins", "forms", "conditions", "tasks",
        "orders", "enrolled",
    )  # fmt: skip
    conditions = entries.table("conditions")
    tasks = entries.table("tasks")
    margins = entries.table("margins", {})
    # Where a plan was drawn and names no primary endpoint, none was planned.
    primary = entries.text("primary", "" if "orders" in entries.names else PRIMARY)
    points = entries.texts("questionnaires", POINTS)
    for point in points:
        if point not in POINTS:
            raise entries.error("questionnaires", f"expected some of {', '.join(POINTS)}")
    return Protocol(
        name=entries.text("name"),
        conditions=tuple(_condition(conditions.table(name), name) for name in conditions.names),
        tasks=tuple(_task(tasks.table(name), name) for name in tasks.names),
        baseline=entries.text("baseline"),
        operators=entries.whole("operators"),
        familiarisation_s=entries.number("familiarisation_s", 120.0),
        questionnaires=tuple(point for point in POINTS if point in points),
        weights=entries.flag("weights", False),
        resets=entries.whole("resets", 1),
        reset_cap=entries.number("reset_cap", 0.5),
        break_s=entries.number("break_s", 120.0),
        task_order=entries.choice("task_order", ("balanced", "listed"), "balanced"),
        seed=entries.whole("seed", 0),
        rate_hz=entries.number("rate_hz") if "rate_hz" in entries.names else None,
        primary=primary,
        margins={name: margins.number(name) for name in margins.names},
        break_every=entries.whole("break_every", 1),
        forms=read_forms(entries),
        tlx_language=entries.text("tlx_language", ""),
    )


def _condition(entries: Entries, name: str) -> Condition:
    entries.only("method", "preset", "label")
    preset = entries.text("preset", "")
    return Condition(name, entries.text("method", name), preset or None, entries.text("label", ""))


def _task(entries: Entries, name: str) -> Task:
    entries.only("title", "instruction", "trials", "operators", "time_limit_s", "rubric")
    more: dict[str, Any] = {}
    if "operators" in entries.names:
        more["operators"] = entries.whole("operators")
    if "time_limit_s" in entries.names:
        more["time_limit_s"] = entries.number("time_limit_s")
    if "rubric" in entries.names:
        more["rubric"] = tuple(_line(line) for line in entries.tables("rubric"))
    return Task(
        name,
        trials=entries.whole("trials"),
        title=entries.text("title", ""),
        instruction=entries.text("instruction", ""),
        **more,
    )


def _line(entries: Entries) -> RubricLine:
    entries.only("name", "score", "text")
    return RubricLine(entries.text("name"), entries.number("score"), entries.text("text", ""))


def _orders(entries: Entries) -> Orders:
    orders = entries.table("orders")
    for number, name in enumerate(orders.names, 1):
        if name != str(number):
            raise orders.error(name, f"rows are numbered 1, 2, ...; expected {number} here")
    return tuple(tuple(orders.texts(name)) for name in orders.names)


def _enrolled(entries: Entries) -> tuple[Enrolment, ...]:
    if "enrolled" not in entries.names:
        return ()
    operators = entries.table("enrolled")
    enrolled = []
    for code in operators.names:
        rows = operators.table(code)
        enrolled.append(Enrolment(code, {task: rows.whole(task) - 1 for task in rows.names}))
    return tuple(enrolled)


def _lines(plan: Plan) -> Iterator[str]:
    protocol = plan.protocol
    yield "# A user study. Names and rows of those who have begun are not to be changed any more."
    yield f"format = {FORMAT}"
    yield f"name = {_text(protocol.name)}"
    yield f"baseline = {_text(protocol.baseline)}  # the others are compared with it"
    yield f"operators = {protocol.operators}"
    yield f"familiarisation_s = {protocol.familiarisation_s!r}  # free movement before a block"
    yield f"break_s = {protocol.break_s!r}  # offered between blocks"
    if protocol.break_every != 1:
        yield f"break_every = {protocol.break_every}  # blocks between two breaks"
    yield f"questionnaires = {_texts(protocol.questionnaires)}  # NASA-TLX, after these trials"
    yield f"weights = {_flag(protocol.weights)}  # the 15 pairs of NASA-TLX at the end of a block"
    yield f"resets = {protocol.resets}  # of the object, in a trial"
    yield f"reset_cap = {protocol.reset_cap!r}  # best score after that"
    yield f"task_order = {_text(protocol.task_order)}"
    yield f"seed = {protocol.seed}"
    if protocol.tlx_language:
        yield f"tlx_language = {_text(protocol.tlx_language)}  # words of NASA-TLX"
    if protocol.rate_hz is not None:
        yield f"rate_hz = {float(protocol.rate_hz)!r}  # commands a second, in every condition"
    if protocol.primary:
        yield f"primary = {_text(protocol.primary)}  # decides; all else is exploratory"
    if protocol.margins:
        yield ""
        yield "[margins]  # of equivalence: share of successes, seconds, points of workload"
        for name, margin in protocol.margins.items():
            yield f"{name} = {float(margin)!r}"
    for condition in protocol.conditions:
        yield ""
        yield f"[conditions.{_key(condition.name)}]"
        yield f"method = {_text(condition.method)}"
        if condition.preset is not None:
            yield f"preset = {_text(condition.preset)}"
        if condition.label:
            yield f"label = {_text(condition.label)}  # what operators may see"
    for task in protocol.tasks:
        yield ""
        yield from _task_lines(task)
    yield ""
    yield from form_lines(protocol.forms)
    yield "[orders]  # a balanced Latin square: the conditions of the first block, the second, ..."
    for number, order in enumerate(plan.orders, 1):
        yield f"{number} = {_texts(order)}"
    yield ""
    yield "[enrolled]  # operator = { task = row of orders }, tasks in the order they are done"
    for one in plan.enrolled:
        rows = ", ".join(f"{_key(task)} = {row + 1}" for task, row in one.rows.items())
        yield f"{_key(one.code)} = {{ {rows} }}"


def _task_lines(task: Task) -> Iterator[str]:
    yield f"[tasks.{_key(task.name)}]"
    if task.title:
        yield f"title = {_text(task.title)}"
    if task.instruction:
        yield f"instruction = {_text(task.instruction)}"
    yield f"trials = {task.trials}  # in a block"
    if task.operators is not None:
        yield f"operators = {task.operators}"
    if task.time_limit_s is not None:
        yield f"time_limit_s = {float(task.time_limit_s)!r}"
    yield "rubric = ["
    for line in task.rubric:
        yield (
            f"  {{ name = {_text(line.name)}, score = {float(line.score)!r}, "
            f"text = {_text(line.text)} }},"
        )
    yield "]"


def _text(value: str) -> str:
    # A JSON string is a TOML one, but for the one control character that JSON lets through.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")


def _texts(values: tuple[str, ...]) -> str:
    return f"[{', '.join(map(_text, values))}]"


def _key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isalnum() else _text(name)


def _flag(value: bool) -> str:
    return "true" if value else "false"


KEPT: Final = "PREREGISTRATION.before.md"
"""The text of the plan before it was changed."""


def write_plan_files(plan: Plan, folder: Path) -> list[Path]:
    """Writes plan and schedules; those that stand there are replaced.

    Args:
        plan: of the study.
        folder: exists.

    Returns:
        The files.

    Raises:
        OutputError: a file can't be written.
    """
    written = [write_plan(plan, folder / NAME)]
    texts = {"schedule.csv": schedule_csv(plan), "schedule.txt": schedule_text(plan)}
    for name, text in texts.items():
        with atomic_write(folder / name) as file:
            file.write(text.encode("utf-8"))
        written.append(folder / name)
    return written


def write_preregistration(plan: Plan, folder: Path) -> Path | None:
    """Writes ``PREREGISTRATION.md``, where none of this very plan is there.

    To be called before anyone has begun only. A text of another plan, which somebody may have
    completed by hand, is kept under the name of ``KEPT``.

    Returns:
        The file, or None where it is there.

    Raises:
        OutputError: it can't be written.
    """
    path = folder / PREREGISTRATION
    mark = f"<!-- plan {_digest(plan)} -->"
    try:
        there = path.read_text("utf-8", errors="replace") if path.is_file() else None
        if there is not None and mark in there:
            return None
        if there is not None:
            path.replace(folder / KEPT)
    except OSError as error:
        raise output_error(path, error) from error
    with atomic_write(path) as file:
        file.write(f"{preregistration(plan)}\n{mark}\n".encode())
    return path


def _digest(plan: Plan) -> str:
    """Of all but who is enrolled."""
    return hashlib.sha256(plan_text(replace(plan, enrolled=())).encode()).hexdigest()[:16]
