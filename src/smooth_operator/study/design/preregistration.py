"""Text of ``PREREGISTRATION.md``, which commits to a plan before the first operator starts."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from typing import Final

from smooth_operator.study.design.latin import balanced_rows
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.protocol import OUTCOMES, POOLED, Protocol
from smooth_operator.version import __version__

NAME: Final = "PREREGISTRATION.md"
_TITLES: Final = {
    "success": "success rate (share of trials that score 0.5 or 1)",
    "time": "completion time of successful trials [s]",
    "tlx": "workload (NASA-TLX, 0 to 100 points)",
}
_UNITS: Final = {
    "success": (100.0, "percentage points"), "time": (1.0, "s"), "tlx": (1.0, "points"),
}  # fmt: skip


def preregistration(plan: Plan) -> str:
    """Writes the pre-registration of a plan in Markdown.

    Args:
        plan: the plan before anyone has begun.

    Returns:
        Hypotheses, design, operators, tasks, outcomes, models, corrections, exclusions, stopping
        rule and versions, with [square brackets] for facts that only the authors know.
    """
    protocol = plan.protocol
    rows, many = len(plan.orders), len(protocol.tasks) > 1
    square = f"{rows} orders"
    if rows == len(balanced_rows(len(protocol.conditions))):
        square = (
            f"the {rows} rows of a Williams square, so that each condition is equally often in "
            "each place and right after each other one"
        )
    template = files("smooth_operator.study.design").joinpath("preregistration.md")
    return template.read_text("utf-8").format(
        protocol=protocol,
        version=__version__,
        conditions=len(protocol.conditions),
        hypotheses="\n".join(_hypotheses(protocol)),
        square=square,
        task_order="The order of an operator's tasks is balanced."
        if protocol.task_order == "balanced"
        else "Tasks are done in the order in which they are listed.",
        orders="\n".join(f"{number}. {', '.join(o)}" for number, o in enumerate(plan.orders, 1)),
        methods="\n".join(
            f"| {one.name}{' (baseline)' if one.name == protocol.baseline else ''} | {one.method} "
            f"| {one.preset or 'default'} |"
            for one in protocol.conditions
        ),
        rate=f" The hand gets {protocol.rate_hz:g} commands/s." if protocol.rate_hz else "",
        tasks="\n".join(_tasks(protocol)),
        outcomes="\n".join(_outcomes(protocol)),
        fixed=f"retargeter {'+ task ' if many else ''}+ t",
        blocks=", and `(1 | operator:retargeter:task)` over all tasks" if many else "",
        decides=" The primary hypothesis is decided by this family alone."
        if protocol.primary
        else "",
    )


def _endpoint(protocol: Protocol) -> str:
    """Describes the primary endpoint; empty without one."""
    outcome, _, scope = protocol.primary.partition("/")
    where = "over all tasks together" if scope == POOLED else f"in task {scope}"
    return f"{_TITLES[outcome]}, {where}" if outcome else ""


def _hypotheses(protocol: Protocol) -> Iterator[str]:
    names = [name for name in protocol.condition_names if name != protocol.baseline]
    others = " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
    if endpoint := _endpoint(protocol):
        yield (
            f"1. **Primary.** The {endpoint}, differs between {protocol.baseline} (baseline) and "
            f"{others}: one two-sided comparison for each. [Expected direction and reason.]"
        )
    else:
        yield "1. No primary endpoint is named: all results are exploratory."
    if protocol.margins:
        margins = ", ".join(
            f"{outcome} {_UNITS[outcome][0] * margin:g} {_UNITS[outcome][1]}"
            for outcome, margin in protocol.margins.items()
        )
        yield (
            "2. **Equivalence.** Two conditions are called equivalent if the 90 % interval of "
            f"their difference lies within ± the margin ({margins}; two one-sided tests, "
            "α = 0.05). [Why these margins.]"
        )


def _tasks(protocol: Protocol) -> Iterator[str]:
    for task in protocol.tasks:
        limit = "none" if task.time_limit_s is None else f"{task.time_limit_s:g} s"
        rubric = "; ".join(f"{line.score:g}: {line.text or line.name}" for line in task.rubric)
        title = f"{task.name}, {task.title}" if task.title else task.name
        cells = (title, protocol.planned(task), task.trials, limit, rubric)
        yield "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


def _outcomes(protocol: Protocol) -> Iterator[str]:
    outcomes = OUTCOMES if protocol.questionnaires else OUTCOMES[:-1]
    titles = ", ".join(_TITLES[outcome] for outcome in outcomes)
    if endpoint := _endpoint(protocol):
        yield f"- **Primary:** {endpoint}."
        yield (
            f"- **Exploratory:** all else, of {titles}, over all tasks together and in each; "
            "learning over trials; correlations with simulation; the further readings of the "
            "report."
        )
    else:
        yield f"- **Exploratory:** {titles}, in every scope."
    if protocol.questionnaires:
        yield (
            f"- NASA-TLX is filled in after the {', '.join(protocol.questionnaires)} trial of a "
            f"block; workload is the unweighted mean of its six scales."
        )
