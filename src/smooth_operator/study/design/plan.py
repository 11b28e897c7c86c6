"""A study that can be run: the protocol, the square drawn for it, and who gets which row."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.simulation.tasks.checks import check_name
from smooth_operator.study.design.draws import blind_labels, shuffled
from smooth_operator.study.design.enrolment import Enrolment, Orders, enrol_all, enrolled
from smooth_operator.study.design.latin import Balance, balance, balanced_rows
from smooth_operator.study.design.protocol import Condition, Point, Protocol, Task


@dataclass(frozen=True)
class Block:
    """One block of one operator, as it is planned.

    Attributes:
        operator: pseudonym.
        session: which of the operator's tasks this is, from 1.
        task: what is done.
        number: of the block in the task, from 1.
        condition: with what.
        row: of the square.
        questionnaires: trial of the block -> questionnaire that follows it.
    """

    operator: str
    session: int
    task: Task
    number: int
    condition: Condition
    row: int
    questionnaires: dict[int, Point]

    def trial_global(self, trial: int) -> int:
        """Number of a trial of this block among all of the task, from 1."""
        return (self.number - 1) * self.task.trials + trial


@dataclass(frozen=True)
class Plan:
    """What the experimenter follows.

    Attributes:
        protocol: what is done; each condition has a label.
        orders: rows of the square that was drawn.
        enrolled: operators with their rows, in the order of their coming.
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
        """An operator's rows.

        Raises:
            UnknownNameError: nobody of that code takes part.
        """
        for one in self.enrolled:
            if one.code == operator:
                return one
        raise UnknownNameError("operator", operator, self.codes)

    def blocks(self, operator: str, task: str | None = None) -> tuple[Block, ...]:
        """An operator's blocks in the order in which they are done.

        Args:
            operator: pseudonym.
            task: only those of one task; None for all.

        Raises:
            UnknownNameError: there is no such operator, or the operator doesn't do that task.
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
        """All blocks of all operators."""
        for code in self.codes:
            yield from self.blocks(code)

    def enrol(
        self, operator: str, tasks: Sequence[str] | None = None, *, absent: Sequence[str] = ()
    ) -> Plan:
        """The plan with an operator more, or with further tasks for one who is there.

        Args:
            operator: pseudonym.
            tasks: None for all of the study.
            absent: operators who withdrew and are left out: their rows are free.

        Raises:
            StudyError: the operator does all of these tasks already, or the code can't be one.
        """
        check_name(operator, "operator")
        wanted = [task.name for task in self.protocol.tasks] if tasks is None else list(tasks)
        present = [one for one in self.enrolled if one.code not in absent]
        new = enrolled(self.protocol, self.orders, present, operator, wanted)
        if operator not in self.codes:
            return replace(self, enrolled=(*self.enrolled, new))
        if new == self.enrolment(operator):
            raise StudyError(f"operator {operator} does {', '.join(wanted)} already")
        return replace(
            self, enrolled=tuple(new if one.code == operator else one for one in self.enrolled)
        )

    def withdraw(self, operator: str) -> Plan:
        """The plan without an operator; the next operator gets the row that is now used least."""
        self.enrolment(operator)
        return replace(self, enrolled=tuple(o for o in self.enrolled if o.code != operator))

    def replace_operator(self, operator: str, by: str) -> Plan:
        """The plan with a new operator who has the rows of one who left."""
        new = Enrolment(check_name(by, "operator"), dict(self.enrolment(operator).rows))
        return replace(self, enrolled=(*self.enrolled, new))

    def balance(self, task: str) -> Balance:
        """How evenly the operators of a task meet the conditions."""
        used = [self.orders[one.rows[task]] for one in self.enrolled if task in one.rows]
        return balance(used, self.protocol.condition_names)


def make_plan(protocol: Protocol) -> Plan:
    """Draws labels and square, and enrols the planned number of operators.

    Which condition takes which place in the square is drawn, and so is the order of its rows:
    the square alone would always favour the same neighbours in a study that ends early.
    """
    bare = [c.name for c in protocol.conditions if not c.label]
    taken = {c.label for c in protocol.conditions}
    labels = blind_labels(bare, taken, protocol.seed)
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
    """The same protocol with another number of operators, in the same shares of the tasks."""
    share = operators / protocol.operators
    counts = [
        operators
        if task.operators is None
        else min(operators, max(1, round(task.operators * share)))
        for task in protocol.tasks
    ]
    while sum(counts) < operators:  # rounded down once too often: someone would have nothing to do
        short = [
            protocol.planned(t) * share - n for t, n in zip(protocol.tasks, counts, strict=True)
        ]
        counts[short.index(max(short))] += 1
    tasks = tuple(
        task if task.operators is None else replace(task, operators=count)
        for task, count in zip(protocol.tasks, counts, strict=True)
    )
    return replace(protocol, operators=operators, tasks=tasks)
