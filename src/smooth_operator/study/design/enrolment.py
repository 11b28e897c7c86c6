"""Which row of the square an operator gets for each task.

Rows are given as operators come, so that a study that ends early, or whose tasks are done by
different numbers of operators, is as balanced as its numbers allow: the row that the task has seen
least; among those the one that leaves places and neighbours most even; then by lot. All rows of an
operator are chosen together, so that an operator meets another row in each further task.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np

from smooth_operator.errors import StudyError
from smooth_operator.study.design.draws import lot
from smooth_operator.study.design.latin import balance, balanced_rows
from smooth_operator.study.design.protocol import Protocol

_USED: Final = 1e6
"""Weight of how often a row was used, over that of unevenness: the first always decides."""
_AGAIN: Final = 1e12
"""Weight of a row that the operator has had already: only where no other is left."""

Orders: TypeAlias = tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Enrolment:
    """An operator's part of the plan.

    Attributes:
        code: pseudonym of the operator.
        rows: task -> row of the square, in the order in which the tasks are done.
    """

    code: str
    rows: Mapping[str, int]


def enrolled(
    protocol: Protocol,
    orders: Orders,
    before: Sequence[Enrolment],
    code: str,
    tasks: Sequence[str],
    *,
    salt: int = 0,
) -> Enrolment:
    """One operator more.

    Args:
        protocol: of the study.
        orders: rows of the square, as names of conditions.
        before: those who have their rows.
        code: pseudonym of the new one, or of one who does further tasks.
        tasks: what the operator is to do.
        salt: another one draws other lots.

    Returns:
        The rows of the new tasks, and those that the operator had, which never change.
    """
    had = next((dict(one.rows) for one in before if one.code == code), {})
    order = _task_order(protocol, before, code, [task for task in tasks if task not in had], salt)
    chosen: dict[str, int] = {}
    for start in range(0, len(order), len(orders)):  # more tasks than rows: some rows come again
        part = order[start : start + len(orders)]
        chosen |= _rows(
            protocol, orders, before, code, part, {*had.values(), *chosen.values()}, salt
        )
    return Enrolment(code, {**had, **{task: chosen[task] for task in order}})


def enrol_all(protocol: Protocol, orders: Orders) -> tuple[Enrolment, ...]:
    """All operators of a plan, P01 on; as many do each task as the protocol says.

    Operators are dealt to tasks in a circle, so that their numbers of tasks differ by one at most.
    Where choosing one after the other ends with a row used twice more than another, other lots are
    drawn: there are 64 tries, and the most even wins.
    """
    dealt = _dealt(protocol)
    best: tuple[float, tuple[Enrolment, ...]] | None = None
    for salt in range(64):
        made: list[Enrolment] = []
        for code, tasks in dealt.items():
            made.append(enrolled(protocol, orders, made, code, tasks, salt=salt))
        spreads = [spread_of_rows(made, task.name, len(orders)) for task in protocol.tasks]
        excess = float(sum(max(0, spread - 1) for spread in spreads))
        if best is None or excess < best[0]:
            best = (excess, tuple(made))
        if excess == 0:
            break
    assert best is not None
    return best[1]


def spread_of_rows(made: Sequence[Enrolment], task: str, rows: int) -> int:
    """Most minus least often that a row is used in a task."""
    used = Counter(one.rows[task] for one in made if task in one.rows)
    counts = [used[row] for row in range(rows)]
    return max(counts) - min(counts)


def operator_code(number: int, among: int) -> str:
    """``P01``: short, and of one width, so that tables sort."""
    return f"P{number:0{max(2, len(str(among)))}d}"


def _dealt(protocol: Protocol) -> dict[str, list[str]]:
    codes = [operator_code(k + 1, protocol.operators) for k in range(protocol.operators)]
    dealt: dict[str, list[str]] = {code: [] for code in codes}
    at = 0
    for task in protocol.tasks:
        for _ in range(protocol.planned(task)):
            dealt[codes[at % len(codes)]].append(task.name)
            at += 1
    return dealt


def _rows(
    protocol: Protocol,
    orders: Orders,
    before: Sequence[Enrolment],
    code: str,
    tasks: Sequence[str],
    had: set[int],
    salt: int,
) -> dict[str, int]:
    from scipy.optimize import linear_sum_assignment  # half a second to import

    cost = np.zeros((len(tasks), len(orders)))
    for i, task in enumerate(tasks):
        used = [one.rows[task] for one in before if task in one.rows and one.code != code]
        counts = Counter(used)
        so_far = balance([orders[row] for row in used], protocol.condition_names)
        for row, order in enumerate(orders):
            uneven = sum(so_far.places[name, place] for place, name in enumerate(order))
            uneven += sum(so_far.neighbours[pair] for pair in pairwise(order))
            tie = lot(protocol.seed, "row", salt, code, task, row)
            cost[i, row] = _USED * counts[row] + uneven + 0.5 * tie
            cost[i, row] += _AGAIN * (row in had)
    picked, found = linear_sum_assignment(cost)
    return {tasks[i]: int(row) for i, row in zip(picked, found, strict=True)}


def _task_order(
    protocol: Protocol, before: Sequence[Enrolment], code: str, tasks: Sequence[str], salt: int
) -> list[str]:
    """The tasks in the order in which the operator does them."""
    known = [task.name for task in protocol.tasks]
    for task in tasks:
        protocol.task(task)
        if tasks.count(task) > 1:
            raise StudyError(f"operator {code}: task {task!r} is named twice")
    listed = sorted(tasks, key=known.index)
    if protocol.task_order == "listed" or len(listed) < 2:
        return listed
    seen = Counter(tuple(one.rows) for one in before if set(one.rows) == set(listed))
    so_far = balance([o for o, n in seen.items() for _ in range(n)], listed)
    ranked = []
    for row in balanced_rows(len(listed)):
        order = tuple(listed[k] for k in row)
        uneven = sum(so_far.places[name, place] for place, name in enumerate(order))
        tie = lot(protocol.seed, "tasks", salt, code, *order)
        ranked.append((seen[order], uneven, tie, order))
    return list(min(ranked)[-1])
