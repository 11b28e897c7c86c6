"""``smooth-operator study new`` and ``study enrol``: make plans of studies, ask in a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Final, TypeVar

from rich.console import Console
from rich.text import Text

from smooth_operator.cli.console import output_console, plain_table
from smooth_operator.cli.outputs import folder_for
from smooth_operator.cli.study_options import Enrol, New
from smooth_operator.errors import ConfigError, SmoothOperatorError, StudyError
from smooth_operator.simulation.tasks.task import PAPER_TASKS, TASKS
from smooth_operator.study.design.forms import DEFAULT_FORMS
from smooth_operator.study.design.plan import (
    Plan,
    imbalances,
    make_plan,
    scaled,
    schedule_table,
)
from smooth_operator.study.design.plan_file import (
    NAME,
    read_plan,
    write_plan_files,
    write_preregistration,
)
from smooth_operator.study.design.protocol import (
    FEW_OPERATORS,
    PAPER_MARGINS,
    POINTS,
    PRIMARY,
    Condition,
    Point,
    Protocol,
    Task,
    check_primary,
    margins_of,
)
from smooth_operator.terminal import open_console, printable

T = TypeVar("T")


def ask_protocol(draft: Protocol, console: Console) -> Protocol:
    """Asks for each part of a protocol; repeats the question after an invalid answer.

    Args:
        draft: protocol with the default answers.
        console: terminal to ask in.
    """

    def ask(question: str, default: str, read: Callable[[str], T]) -> T:
        while True:
            shown = f" [{default}]" if default else ""
            answer = console.input(f"{question}{shown}: ", markup=False).strip() or default
            try:
                return read(answer)
            except (SmoothOperatorError, ValueError) as error:
                console.print(f"  {error}", markup=False, soft_wrap=True)

    console.print("A new study. Enter takes what is in brackets.")
    name = ask("Name of the study", draft.name, lambda text: replace(draft, name=text).name)
    conditions = ask(
        "Conditions, separated by spaces (NAME, or NAME=METHOD:PRESET)",
        " ".join(condition.text for condition in draft.conditions),
        _conditions,
    )
    names = [condition.name for condition in conditions]
    baseline = ask(
        "Baseline, which the others are compared with",
        draft.baseline if draft.baseline in names else names[0],
        lambda text: _one_of(text, names),
    )
    operators = ask("Operators", str(draft.operators), lambda text: _whole(text, 1))
    task_names = ask("Tasks", " ".join(task.name for task in draft.tasks), str.split)
    drafts = {task.name: task for task in draft.tasks}
    tasks = []
    for task_name in task_names:
        task = drafts.get(task_name, Task(task_name))
        trials = ask(f"  {task_name}: trials a block", str(task.trials), lambda t: _whole(t, 1))
        default = min(operators, task.operators or operators)
        doing = ask(
            f"  {task_name}: operators who do it", str(default), lambda t: _whole(t, 1, operators)
        )
        task = replace(task, trials=trials, operators=None if doing == operators else doing)
        if not task.title:
            title = ask(f"  {task_name}: title", task_name, str)
            task = replace(task, title=title, instruction=ask("  instruction", "", str))
        tasks.append(task)
    seconds = ask("Free movement before each block [s]", f"{draft.familiarisation_s:g}", _seconds)
    points = ask(
        "NASA-TLX after which trials of a block (initial midpoint final, or none)",
        " ".join(draft.questionnaires),
        _points,
    )
    scopes = [task.name for task in tasks]
    primary = ask(
        "Primary endpoint: success, time or tlx, a slash, and pooled or a task",
        PRIMARY,
        lambda text: _primary(text, scopes, bool(points)),
    )
    margins = ask(
        "Margins of equivalence (success=SHARE time=SECONDS tlx=POINTS, or none)",
        " ".join(f"{name}={margin:g}" for name, margin in draft.margins.items()) or "none",
        lambda text: {} if text == "none" else margins_of(text.split()),
    )
    rate = ask(
        "Commands a second in every condition (or any: as teleop was started)",
        "any" if draft.rate_hz is None else f"{draft.rate_hz:g}",
        _rate,
    )
    seed = ask("Seed of all that is drawn", str(draft.seed), lambda text: _whole(text, 0))
    try:
        return replace(
            draft,
            name=name,
            conditions=conditions,
            baseline=baseline,
            operators=operators,
            tasks=tuple(tasks),
            familiarisation_s=seconds,
            questionnaires=points,
            seed=seed,
            rate_hz=rate,
            primary=primary,
            margins=margins,
        )
    except StudyError as error:  # answers that don't go together
        console.print(f"  {error}; once more", markup=False, soft_wrap=True)
        again = replace(draft, name=name, conditions=conditions, baseline=baseline, seed=seed)
        return ask_protocol(again, console)


def _primary(text: str, tasks: Sequence[str], workload: bool) -> str:
    if not text:
        raise StudyError("a study needs an endpoint that decides")
    check_primary(text, tasks, workload=workload)
    return text


def _conditions(text: str) -> tuple[Condition, ...]:
    conditions = [Condition.of(word) for word in text.split()]
    names = [condition.name for condition in conditions]
    if len(conditions) < 2 or len(set(names)) < len(names):
        raise StudyError("two or more, all different, are needed")
    return tuple(conditions)


def _one_of(text: str, names: list[str]) -> str:
    if text not in names:
        raise StudyError(f"one of {', '.join(names)}")
    return text


def _whole(text: str, least: int, most: int | None = None) -> int:
    if not text.isascii() or not text.isdigit() or int(text) < least:
        raise StudyError(f"a whole number from {least} on is needed")
    if most is not None and int(text) > most:
        raise StudyError(f"at most {most}")
    return int(text)


def _number(text: str, least: float, most: float, needed: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = least - 1
    if not least <= value <= most:
        raise StudyError(needed)
    return value


def _seconds(text: str) -> float:
    return _number(text, 0, 86_400, "seconds are needed, 0 or more")


def _rate(text: str) -> float | None:
    return None if text == "any" else _number(text, 1, 1000, "1 to 1000 Hz are needed, or any")


def _points(text: str) -> tuple[Point, ...]:
    words = text.split()
    if words == ["none"]:
        return ()
    for word in words:
        _one_of(word, list(POINTS))
    return tuple(point for point in POINTS if point in words)


PAPER_CONDITIONS: Final = (
    Condition("sbr", preset="paper"),
    Condition("dexpilot", preset="published"),
    Condition("geort"),  # a model that is trained for the hand and the operator
    Condition("hybrid", preset="published"),
)
"""Conditions of the paper: methods with the settings of their authors' code."""
PAPER_RATE_HZ: Final = 30.0
PAPER_OPERATORS: Final = 18
_STORE: Final = "study.db"


def new_study(options: New) -> None:
    """Makes a plan, writes its files and prints the schedule.

    Raises:
        StudyError: the options make no study.
        ConfigError: the folder holds a study already, or options contradict each other.
        OutputError: a file can't be written.
    """
    folder = options.folder
    file = folder / NAME
    if file.exists() and not options.overwrite:
        raise ConfigError(
            f"there is a study in {folder} already; --overwrite replaces its plan, study enrol "
            "adds operators"
        )
    if file.exists() and (folder / _STORE).exists():
        raise ConfigError(
            f"something is stored of the study in {folder} ({_STORE}); its plan can't be "
            "replaced: use another folder"
        )
    if options.from_ is not None:
        plan = read_plan(options.from_)
        if _has_options(options):
            raise ConfigError("--from takes all from the file; change it there, or leave it out")
    else:
        protocol = _protocol(options)
        asking = sys.stdin.isatty() and sys.stdout.isatty()
        if asking and not options.no_wizard and not _has_options(options):
            protocol = ask_protocol(protocol, open_console())
        plan = make_plan(protocol)
    with folder_for(folder):
        files = write_plan_files(plan, folder)
        files += filter(None, [write_preregistration(plan, folder)])
    _print(plan)
    print(printable(f"written: {', '.join(str(path) for path in files)}"))


def enrol_operator(options: Enrol) -> None:
    """Adds an operator to the plan in the file and in the store.

    Raises:
        StudyError: there is no such study, or the operator does these tasks already.
        OutputError: a file can't be written.
    """
    folder = options.study if options.study.is_dir() else options.study.parent
    plan = read_plan(options.study)
    if (folder / _STORE).exists():  # what is stored decides: the code may be that of one erased
        from smooth_operator.study.store.study_store import open_study

        with open_study(folder, plan) as store:
            plan = plan.enrol(options.operator, options.tasks or None, absent=store.absent())
            store.revise(plan)
    else:
        plan = plan.enrol(options.operator, options.tasks or None)
    write_plan_files(plan, folder)
    for task in plan.enrolment(options.operator).rows:
        order = " → ".join(b.condition.label for b in plan.blocks(options.operator, task))
        print(printable(f"{options.operator}, task {task}: {order}"))


def _has_options(options: New) -> bool:
    """True if an option describes the study."""
    others = ("folder", "from_", "no_wizard", "overwrite")
    return any(
        getattr(options, one.name) not in (one.default, [])
        for one in fields(options)
        if one.name not in others
    )


def _protocol(options: New) -> Protocol:
    conditions = tuple(map(Condition.of, options.conditions)) or PAPER_CONDITIONS
    rate = options.rate if options.conditions or options.rate is not None else PAPER_RATE_HZ
    names = [condition.name for condition in conditions]
    templates = {task.name: task for task in PAPER_TASKS}
    templates |= {name: replace(one.task, name=name) for name, one in TASKS.items()}
    operators = options.operators
    if options.tasks:
        tasks = tuple(_task(text, templates) for text in options.tasks)
        operators = PAPER_OPERATORS if operators is None else operators
    else:
        tasks = PAPER_TASKS
        if operators is not None and operators != PAPER_OPERATORS:
            # As many as were asked for, in the paper's shares of the tasks.
            share = Protocol("draft", conditions, tasks, names[0], PAPER_OPERATORS)
            tasks = scaled(share, operators).tasks
        operators = operators or PAPER_OPERATORS
    points = options.questionnaires or POINTS
    if "none" in points and len(points) > 1:
        raise ConfigError("--questionnaires none goes with no other")
    return Protocol(
        name=options.name or options.folder.absolute().name,
        conditions=conditions,
        tasks=tasks,
        baseline=options.baseline or ("dexpilot" if "dexpilot" in names else names[0]),
        operators=operators,
        familiarisation_s=120.0 if options.familiarisation is None else options.familiarisation,
        questionnaires=tuple(point for point in POINTS if point in points),
        seed=options.seed or 0,
        forms=() if options.no_forms else DEFAULT_FORMS,
        rate_hz=rate,
        primary=PRIMARY if options.primary is None else options.primary,
        margins=_margins(options),
    )


def _margins(options: New) -> dict[str, float]:
    if not options.margin:
        return {} if options.conditions else dict(PAPER_MARGINS)
    try:
        return margins_of(options.margin)
    except ValueError as error:
        raise ConfigError(f"--margin: {error}") from None


def _task(text: str, templates: dict[str, Task]) -> Task:
    name, *numbers = text.split(":")
    try:
        counts = [int(number) for number in numbers]
    except ValueError:
        counts = []
    if len(counts) != len(numbers) or len(counts) > 2:
        raise ConfigError(f"--tasks {text}: expected NAME, NAME:TRIALS or NAME:TRIALS:OPERATORS")
    task = replace(templates[name], operators=None) if name in templates else Task(name)
    if counts:
        task = replace(task, trials=counts[0])
    return replace(task, operators=counts[1]) if len(counts) > 1 else task


def _print(plan: Plan) -> None:
    console = output_console(140)
    protocol = plan.protocol
    table = plain_table(f"{protocol.name}: schedule")
    heading, *rows = schedule_table(plan, blind=False)
    for name in heading[:-1]:
        table.add_column(name)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row[:-1]))
    console.print(table)
    labels = ", ".join(f"{c.label} = {c.name}" for c in protocol.conditions)
    console.print(f"labels for operators: {labels}", markup=False, soft_wrap=True)
    run = ", ".join(" ".join(filter(None, (c.method, c.preset))) for c in protocol.conditions)
    rate = "" if protocol.rate_hz is None else f"; {protocol.rate_hz:g} commands a second"
    console.print(f"what is run: {run}{rate}", markup=False, soft_wrap=True)
    if protocol.operators < FEW_OPERATORS:
        console.print(
            f"note: {protocol.operators} operators can show only very large differences; "
            "smooth-operator study power says how many are needed",
            soft_wrap=True,
        )
    for note in imbalances(plan):
        console.print(f"note: {note}", markup=False, soft_wrap=True)
