"""Progress of an operator in the protocol, computed from events and never stored.

Events are folded one after the other; each is checked against what the protocol wants next. What
was undone is left out, and the rest folded again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Final

from smooth_operator.errors import StudyError
from smooth_operator.study.design.plan import Block, Plan
from smooth_operator.study.store.events import (
    ASIDE,
    Amended,
    BlockEnded,
    BreakEnded,
    BreakStarted,
    Event,
    FormAnswered,
    FormOnPaper,
    Recalibrated,
    Record,
    Replaces,
    TrialReset,
    TrialScored,
    Undone,
    Withdrawn,
)  # fmt: skip
from smooth_operator.study.store.operator_state import (
    OperatorState,
    Step,
)

_UNBROKEN: Final = ("break", "trial", "paused", "familiarise", "refused", "withdrawn", "done")
"""Steps in which no break can begin."""
_UNCALIBRATED: Final = ("form", "calibrate", "trial", "paused", "refused", "withdrawn", "done")
"""Steps in which nothing can be calibrated once more."""


@dataclass
class Progress(OperatorState):
    """An operator's part of the study so far, which grows with each event.

    Attributes:
        records: all of the log, undone ones included.
    """

    records: list[Record] = field(default_factory=list)
    _effective: list[Record] = field(default_factory=list)

    @property
    def number(self) -> int:
        """Number of the last event; 0 before the first."""
        return len(self.records)

    @property
    def undoable(self) -> Record | None:
        """The event that ``Undone`` would take back now: the last that counts, asides left out."""
        for record in reversed(self._effective):
            if not isinstance(record.event, ASIDE):
                return record
        return None

    def undone(self) -> Counter[str]:
        """Condition -> how many events of its blocks were undone."""
        conditions = {(b.task.name, b.number): b.condition.name for b in self.blocks}
        counts: Counter[str] = Counter()
        for record in self.records:
            if isinstance(record.event, Undone):
                event = self.records[record.event.number - 1].event
                key = (getattr(event, "task", ""), getattr(event, "block", 0))
                if key in conditions:
                    counts[conditions[key]] += 1
        return counts

    def copy(self) -> Progress:
        """The same, which later events of this one don't change."""
        twin = Progress(self.plan, self.operator)
        for name, value in self.__dict__.items():
            same = value.copy() if isinstance(value, list | dict | set) else value
            twin.__dict__[name] = same
        twin.trials = [replace(trial) for trial in self.trials]
        return twin

    def apply(self, record: Record) -> None:
        """One event more.

        Raises:
            StudyError: it is not its turn; says what is.
        """
        self.check(record.event)
        if record.number != self.number + 1:
            raise StudyError(
                f"operator {self.operator}: event {record.number} follows event {self.number}; "
                "the log has lost something"
            )
        self.records.append(record)
        if isinstance(record.event, Undone):
            self._undo(record.event.number)
        else:
            self._take(record)

    def check(self, event: Event) -> None:
        """Refuses an event that is not due; changes nothing.

        Raises:
            StudyError: it is not its turn; says what is.
        """
        check_event(self, event)

    def _take(self, record: Record) -> None:
        self._effective.append(record)
        record.event.fold(self, record)

    def _undo(self, number: int) -> None:
        left_out = next(r for r in self._effective if r.number == number)
        remaining = [record for record in self._effective if record.number != number]
        records = self.records
        fresh = Progress(self.plan, self.operator)
        for record in remaining:
            fresh._take(record)
        self.__dict__.update(fresh.__dict__)
        self.records = records
        if isinstance(left_out.event, TrialScored):
            self.trials[-1].undone_time_s = left_out.event.time_s


def replay(plan: Plan, operator: str, records: Iterable[Record]) -> Progress:
    """An operator's progress from the log.

    Raises:
        StudyError: the log holds what the plan doesn't allow.
    """
    progress = Progress(plan, operator)
    for record in records:
        progress.apply(record)
    return progress


def check_event(state: Progress, event: Event) -> None:
    """Refuses an event that is not due; changes nothing.

    Raises:
        StudyError: it is not its turn; says what is.
    """
    step = state.step
    match event:
        case Replaces():
            if state.records:
                raise _refusal(state, "has begun already, and can't replace anybody")
            return
        case _ if isinstance(event, ASIDE):
            return
        case Undone():
            due = state.undoable
            if due is None or due.number != event.number:
                what = "nothing" if due is None else f"event {due.number} ({due.event.kind})"
                raise _refusal(state, f"event {event.number} can't be undone; {what} can")
        case Amended():
            _check_amendment(state, event)
        case Withdrawn():
            if state.withdrawn is not None:
                raise _refusal(state, "has withdrawn already")
        case FormAnswered() if event.who:
            _check_typed(state, event)
        case BreakStarted():
            if step.what in _UNBROKEN:
                raise _refusal(state, f"no break can begin: {named(step)} is on")
        case Recalibrated():
            if step.what in _UNCALIBRATED:
                raise _refusal(state, f"nothing can be calibrated now: {named(step)} is on")
            if step.block is not None:
                _check_place(state, event, step, step.block)
        case _:
            _check_due(state, event, step)


def _check_due(state: Progress, event: Event, step: Step) -> None:
    if step.what not in event.due:
        more = "; score or void its trial first" if isinstance(event, BlockEnded) else ""
        raise _refusal(state, f"{event.kind!r} is not due; {named(step)} is{more}")
    if isinstance(event, FormAnswered | FormOnPaper):
        form = next(f for f in state.plan.protocol.forms if f.name == step.form)
        if event.form != form.name:
            raise _refusal(state, f"form {event.form!r} is not due; {form.name!r} is")
        if isinstance(event, FormAnswered):
            form.check(event.answers, state.ranked_labels())
        elif not event.who.strip():
            raise _refusal(state, "who has the form on paper is missing; give initials")
    elif not isinstance(event, BreakEnded) and step.block is not None:
        _check_place(state, event, step, step.block)


def _check_typed(state: Progress, event: FormAnswered) -> None:
    """Refuses a form that an experimenter types in where that can't be."""
    form = next((f for f in state.plan.protocol.forms if f.name == event.form), None)
    if form is None or not state.can_type(form):
        reason = "the study has no such form" if form is None else "it is not due yet"
        raise _refusal(state, f"form {event.form!r} can't be typed in: {reason}")
    if form.name in state.forms and not event.reason.strip():
        raise _refusal(
            state, f"form {form.name!r} is filled in already; state why it is to be replaced"
        )
    form.check(event.answers, state.ranked_labels())
    if state.trials and form.when == "before" and form.refused(event.answers):
        raise _refusal(
            state, "a consent can't be refused once trials were done; withdraw the operator"
        )


def _check_place(state: Progress, event: Any, step: Step, block: Block) -> None:
    places = {
        "task": block.task.name,
        "block": block.number,
        "condition": block.condition.name,
        "trial": step.trial,
        "point": step.point,
    }
    for name, due in places.items():
        came = getattr(event, name, due)
        if came != due:
            raise _refusal(
                state,
                f"{event.kind!r} is for {name} {came!r}, but {name} {due!r} is on; reload the "
                "page if it was left open",
            )
    if isinstance(event, TrialReset):
        allowed, trial = state.plan.protocol.resets, state.running
        if trial is not None and trial.resets >= allowed:
            raise _refusal(state, f"a trial may have {allowed} reset(s), and this one had them")
    if isinstance(event, TrialScored) and event.score != (due := state.capped(event.line)):
        raise _refusal(
            state,
            f"line {event.line!r} of the rubric scores {due:g} in this trial, not {event.score:g}",
        )
    if isinstance(event, BlockEnded) and not event.reason.strip():
        raise _refusal(state, "a block is ended early for a reason; state it")


def _check_amendment(state: Progress, event: Amended) -> None:
    trial = state.scored_trial(event.task, event.block, event.trial)
    if not event.reason.strip():
        raise _refusal(state, "a trial is amended for a reason; state it")
    if event.score != (due := state.capped(event.line, trial)):
        raise _refusal(
            state,
            f"line {event.line!r} of the rubric scores {due:g} in this trial, not {event.score:g}",
        )
    if (event.line, event.time_s) == (trial.line, trial.time_s):
        raise _refusal(state, f"trial {event.trial} has that line and time already")


def _refusal(state: Progress, text: str) -> StudyError:
    return StudyError(f"operator {state.operator}: {text}")


def named(step: Step) -> str:
    """A step in a message."""
    where = "" if step.block is None else f" in block {step.block.number} of {step.block.task.name}"
    trial = "" if step.trial is None else f" {step.trial}"
    form = "" if step.form is None else f" {step.form!r}"
    return f"{step.what.replace('_', ' ')}{form}{trial}{where}"
