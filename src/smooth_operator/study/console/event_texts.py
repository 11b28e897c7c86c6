"""Steps and events in words for people; conditions by what ``named`` calls them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from smooth_operator.study.design.plan import Plan
from smooth_operator.study.store.events import (
    Answered,
    BlockStarted,
    BreakEnded,
    BreakStarted,
    Calibrated,
    FamiliarisationEnded,
    FamiliarisationStarted,
    Noted,
    Record,
    TrialReset,
    TrialScored,
    TrialStarted,
    TrialVoided,
    Undone,
    Weighed,
)
from smooth_operator.study.store.nasa_tlx import raw_workload
from smooth_operator.study.store.progress import Step

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
        return "done"
    where = f"{step.block.task.name}, block {step.block.number}"
    match step.what:
        case "calibrate":
            return f"calibration for {step.block.task.name}"
        case "start_block":
            return f"start of {where}"
        case "start_familiarisation" | "familiarise":
            return f"free movement, {where}"
        case "start_trial" | "trial":
            return f"trial {step.trial}, {where}"
        case "questionnaire":
            return f"questionnaire ({step.point}), {where}"
        case "weights":
            return f"pairs of scales, {where}"
    return f"break, {where}"


def event_in_words(record: Record, named: Named) -> str:
    """What happened, in a line."""
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
            return f"Questionnaire ({event.point}): workload {raw_workload(event.ratings):.0f}"
        case Weighed():
            return "Pairs of scales answered"
        case BreakStarted():
            return "Break began"
        case BreakEnded():
            return "Break ended"
        case Noted():
            return f"Note: {event.text}"
        case Undone():
            return f"Event {event.number} undone" + (f": {event.reason}" if event.reason else "")
