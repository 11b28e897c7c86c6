"""Plan of a study: balanced orders (Williams squares), enrolled operators and block schedule."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import pairwise, permutations
from typing import Final, TypeAlias

import numpy as np

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.simulation.tasks.task import check_name
from smooth_operator_study.design.protocol import Condition, Point, Protocol, Task

_TREES: Final = (
    "Alder",
    "Aspen",
    "Beech",
    "Birch",
    "Cedar",
    "Cypress",
    "Elm",
    "Fir",
    "Hazel",
    "Holly",
    "Juniper",
    "Larch",
    "Linden",
    "Maple",
    "Oak",
    "Olive",
    "Pine",
    "Rowan",
    "Spruce",
    "Willow",
)


def lot(seed: int, *key: object) -> float:
    """Draws a number in [0, 1) that depends on the seed and the other arguments only."""
    digest = sha256("\x1f".join(map(str, (seed, *key))).encode()).digest()
    return int.from_bytes(digest[:6], "big") / 2**48


def shuffled(items: Iterable[str], seed: int, what: str) -> list[str]:
    """Returns the items in a random order."""
    return sorted(items, key=lambda item: lot(seed, what, item))


def balanced_rows(count: int) -> tuple[tuple[int, ...], ...]:
    """Returns the rows of a balanced Latin square (Williams 1949).

    Args:
        count: number of conditions, n, of at least 2.

    Returns:
        n rows if n is even, 2 n if it is odd, of the numbers 0 .. n-1; then row k + n is row k
        backwards.
    """
    # 0, 1, n-1, 2, n-2, ...: the steps between neighbours are all different modulo n.
    zigzag = [(k + 1) // 2 if k % 2 else (count - k // 2) % count for k in range(count)]
    rows = [tuple((start + z) % count for z in zigzag) for start in range(count)]
    if count % 2:
        rows += [row[::-1] for row in rows]
    return tuple(rows)


def balance(orders: Iterable[Sequence[str]]) -> Counter[tuple[str, int | str]]:
    """Counts (condition, place) and (condition, next condition) in a set of orders."""
    counts: Counter[tuple[str, int | str]] = Counter()
    for order in orders:
        counts.update((name, place) for place, name in enumerate(order))
        counts.update(pairwise(order))
    return counts


def imbalance(orders: Sequence[Sequence[str]], conditions: Sequence[str]) -> tuple[int, int]:
    """Returns largest minus smallest count of a condition in a place, and of two neighbours.

    Args:
        orders: orders of all conditions, one for each operator.
        conditions: names of the conditions.

    Returns:
        (0, 0) for orders that are balanced for place and carry-over.
    """
    counts = balance(orders)
    places = [counts[name, place] for name in conditions for place in range(len(conditions))]
    neighbours = [counts[pair] for pair in permutations(conditions, 2)]
    return max(places) - min(places), max(neighbours) - min(neighbours)


def schedule_csv(plan: Plan) -> str:
    """Returns the schedule as CSV, one row for each block."""
    rows = [
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
    ]
    return csv_text(list(rows[0]) if rows else [], rows)


def schedule_table(plan: Plan) -> list[list[str]]:
    """Returns a heading and one row for each operator and task, for printing."""
    count = len(plan.protocol.conditions)
    return [
        ["operator", "task", *(f"block {k}" for k in range(1, count + 1))],
        *(
            [one.code, task, *(block.condition.name for block in plan.blocks(one.code, task))]
            for one in plan.enrolled
            for task in one.rows
        ),
    ]


def imbalances(plan: Plan) -> Iterator[str]:
    """Describes the imbalances of a plan in sentences; none if it is balanced."""
    if any(imbalance(plan.orders, plan.protocol.condition_names)):
        yield (
            "the orders are not a balanced Latin square: positions or neighbours of "
            "conditions occur with different frequencies"
        )
    for task in plan.protocol.tasks:
        spread = spread_of_rows(plan.enrolled, task.name, len(plan.orders))
        count = sum(task.name in one.rows for one in plan.enrolled)
        if spread > 1:
            yield (f"task {task.name}: some orders are used {spread} times more often than others")
        elif spread and count:
            more = len(plan.orders) - count % len(plan.orders)
            yield (
                f"task {task.name}: {len(plan.orders)} orders can't be spread evenly over "
                f"{count} operator{'s' * (count > 1)}; {more} more operators would make it "
                "even"
            )


_USED: Final = 1e6
"""Weight of earlier uses of a row. It exceeds all weights of uneven places."""
_REPEATED: Final = 1e12
"""Weight of a row that the operator already has, so that it is chosen only if no other is left."""
Orders: TypeAlias = tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Enrolment:
    """An operator's part of the plan.

    Attributes:
        code: pseudonym of the operator.
        rows: task -> row of the square, in the order of the tasks.
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
    """Assigns rows to one more operator.

    Args:
        protocol: protocol of the study.
        orders: rows of the square, as names of conditions.
        before: operators who have rows already.
        code: pseudonym of the new operator, or of one who does further tasks.
        tasks: tasks of the operator.
        salt: number of the draw; another one draws other lots.

    Returns:
        The operator's earlier rows, which never change, and those of the new tasks.
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
    """Assigns rows to all planned operators, P01 onwards.

    Operators are dealt to tasks in a circle, so that their numbers of tasks differ by one at most.
    Assigning one operator after the other may use a row twice more than another one; then other
    lots are drawn, and the most even of 64 draws is used.
    """
    dealt = _dealt(protocol)
    best: tuple[float, tuple[Enrolment, ...]] | None = None
    for salt in range(64):
        enrolments: list[Enrolment] = []
        for code, tasks in dealt.items():
            enrolments.append(enrolled(protocol, orders, enrolments, code, tasks, salt=salt))
        spreads = [spread_of_rows(enrolments, task.name, len(orders)) for task in protocol.tasks]
        excess = float(sum(max(0, spread - 1) for spread in spreads))
        if best is None or excess < best[0]:
            best = (excess, tuple(enrolments))
        if excess == 0:
            break
    assert best is not None
    return best[1]


def spread_of_rows(enrolments: Sequence[Enrolment], task: str, rows: int) -> int:
    """Largest minus smallest number of uses of a row in a task."""
    used = Counter(one.rows[task] for one in enrolments if task in one.rows)
    counts = [used[row] for row in range(rows)]
    return max(counts) - min(counts)


def _dealt(protocol: Protocol) -> dict[str, list[str]]:
    width = max(2, len(str(protocol.operators)))  # one width for all, so that tables sort
    codes = [f"P{k:0{width}d}" for k in range(1, protocol.operators + 1)]
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
        so_far = balance(orders[row] for row in used)
        for row, order in enumerate(orders):
            uneven = sum(so_far[key] for key in balance([order]))
            tie = lot(protocol.seed, "row", salt, code, task, row)
            cost[i, row] = _USED * counts[row] + uneven + 0.5 * tie
            cost[i, row] += _REPEATED * (row in had)
    picked, columns = linear_sum_assignment(cost)
    return {tasks[i]: int(row) for i, row in zip(picked, columns, strict=True)}


def _task_order(
    protocol: Protocol, before: Sequence[Enrolment], code: str, tasks: Sequence[str], salt: int
) -> list[str]:
    """Orders the tasks of an operator."""
    names = [task.name for task in protocol.tasks]
    for task in tasks:
        protocol.task(task)
        if tasks.count(task) > 1:
            raise StudyError(f"operator {code}: task {task!r} is named twice")
    listed = sorted(tasks, key=names.index)
    if protocol.task_order == "listed" or len(listed) < 2:
        return listed
    counts = Counter(tuple(one.rows) for one in before if set(one.rows) == set(listed))
    so_far = balance(counts.elements())
    ranked = []
    for row in balanced_rows(len(listed)):
        order = tuple(listed[k] for k in row)
        uneven = sum(so_far[name, place] for place, name in enumerate(order))
        tie = lot(protocol.seed, "tasks", salt, code, *order)
        ranked.append((counts[order], uneven, tie, order))
    return list(min(ranked)[-1])


@dataclass(frozen=True)
class Block:
    """A planned block of one operator.

    Attributes:
        operator: pseudonym.
        session: number of the task among the operator's tasks, from 1.
        task: task of the block.
        number: number of the block in the task, from 1.
        condition: condition of the block.
        row: row of the square, from 0.
        questionnaires: trial of the block -> questionnaire that follows it.
    """

    operator: str
    session: int
    task: Task
    number: int
    condition: Condition
    row: int
    questionnaires: dict[int, Point]

    @property
    def place(self) -> tuple[str, int]:
        """Name of the task and number of the block."""
        return self.task.name, self.number

    def trial_global(self, trial: int) -> int:
        """Number of a trial of this block among all trials of the task, from 1."""
        return (self.number - 1) * self.task.trials + trial


@dataclass(frozen=True)
class Plan:
    """Plan of a study: protocol, orders, and rows of the operators.

    Attributes:
        protocol: protocol, in which each condition has a label.
        orders: rows of the square that was drawn.
        enrolled: operators with their rows, in the order of enrolment.
    """

    protocol: Protocol
    orders: Orders
    enrolled: tuple[Enrolment, ...] = ()

    def __post_init__(self) -> None:
        names = set(self.protocol.condition_names)
        for row, order in enumerate(self.orders, 1):
            if len(order) != len(names) or set(order) != names:
                raise StudyError(
                    f"row {row} of the orders must hold each condition once "
                    f"({', '.join(self.protocol.condition_names)}), not {', '.join(order)}"
                )
        if not self.orders:
            raise StudyError("a plan needs at least one order of the conditions")
        codes = [one.code for one in self.enrolled]
        for one in self.enrolled:
            check_name(one.code, "operator")
            if codes.count(one.code) > 1:
                raise StudyError(f"operator {one.code} is enrolled twice")
            for task, row in one.rows.items():
                self.protocol.task(task)
                if isinstance(row, bool) or not 0 <= row < len(self.orders):
                    raise StudyError(
                        f"operator {one.code}, task {task}: there is no row {row + 1}; the plan "
                        f"has rows 1 to {len(self.orders)}"
                    )

    @property
    def codes(self) -> tuple[str, ...]:
        """Pseudonyms of the operators."""
        return tuple(one.code for one in self.enrolled)

    def enrolment(self, operator: str) -> Enrolment:
        """Finds the rows of an operator."""
        for one in self.enrolled:
            if one.code == operator:
                return one
        raise UnknownNameError("operator", operator, self.codes)

    def blocks(self, operator: str, task: str | None = None) -> tuple[Block, ...]:
        """Returns an operator's blocks in their order.

        Args:
            operator: pseudonym.
            task: task of the blocks; None for all tasks.
        """
        rows = self.enrolment(operator).rows
        if task is not None and task not in rows:
            raise UnknownNameError(f"task of operator {operator}:", task, rows)
        return tuple(
            Block(
                operator,
                session,
                self.protocol.task(name),
                number,
                self.protocol.condition(condition),
                row,
                self.protocol.questionnaire_trials(self.protocol.task(name)),
            )
            for session, (name, row) in enumerate(rows.items(), 1)
            if task is None or name == task
            for number, condition in enumerate(self.orders[row], 1)
        )

    def schedule(self) -> Iterator[Block]:
        """Yields the blocks of all operators."""
        for code in self.codes:
            yield from self.blocks(code)

    def enrol(
        self, operator: str, tasks: Sequence[str] | None = None, *, absent: Sequence[str] = ()
    ) -> Plan:
        """Returns the plan with one more operator, or with further tasks for an enrolled one.

        Args:
            operator: pseudonym.
            tasks: names of tasks; None for all.
            absent: operators who withdrew with their data, whose rows are free.
        """
        check_name(operator, "operator")
        names = [task.name for task in self.protocol.tasks] if tasks is None else list(tasks)
        present = [one for one in self.enrolled if one.code not in absent]
        new = enrolled(self.protocol, self.orders, present, operator, names)
        if operator not in self.codes:
            return replace(self, enrolled=(*self.enrolled, new))
        if new == self.enrolment(operator):
            raise StudyError(f"operator {operator} does {', '.join(names)} already")
        return replace(
            self, enrolled=tuple(new if one.code == operator else one for one in self.enrolled)
        )

    def withdraw(self, operator: str) -> Plan:
        """Returns the plan without an operator."""
        self.enrolment(operator)
        return replace(self, enrolled=tuple(o for o in self.enrolled if o.code != operator))


def make_plan(protocol: Protocol) -> Plan:
    """Draws labels and square, and enrols the planned number of operators.

    The places of the conditions in the square and the order of its rows are drawn. Otherwise
    studies that end early would always favour the same neighbours.
    """
    bare = [c.name for c in protocol.conditions if not c.label]
    chosen = {c.label for c in protocol.conditions}
    trees = shuffled(_TREES, protocol.seed, "label")
    trees += [f"Tree-{k}" for k in range(1, len(bare) + 1)]
    free = [tree for tree in trees if tree not in chosen]
    labels = dict(zip(shuffled(bare, protocol.seed, "labelled"), free, strict=False))
    protocol = replace(
        protocol,
        conditions=tuple(replace(c, label=c.label or labels[c.name]) for c in protocol.conditions),
    )
    names = shuffled(protocol.condition_names, protocol.seed, "square")
    rows = balanced_rows(len(names))
    drawn = shuffled(map(str, range(len(rows))), protocol.seed, "rows")
    orders = tuple(tuple(names[k] for k in rows[int(row)]) for row in drawn)
    return Plan(protocol, orders, enrol_all(protocol, orders))


def scaled(protocol: Protocol, operators: int) -> Protocol:
    """Returns the protocol with another number of operators, in the same shares of the tasks."""
    share = operators / protocol.operators
    counts = [
        operators
        if task.operators is None
        else min(operators, max(1, round(task.operators * share)))
        for task in protocol.tasks
    ]
    while sum(counts) < operators:  # rounding down left an operator without a task
        short = [
            protocol.planned(t) * share - n for t, n in zip(protocol.tasks, counts, strict=True)
        ]
        counts[short.index(max(short))] += 1
    tasks = tuple(
        task if task.operators is None else replace(task, operators=count)
        for task, count in zip(protocol.tasks, counts, strict=True)
    )
    return replace(protocol, operators=operators, tasks=tasks)
