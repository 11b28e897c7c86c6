"""What of a stored plan may still be changed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from smooth_operator.errors import StudyError
from smooth_operator.study.design.plan import Plan


def check_revision(name: str, before: Plan, plan: Plan, begun: Iterable[Any]) -> None:
    """Refuses a new plan that changes what somebody has begun with.

    Args:
        name: of the study.
        before: the stored plan.
        plan: the new one.
        begun: rows of the table of participants.

    Raises:
        StudyError: it does.
    """
    rows = list(begun)
    if rows and (plan.protocol != before.protocol or plan.orders != before.orders):
        raise StudyError(
            f"study {name!r} is stored with another protocol or other orders; those of a "
            "study don't change once someone has begun: make a new study, under another name"
        )
    for row in rows:
        if row.erased_at is not None:
            if row.operator in plan.codes:
                refuse_erased(row)
            continue
        was = before.enrolment(row.operator)
        now = {one.code: one for one in plan.enrolled}.get(row.operator)
        kept = None if now is None else dict(list(now.rows.items())[: len(was.rows)])
        if kept is None or list(kept.items()) != list(was.rows.items()):
            raise StudyError(
                f"operator {row.operator} has begun with {dict(was.rows)}; tasks can be added "
                "at the end, not taken away or given another row"
            )


def refuse_erased(row: Any) -> None:
    """Raises for a participant whose data was deleted.

    Raises:
        StudyError: the data was.
    """
    if row is not None and row.erased_at is not None:
        raise StudyError(
            f"the data of operator {row.operator} was deleted on {row.erased_at[:10]}; enrol "
            "under another code"
        )
