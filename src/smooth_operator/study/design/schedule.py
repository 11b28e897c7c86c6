"""Schedules of a plan for printing, block by block."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from smooth_operator.formats.csv_table import csv_text
from smooth_operator.study.design.enrolment import spread_of_rows
from smooth_operator.study.design.latin import balance
from smooth_operator.study.design.plan import Plan

COLUMNS: Final = (
    "operator", "session", "task", "block", "condition", "label", "row", "familiarisation_s",
    "trials", "first_trial_global", "questionnaires_after",
)  # fmt: skip


def schedule_csv(plan: Plan, *, blind: bool = False) -> str:
    """One row a block.

    Args:
        plan: of the study.
        blind: leave out what shows which label is which condition.
    """
    columns = [name for name in COLUMNS if not (blind and name in ("condition", "row"))]
    return csv_text(
        columns,
        (
            {
                "operator": block.operator,
                "session": block.session,
                "task": block.task.name,
                "block": block.number,
                "condition": block.condition.name,
                "label": block.condition.label,
                "row": block.row + 1,
                "familiarisation_s": f"{plan.protocol.familiarisation_s:g}",
                "trials": block.task.trials,
                "first_trial_global": block.trial_global(1),
                "questionnaires_after": " ".join(map(str, block.questionnaires)),
            }
            for block in plan.schedule()
        ),
    )


def schedule_table(plan: Plan, *, blind: bool = True) -> list[list[str]]:
    """A heading and one row for each operator and task, for printing.

    Args:
        plan: of the study.
        blind: labels in the place of conditions.
    """
    count = len(plan.protocol.conditions)
    heading = ["operator", "task", *(f"block {k}" for k in range(1, count + 1)), "done"]
    rows = [heading]
    for one in plan.enrolled:
        for task in one.rows:
            blocks = plan.blocks(one.code, task)
            shown = [b.condition.label if blind else b.condition.name for b in blocks]
            rows.append([one.code, task, *shown, "[ ]"])
    return rows


def schedule_text(plan: Plan) -> str:
    """A sheet of plain text to hang on the wall; it doesn't say what the labels mean."""
    protocol = plan.protocol
    rows = schedule_table(plan)
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [protocol.name, "=" * len(protocol.name), ""]
    for task in protocol.tasks:
        after = ", ".join(map(str, protocol.questionnaire_trials(task))) or "none"
        lines.append(
            f"Task {task.name} ({task.title or 'untitled'}): {protocol.familiarisation_s:g} s of "
            f"free movement, then blocks of {task.trials} trials; questionnaires after {after}"
        )
    lines.append("")
    lines += ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip()
              for row in rows]  # fmt: skip
    return "\n".join(lines) + "\n"


def imbalances(plan: Plan) -> Iterator[str]:
    """What a person should know about the balance of a plan, a sentence each; none where even."""
    square = balance(plan.orders, plan.protocol.condition_names)
    if square.spread_of_places or square.spread_of_neighbours:
        yield (
            "the orders are no balanced Latin square: places or neighbours of conditions differ "
            "in how often they come"
        )
    for task in plan.protocol.tasks:
        spread = spread_of_rows(plan.enrolled, task.name, len(plan.orders))
        count = sum(task.name in one.rows for one in plan.enrolled)
        if spread > 1:
            yield (f"task {task.name}: some orders are used {spread} times more often than others")
        elif spread and count:
            more = len(plan.orders) - count % len(plan.orders)
            yield (
                f"task {task.name}: {count} operators can't be even over {len(plan.orders)} orders;"
                f" {more} more would be"
            )
