"""Computes the content of both pages, as plain values for JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import datetime
from typing import Any, Final

from smooth_operator.errors import StudyError
from smooth_operator_study.design.forms import FormField
from smooth_operator_study.design.plan import Block, Plan
from smooth_operator_study.store.events import (
    BlockEnded,
    BreakStarted,
    Event,
    FormAnswered,
    Naming,
    QuestionnaireAnswered,
    Recalibrated,
    Record,
    Undone,
)
from smooth_operator_study.store.nasa_tlx import ENGLISH, HIGHEST, STEP, TlxWords
from smooth_operator_study.store.progress import Progress, check_event

TRIAL_S: Final = 40.0
"""Assumed duration of a trial before the first trial was done [s]."""
BETWEEN_S: Final = 15.0
"""Assumed time from the end of a trial to the start of the next [s]."""
QUESTIONNAIRE_S: Final = 60.0
"""Assumed time of a questionnaire [s]."""
BLOCK_S: Final = 60.0
"""Assumed time of switching and explaining at the start of a block [s]."""
_BEFORE_BLOCK: Final = ("form", "calibrate", "start_block", "start_familiarisation", "break")
_LONGEST_LOG: Final = 250
_TRIAL: Final = ("score", "line", "time_s", "resets", "amended")


def naming_for(plan: Plan, blind: bool) -> Naming:
    """Returns the function from the name of a condition to what the experimenter sees."""
    labels = {c.name: c.label for c in plan.protocol.conditions}

    def naming(name: str) -> str:
        label = labels.get(name, "")
        if blind:
            return label or "?"
        return f"{label} ({name})" if label else name

    return naming


# The operator's page.


def operator_view(
    plan: Plan, current: Progress | None, words: TlxWords = ENGLISH
) -> dict[str, Any]:
    """Returns the content of the operator's page."""
    view: dict[str, Any] = {
        "study": plan.protocol.name,
        "what": "wait",
        "operator": None,
        "texts": dict(words.texts),
    }
    if current is None:
        return view
    step = current.step
    undone = sum(isinstance(record.event, Undone) for record in current.records)
    where = "" if step.block is None else f"{step.block.task.name}/{step.block.number}"
    name = step.point or step.form or ""
    view |= {
        "operator": current.operator,
        "after": current.number,
        "step": step.what,
        # Identifies a questionnaire, also one that is asked again after an undo.
        "key": f"{current.operator}/{where}/{step.what}/{name}/{undone}",
    }
    if step.what == "break":
        view["what"] = "break"
    elif step.what in ("done", "withdrawn", "refused"):
        view["what"] = "done"
    if step.what == "form":
        form = next(form for form in plan.protocol.forms if form.name == step.form)
        return {
            **view,
            "what": "form",
            "form": form.name,
            "title": form.heading,
            "text": form.text,
            "fields": [_field(field, current) for field in form.fields],
        }
    if step.block is None:
        return view
    view |= _place(step.block, current)
    if step.what == "questionnaire":
        view |= {
            "what": "questionnaire",
            "point": step.point,
            "trial": step.trial,
            "scales": [asdict(scale) for scale in words.scales],
            "step_of_scale": STEP,
            "highest": HIGHEST,
        }
    return view


def _field(field: FormField, progress: Progress) -> dict[str, Any]:
    view = asdict(field)
    if field.kind == "ranking":
        view["ranked"] = [
            {"label": label, "where": _met(label, progress)} for label in progress.ranked_labels()
        ]
    return view


def _met(label: str, progress: Progress) -> str:
    """Names the blocks in which an operator has met a label, as a reminder."""
    blocks = {trial.block.place: trial.block for trial in progress.trials}
    return ", ".join(
        f"{block.task.title or block.task.name}, block {block.number}"
        for block in blocks.values()
        if block.condition.label == label
    )


def _place(block: Block, progress: Progress) -> dict[str, Any]:
    return {
        "task": block.task.name,
        "title": block.task.title or block.task.name,
        "instruction": block.task.instruction,
        "block": block.number,
        "blocks": sum(b.task.name == block.task.name for b in progress.blocks),
        "trials": block.task.trials,
        "limit_s": block.task.time_limit_s,
    }


# The experimenter's page.


def experimenter_view(
    plan: Plan,
    everyone: Sequence[Progress],
    current: Progress | None,
    blind: bool,
) -> dict[str, Any]:
    """Returns the content of the experimenter's page that comes from the store."""
    naming = naming_for(plan, blind)
    return {
        "study": _study_view(plan, blind),
        "overview": [_overview(progress, naming) for progress in everyone],
        "now": None if current is None else step_view(current, naming),
        "log": [] if current is None else log_view(current, naming),
    }


def _study_view(plan: Plan, blind: bool) -> dict[str, Any]:
    protocol = plan.protocol
    return {
        "name": protocol.name,
        "blind": blind,
        "tasks": [
            {
                "name": task.name,
                "title": task.title or task.name,
                "rubric": [asdict(line) for line in task.rubric],
            }
            for task in protocol.tasks
        ],
        "reset_cap": protocol.reset_cap,
        "familiarisation_s": protocol.familiarisation_s,
        "break_s": protocol.break_s,
        "rate_hz": protocol.rate_hz,
    }


def _overview(progress: Progress, naming: Naming) -> dict[str, Any]:
    """Blocks and next step of one operator."""
    step = progress.step
    blocks = []
    for block in progress.blocks:
        key = block.place
        state = "done" if progress.finished(block) else "on" if block == step.block else "next"
        blocks.append(
            {
                "task": block.task.name,
                "number": block.number,
                "condition": naming(block.condition.name),
                "trials": block.task.trials,
                "scored": progress.scored[key],
                "state": "left" if key in progress.ended_early else state,
            }
        )
    return {
        "operator": progress.operator,
        "step": str(step),
        "what": step.what,
        "begun": progress.number > 0,
        "blocks": blocks,
    }


def step_view(progress: Progress, naming: Naming) -> dict[str, Any]:
    """Returns the step that is due for an operator, with the rubric of the current task."""
    step, protocol = progress.step, progress.plan.protocol
    left, last = progress.withdrawn, progress.undoable
    view: dict[str, Any] = {
        "operator": progress.operator,
        "what": step.what,
        "trial": step.trial,
        "point": step.point,
        "since": _milliseconds(step.since),
        "after": progress.number,
        "words": str(step),
        "form": step.title or None,
        "break_possible": can_happen(progress, BreakStarted()),
        "break_due": break_is_due(progress),
        # The time of the work that is left: while nobody works it does not run.
        "minutes_left": round(time_left(progress) / 60),
        "scored": _scored_view(progress, naming),
        "withdrawn": left and {"keep": left.keep, "reason": left.reason},
        "undoable": last and {"number": last.number, "text": _text(progress, last, naming)},
    }
    if step.block is None:
        return view
    running = progress.running
    resets = running.resets if running is not None else 0
    return (
        view
        | _place(step.block, progress)
        | {
            "condition": naming(step.block.condition.name),
            "paused_ms": 0.0 if running is None else 1e3 * running.paused_s,
            "started": None if running is None else _milliseconds(running.started),
            "can_calibrate": can_happen(progress, Recalibrated(step.block.task.name)),
            "can_end_block": can_happen(progress, BlockEnded(*step.block.place, "asked")),
            "resets": resets,
            "resets_left": max(0, protocol.resets - resets),
            "reset_cap": protocol.reset_cap,
            "undone_time_s": running.undone_time_s if running is not None else None,
            # A line that the trial can't end with, after its resets, is not possible.
            "rubric": [
                {**asdict(line), "possible": line.possible(resets, protocol.reset_cap)}
                for line in step.block.task.rubric
            ],
        }
    )


def time_left(progress: Progress) -> float:
    """Estimates the time for an operator's remaining blocks [s] from the trials so far."""
    protocol = progress.plan.protocol
    times = [t.time_s for t in progress.trials if t.counts and t.time_s is not None]
    answered = Counter((task, block) for task, block, _ in progress.answered)
    left = 0.0
    for block in progress.blocks:
        if progress.over or progress.finished(block):
            continue
        key = block.place
        limit = block.task.time_limit_s
        guess = TRIAL_S if limit is None else min(TRIAL_S, limit / 2)
        trial_s = sum(times) / len(times) if times else guess
        left += (block.task.trials - progress.scored[key]) * (trial_s + BETWEEN_S)
        left += (len(block.questionnaires) - answered[key]) * QUESTIONNAIRE_S
        if progress.scored[key]:
            continue
        begun = progress.step.block == block and progress.step.what not in _BEFORE_BLOCK
        if not begun:
            left += protocol.familiarisation_s + BLOCK_S
        elif progress.step.what == "familiarise":
            left += protocol.familiarisation_s
    if not progress.over:
        left += QUESTIONNAIRE_S * sum(form.name not in progress.forms for form in protocol.forms)
    every = protocol.break_every
    if every and not progress.over:
        done = sum(progress.finished(block) for block in progress.blocks)
        ahead = range(done + 1, len(progress.blocks))  # none after the last block
        left += protocol.break_s * (sum(k % every == 0 for k in ahead) + break_is_due(progress))
    return left


def break_is_due(progress: Progress) -> bool:
    """True between blocks if the plan offers a break and there was none since the last trial."""
    every = progress.plan.protocol.break_every
    finished = sum(progress.finished(block) for block in progress.blocks)
    if progress.step.what not in ("calibrate", "start_block") or not every or not finished:
        return False
    last = progress.trials[-1].started if progress.trials else None
    rested = bool(progress.breaks) and (last is None or progress.breaks[-1][0] > last)
    return finished % every == 0 and not rested


def _scored_view(progress: Progress, naming: Naming) -> list[dict[str, Any]]:
    """Blocks with their scored trials, which can be amended."""
    blocks: dict[tuple[str, int], dict[str, Any]] = {}
    for trial in progress.trials:
        if not trial.counts:
            continue
        task, block = trial.block.place
        condition = naming(trial.block.condition.name)
        view = {"task": task, "block": block, "condition": condition, "trials": []}
        facts = {name: getattr(trial, name) for name in _TRIAL}
        blocks.setdefault((task, block), view)["trials"].append({"trial": trial.number, **facts})
    return list(blocks.values())


def can_happen(progress: Progress, event: Event) -> bool:
    """True if the protocol allows an event now."""
    try:
        check_event(progress, event)
    except StudyError:
        return False
    return True


def log_view(progress: Progress, naming: Naming) -> list[dict[str, Any]]:
    """Returns the audit trail, newest first, with undone events marked."""
    undone = {r.event.number for r in progress.records if isinstance(r.event, Undone)}
    return [
        {
            "number": record.number,
            "at": _milliseconds(record.at),
            "author": record.author,
            "kind": record.event.kind,
            "text": _text(progress, record, naming),
            "undone": record.number in undone,
        }
        for record in reversed(progress.records[-_LONGEST_LOG:])
    ]


def _text(progress: Progress, record: Record, naming: Naming) -> str:
    """Describes an event, without the workload of a block whose trials are still scored."""
    event = record.event
    if isinstance(event, FormAnswered):
        headings = {form.name: form.heading for form in progress.plan.protocol.forms}
        event = replace(event, form=headings.get(event.form, event.form))
    workload = not isinstance(event, QuestionnaireAnswered) or any(
        block.place == (event.task, event.block) and progress.finished(block)
        for block in progress.blocks
    )
    return event.describe(naming, workload=workload)


def _milliseconds(moment: datetime | None) -> float | None:
    return None if moment is None else 1e3 * moment.timestamp()
