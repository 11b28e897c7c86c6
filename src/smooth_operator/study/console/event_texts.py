"""Steps and events in words for people; conditions by what ``named`` calls them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from smooth_operator.study.design.plan import Plan
from smooth_operator.study.store.events import (
    Amended,
    Answered,
    BlockEnded,
    BlockStarted,
    BreakEnded,
    BreakStarted,
    Calibrated,
    Chosen,
    FamiliarisationEnded,
    FamiliarisationStarted,
    FormAnswered,
    FormOnPaper,
    Noted,
    Recalibrated,
    Record,
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
from smooth_operator.study.store.nasa_tlx import raw_workload
from smooth_operator.study.store.operator_state import Step

Named: TypeAlias = Callable[[str], str]


def naming(plan: Plan, blind: bool) -> Named:
    """From the name of a condition to what the experimenter sees."""
    labels = {c.name: c.label for c in plan.protocol.conditions}

    def named(name: str) -> str:
        label = labels.get(name, "")
        if blind:
            return label or "?"
        return f"{label} ({name})" if label else name

    return named


def step_in_words(step: Step) -> str:
    """What is due, short."""
    if step.block is None:
        plain = {
            "withdrawn": "withdrawn",
            "refused": "consent refused",
            "form": f"form {step.form}",
        }
        return plain.get(step.what, "done")
    where = f"{step.block.task.name}, block {step.block.number}"
    match step.what:
        case "calibrate":
            return f"calibration for {step.block.task.name}"
        case "start_block":
            return f"start of {where}"
        case "start_familiarisation" | "familiarise":
            return f"free movement, {where}"
        case "start_trial" | "trial" | "paused":
            return f"trial {step.trial}, {where}" + (" (paused)" if step.what == "paused" else "")
        case "questionnaire":
            return f"questionnaire ({step.point}), {where}"
        case "weights":
            return f"pairs of scales, {where}"
    return f"break, {where}"


def event_in_words(record: Record, named: Named, *, sums: bool = True) -> str:
    """What happened, in a line; ``sums`` is whether the workload may be known already."""
    event = record.event
    match event:
        case Calibrated():
            return f"Calibrated for {event.task}" + (f": {event.detail}" if event.detail else "")
        case BlockStarted():
            return f"Block {event.block} of {event.task} began: {named(event.condition)}"
        case FamiliarisationStarted():
            return "Free movement began"
        case FamiliarisationEnded():
            return "Free movement ended"
        case TrialStarted():
            return f"Trial {event.trial} started"
        case TrialReset():
            return f"Trial {event.trial}: object put back"
        case TrialScored():
            seconds = f"{event.time_s:.1f}\u00a0s"
            return f"Trial {event.trial}: {event.line}, score {event.score:g}, {seconds}"
        case TrialVoided():
            return f"Trial {event.trial} void: {event.reason or 'no reason given'}"
        case Answered():
            how = _how(event.who)
            if not sums:  # who scores the rest of the block is not to know
                return f"Questionnaire ({event.point}) {how}"
            workload = f"workload {raw_workload(event.ratings):.0f}"
            more = f", {how}" if event.who else ""
            return f"Questionnaire ({event.point}): {workload}{more}"
        case Weighed():
            return f"Pairs of scales {_how(event.who)}"
        case BreakStarted():
            return "Break began"
        case BreakEnded():
            return "Break ended"
        case Noted():
            return f"Note: {event.text}"
        case Undone():
            return f"Event {event.number} undone" + _why(event.reason)
        case _:
            return _of_the_day(record)


def _of_the_day(record: Record) -> str:
    """What departs from the plan, in a line."""
    event = record.event
    match event:
        case TrialPaused():
            return f"Trial {event.trial}: clock paused" + _why(event.reason)
        case TrialResumed():
            return f"Trial {event.trial}: clock goes on after {event.paused_s:.1f}\u00a0s"
        case Amended():
            now = f"{event.line}, score {event.score:g}, {event.time_s:.1f}\u00a0s"
            where = f"Trial {event.trial} of {event.task}, block {event.block}"
            by = f" ({event.who})" if event.who else ""
            return f"{where} amended to {now}: {event.reason}{by}"
        case BlockEnded():
            return f"Block {event.block} of {event.task} ended early: {event.reason}"
        case Recalibrated():
            return f"Calibrated again for {event.task}" + _why(event.detail)
        case Withdrawn():
            kept = "the data is kept" if event.keep else "the data is left out"
            return f"Withdrew, {kept}" + _why(event.reason)
        case Replaces():
            return f"Takes the place of {event.operator}"
        case Chosen():
            before = f", {event.before} was on" if event.before else ""
            return f"{event.operator} was put on{before}"
        case FormAnswered():
            if not event.who:
                return f"Form {event.form} filled in"
            return f"Form {event.form} typed in by {event.who}" + _why(event.reason)
        case FormOnPaper():
            return f"Form {event.form} is on paper ({event.who})"
    return event.kind


def _how(who: str) -> str:
    return f"typed in from paper by {who}" if who else "answered"


def _why(text: str) -> str:
    return f": {text}" if text else ""
