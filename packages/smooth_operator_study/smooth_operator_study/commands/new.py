"""``smooth-operator study new`` and ``study enrol``: make plans of studies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Final

from rich.text import Text

from smooth_operator.cli.console import output_console, plain_table
from smooth_operator.cli.outputs import folder_for
from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.retargeting.registry import METHODS
from smooth_operator.simulation.tasks.catalogue import FIXED_WRIST, TASKS
from smooth_operator.simulation.tasks.task import PAPER_TASKS
from smooth_operator.terminal import printable
from smooth_operator_study.commands.options import Enrol, New
from smooth_operator_study.design.forms import DEFAULT_FORMS
from smooth_operator_study.design.plan import (
    Plan,
    imbalances,
    make_plan,
    scaled,
    schedule_table,
)
from smooth_operator_study.design.plan_file import (
    NAME,
    read_plan,
    write_plan_files,
    write_preregistration,
)
from smooth_operator_study.design.protocol import (
    ALPHA,
    FEW_OPERATORS,
    PAPER_MARGINS,
    POINTS,
    POOLED,
    PRIMARY,
    Condition,
    Protocol,
    Task,
)
from smooth_operator_study.store.study_store import FILE, open_study

PAPER_CONDITIONS: Final = (
    Condition("sbr", preset="paper"),
    Condition("dexpilot", preset="published"),
    Condition("geort"),  # a model that is trained for the hand and the operator
    Condition("hybrid", preset="published"),
)
"""Conditions of the paper: four methods with the settings of their authors' code."""
PAPER_RATE_HZ: Final = 30.0
PAPER_OPERATORS: Final = 18


def new_study(options: New) -> None:
    """Makes a plan, writes its files and prints the schedule."""
    folder = options.folder
    file = folder / NAME
    if file.exists() and not options.overwrite:
        raise ConfigError(
            f"there is already a study in {folder}; use --overwrite to replace its plan, or "
            "study enrol to add operators"
        )
    if file.exists() and (folder / FILE).exists():
        raise ConfigError(
            f"the study in {folder} has stored data ({FILE}), so its plan can't be "
            "replaced; use another folder"
        )
    if options.from_ is not None:
        plan = read_plan(options.from_)
        others = ("folder", "from_", "overwrite")
        described = (f for f in fields(options) if f.name not in others)
        if any(getattr(options, f.name) not in (f.default, []) for f in described):
            raise ConfigError(
                "--from reads the whole plan from the file; change the plan there, or remove --from"
            )
    else:
        plan = make_plan(_protocol(options))
    with folder_for(folder):
        files = [*write_plan_files(plan, folder), write_preregistration(plan, folder)]
    _print(plan)
    print(printable(f"written: {', '.join(str(path) for path in files)}"))


def enrol_operator(options: Enrol) -> None:
    """Adds an operator to the plan in the file and in the store."""
    folder = options.study if options.study.is_dir() else options.study.parent
    plan = read_plan(options.study)
    if (folder / FILE).exists():  # what is stored decides: the code may be that of one erased
        with open_study(folder, plan) as store:
            plan = plan.enrol(options.operator, options.tasks or None, absent=store.absent())
            store.revise(plan)
    else:
        plan = plan.enrol(options.operator, options.tasks or None)
    write_plan_files(plan, folder)
    for task in plan.enrolment(options.operator).rows:
        order = " → ".join(b.condition.label for b in plan.blocks(options.operator, task))
        print(printable(f"{options.operator}, task {task}: {order}"))


def _protocol(options: New) -> Protocol:
    conditions = tuple(map(Condition.of, options.conditions)) or PAPER_CONDITIONS
    rate = options.rate if options.conditions or options.rate is not None else PAPER_RATE_HZ
    names = [condition.name for condition in conditions]
    templates = {task.name: task for task in PAPER_TASKS}
    templates |= {name: replace(TASKS[name].task, name=name) for name in FIXED_WRIST}
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
    margins = numbers_of(options.margin, "--margin", "OUTCOME=DIFFERENCE, such as success=0.1")
    if not options.margin and not options.conditions:
        margins = PAPER_MARGINS
    points = options.questionnaires or POINTS
    if "none" in points and len(points) > 1:
        raise ConfigError("--questionnaires none can't be combined with others")
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
        margins=margins,
    )


def numbers_of(words: Sequence[str], option: str, form: str) -> dict[str, float]:
    """Parses ``NAME=NUMBER`` words of an option; ``form`` is their form in messages."""
    numbers: dict[str, float] = {}
    for word in words:
        name, _, number = word.partition("=")
        if name in numbers:
            raise ConfigError(f"{option}: {name} occurs twice")
        try:
            numbers[name] = float(number)
        except ValueError:
            raise ConfigError(f"{option} {word}: expected {form}") from None
    return numbers


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
    heading, *rows = schedule_table(plan)
    cells = (map(Text, row) for row in rows)
    console.print(plain_table(f"{protocol.name}: schedule", heading, cells))
    labels = ", ".join(f"{c.label} = {c.name}" for c in protocol.conditions)
    console.print(f"labels for operators: {labels}", markup=False, soft_wrap=True)
    run = ", ".join(" ".join(filter(None, (c.method, c.preset))) for c in protocol.conditions)
    rate = "" if protocol.rate_hz is None else f"; {protocol.rate_hz:g} commands per second"
    console.print(f"methods: {run}{rate}", markup=False, soft_wrap=True)
    notes = [
        f"{UnknownNameError('method', c.method, METHODS)} The console can't start this method."
        for c in protocol.conditions
        if c.method not in METHODS and ":" not in c.method
    ]
    count = protocol.operators
    if count < FEW_OPERATORS:
        few = f"{count} operators can only show very large differences"
        notes.append(
            f"{'one operator can show no difference' if count == 1 else few}; smooth-operator "
            "study power estimates how many are needed"
        )
    for note in (*notes, *_least_p(plan), *imbalances(plan)):
        console.print(f"note: {note}", markup=False, soft_wrap=True)


def _least_p(plan: Plan) -> list[str]:
    """Notes on the smallest p-value of success that the design can reach, pooled and by task."""
    # Imported here, since they take seconds.
    from smooth_operator_study.analysis.frame import frame_of
    from smooth_operator_study.analysis.outcomes import least_p
    from smooth_operator_study.power.simulated_study import planned_data

    protocol = plan.protocol
    if protocol.operators < 2:
        return []
    trials = planned_data(plan).trials.assign(value=0.0)
    tasks = [task.name for task in protocol.tasks]
    shown, never = [], []
    for scope in (POOLED, *(tasks if len(tasks) > 1 else ())):
        name = "all tasks" if scope == POOLED else f"task {scope}"
        p = least_p(frame_of(trials, scope, protocol.baseline))
        if p is None or p > ALPHA:
            never.append(name)
        if p is not None:
            shown.append(f"{p:.1g} in {name}")
    notes = []
    if shown:
        notes.append(
            "the smallest p-value of success that this design can reach is "
            f"{', '.join(shown)} (if one condition always succeeds and the others never; "
            f"against {protocol.baseline}, Dunnett)"
        )
    if never:
        notes.append(
            f"differences in success can't become significant in {', '.join(never)}: there "
            "are too few operators or trials"
        )
    return notes
