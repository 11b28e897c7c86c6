"""Questions for the protocol of a study in the terminal; Enter takes the default."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, TypeVar

from rich.console import Console

from smooth_operator.errors import SmoothOperatorError, StudyError
from smooth_operator.study.design.protocol import (
    POINTS,
    PRIMARY,
    Condition,
    Point,
    Protocol,
    Task,
    check_primary,
    margins_of,
)

T = TypeVar("T")

_YES: Final = ("y", "yes")


def ask_protocol(draft: Protocol, console: Console) -> Protocol:
    """Asks for everything; an answer that can't be is asked for again.

    Args:
        draft: what Enter takes.
        console: where to ask.
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
    wanted = ask("Tasks", " ".join(task.name for task in draft.tasks), str.split)
    known = {task.name: task for task in draft.tasks}
    tasks = []
    for task_name in wanted:
        task = known.get(task_name, Task(task_name))
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
    asked = ask(
        "NASA-TLX after which trials of a block (initial midpoint final, or none)",
        " ".join(draft.questionnaires),
        _points,
    )
    weights = bool(asked) and ask("The 15 pairs of NASA-TLX as well? (y/n)", "n", _yes)
    scopes = [task.name for task in tasks]
    primary = ask(
        "Primary endpoint: success, time or tlx, a slash, and pooled or a task",
        PRIMARY,
        lambda text: _primary(text, scopes, bool(asked)),
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
            questionnaires=asked,
            weights=weights,
            seed=seed,
            rate_hz=rate,
            primary=primary,
            margins=margins,
        )
    except StudyError as error:  # answers that don't go together
        console.print(f"  {error}; once more", markup=False, soft_wrap=True)
        kept = replace(draft, name=name, conditions=conditions, baseline=baseline, seed=seed)
        return ask_protocol(kept, console)


def _primary(text: str, tasks: Sequence[str], workload: bool) -> str:
    if not text:
        raise StudyError("a study needs an endpoint that decides")
    check_primary(text, tasks, workload=workload)
    return text


def _conditions(text: str) -> tuple[Condition, ...]:
    made = [Condition.of(word) for word in text.split()]
    names = [condition.name for condition in made]
    if len(made) < 2 or len(set(names)) < len(names):
        raise StudyError("two or more, all different, are needed")
    return tuple(made)


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


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 86_400:
        raise StudyError("seconds are needed, 0 or more")
    return value


def _rate(text: str) -> float | None:
    if text == "any":
        return None
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1 <= value <= 1000:
        raise StudyError("1 to 1000 Hz are needed, or any")
    return value


def _points(text: str) -> tuple[Point, ...]:
    words = text.split()
    if words == ["none"]:
        return ()
    for word in words:
        _one_of(word, list(POINTS))
    return tuple(point for point in POINTS if point in words)


def _yes(text: str) -> bool:
    return text.lower() in _YES
