"""What ``study.json`` says of a study but its tables: the plan, who took part, forms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, Final

from smooth_operator.errors import StudyError
from smooth_operator.study.data.participants import Flow, Withdrawal
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import plan_of

_START: Final = "block_started"
"""Kind of the event by which an operator has started."""


def study_facts(content: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Facts of a study by their names in ``StudyData``; empty if the file has none.

    Args:
        content: of ``study.json``.
        name: of the file, for messages.

    Raises:
        StudyError: the plan in it is none, or the participants are not as an export writes them.
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
            "forms": {str(one["operator"]): _answers(one) for one in operators if one.get("forms")},
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
    voids = Counter(entry["retargeter"] for _, entry in _each(operators, "voided"))
    undone: Counter[str] = Counter()
    for one in operators:
        undone.update(one.get("undone", {}))
    amended = Counter(str(row["retargeter"]) for row in trials if row.get("amended"))
    return Flow(
        logged=True,
        planned=plan.protocol.operators,
        enrolled=codes,
        started=tuple(str(one["operator"]) for one in operators if _started(one)),
        completed=tuple(
            str(o["operator"]) for o in operators if o.get("done") and not o.get("ended_early")
        ),
        withdrawn=withdrawn,
        replaces={str(o["operator"]): str(o["replaces"]) for o in operators if o.get("replaces")},
        voids={name: voids[name] for name in names},
        undone={name: undone[name] for name in names},
        amended={name: amended[name] for name in names},
        pauses=sum(1 for _ in _each(operators, "pauses")),
        recalibrations=sum(1 for _ in _each(operators, "recalibrations")),
        ended_early=sum(1 for _ in _each(operators, "ended_early")),
    )


def _each(
    operators: list[Mapping[str, Any]], key: str
) -> Iterator[tuple[Mapping[str, Any], Mapping[str, Any]]]:
    for one in operators:
        for entry in one.get(key) or ():
            yield one, entry


def _started(one: Mapping[str, Any]) -> bool:
    return any(event["kind"] == _START for event in one.get("events", ()))


def _answers(one: Mapping[str, Any]) -> dict[str, Any]:
    """All forms of an operator together, by field; a field of two forms has the form in front."""
    found: dict[str, Any] = {}
    for form, filled in one["forms"].items():
        for field, answer in filled["answers"].items():
            found[f"{form}.{field}" if field in found else field] = answer
    return found
