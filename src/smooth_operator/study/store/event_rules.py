"""Which events may happen to an operator now: a log holds only what could have happened."""

from __future__ import annotations

from typing import Any, Final

from smooth_operator.errors import StudyError
from smooth_operator.study.design.plan import Block
from smooth_operator.study.store.events import (
    ASIDE,
    Amended,
    Answered,
    BlockEnded,
    BlockStarted,
    BreakEnded,
    BreakStarted,
    Calibrated,
    Event,
    FamiliarisationEnded,
    FamiliarisationStarted,
    FormAnswered,
    FormOnPaper,
    Recalibrated,
    Replaces,
    TrialPaused,
    TrialReset,
    TrialResumed,
    TrialScored,
    TrialStarted,
    TrialVoided,
    Undone,
    Weighed,
    Withdrawn,
)
from smooth_operator.study.store.operator_state import OperatorState, Step, What

_WANTED: Final[dict[What, tuple[type[Event], ...]]] = {
    "form": (FormAnswered, FormOnPaper),
    "calibrate": (Calibrated,),
    "start_block": (BlockStarted, BlockEnded),
    "start_familiarisation": (FamiliarisationStarted, BlockEnded),
    "familiarise": (FamiliarisationEnded,),
    "start_trial": (TrialStarted, BlockEnded),
    "trial": (TrialReset, TrialScored, TrialVoided, TrialPaused),
    "paused": (TrialReset, TrialVoided, TrialResumed),
    "questionnaire": (Answered, BlockEnded),
    "weights": (Weighed, BlockEnded),
    "break": (BreakEnded,),
    "refused": (),
    "withdrawn": (),
    "done": (),
}
_UNBROKEN: Final = ("break", "trial", "paused", "familiarise", "refused", "withdrawn", "done")
"""Steps in which no break can begin."""
_UNCALIBRATED: Final = ("form", "calibrate", "trial", "paused", "refused", "withdrawn", "done")
"""Steps in which nothing can be calibrated once more."""


def check_event(state: OperatorState, event: Event) -> None:
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


def _check_due(state: OperatorState, event: Event, step: Step) -> None:
    if not isinstance(event, _WANTED[step.what]):
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


def _check_typed(state: OperatorState, event: FormAnswered) -> None:
    """Refuses a form that an experimenter types in where that can't be."""
    form = next((f for f in state.plan.protocol.forms if f.name == event.form), None)
    if form is None or not state.can_type(form):
        known = "the study has no such form" if form is None else "it is not due yet"
        raise _refusal(state, f"form {event.form!r} can't be typed in: {known}")
    if form.name in state.forms and not event.reason.strip():
        raise _refusal(
            state, f"form {form.name!r} is filled in already; state why it is to be replaced"
        )
    form.check(event.answers, state.ranked_labels())
    if state.trials and form.when == "before" and form.refused(event.answers):
        raise _refusal(
            state, "a consent can't be refused once trials were done; withdraw the operator"
        )


def _check_place(state: OperatorState, event: Any, step: Step, block: Block) -> None:
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


def _check_amendment(state: OperatorState, event: Amended) -> None:
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


def _refusal(state: OperatorState, text: str) -> StudyError:
    return StudyError(f"operator {state.operator}: {text}")


def named(step: Step) -> str:
    """A step in a message."""
    where = "" if step.block is None else f" in block {step.block.number} of {step.block.task.name}"
    trial = "" if step.trial is None else f" {step.trial}"
    form = "" if step.form is None else f" {step.form!r}"
    return f"{step.what.replace('_', ' ')}{form}{trial}{where}"
