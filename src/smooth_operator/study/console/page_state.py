"""Content of both pages as plain values for JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Any, Final

from smooth_operator.errors import StudyError
from smooth_operator.study.design.forms import Form, FormField
from smooth_operator.study.design.plan import Block, Plan
from smooth_operator.study.store.events import (
    BlockEnded,
    BreakStarted,
    Event,
    Named,
    QuestionnaireAnswered,
    Recalibrated,
    Record,
    Undone,
)
from smooth_operator.study.store.nasa_tlx import (
    ENGLISH,
    HIGHEST,
    PAIRS,
    STEP,
    TlxWords,
    shown_pairs,
)
from smooth_operator.study.store.operator_state import Step
from smooth_operator.study.store.progress import Progress


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
    """The step that is due, in a few words."""
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


TRIAL_S: Final = 40.0
"""A trial whose length nobody knows yet [s]."""
BETWEEN_S: Final = 15.0
"""From the end of a trial to the start of the next [s]."""
QUESTIONNAIRE_S: Final = 60.0
"""Six scales, or the fifteen pairs [s]."""
BLOCK_S: Final = 60.0
"""Switching, explaining [s]."""
_BEFORE_BLOCK: Final = ("form", "calibrate", "start_block", "start_familiarisation", "break")


def time_left(progress: Progress) -> float:
    """Time for an operator's remaining blocks [s], by the times of the trials so far."""
    protocol = progress.plan.protocol
    scored = [trial for trial in progress.trials if trial.counts]
    times = [trial.time_s for trial in scored if trial.time_s is not None]
    answered = Counter((task, block) for task, block, _ in progress.answered)
    left, blocks = 0.0, 0
    for block in progress.blocks:
        if progress.over or progress.finished(block):
            continue
        key = (block.task.name, block.number)
        limit = block.task.time_limit_s
        guess = TRIAL_S if limit is None else min(TRIAL_S, limit / 2)
        trial_s = sum(times) / len(times) if times else guess
        left += (block.task.trials - progress.scored[key]) * (trial_s + BETWEEN_S)
        left += (len(block.questionnaires) - answered[key]) * QUESTIONNAIRE_S
        left += QUESTIONNAIRE_S * (protocol.weights and bool(block.questionnaires))
        if progress.scored[key]:
            continue
        blocks += 1
        begun = progress.step.block == block and progress.step.what not in _BEFORE_BLOCK
        if not begun:
            left += protocol.familiarisation_s + BLOCK_S
        elif progress.step.what == "familiarise":
            left += protocol.familiarisation_s
    if not progress.over:
        left += QUESTIONNAIRE_S * sum(not form["answers"] for form in forms_view(progress))
    every = protocol.break_every
    return left + (protocol.break_s * (blocks // every) if every else 0.0)


def break_is_due(progress: Progress) -> bool:
    """True if the plan offers a break now: between blocks, and there was none since the last."""
    every = progress.plan.protocol.break_every
    finished = sum(progress.finished(block) for block in progress.blocks)
    if progress.step.what not in ("calibrate", "start_block") or not every or not finished:
        return False
    last = progress.trials[-1].started if progress.trials else None
    rested = bool(progress.breaks) and (last is None or progress.breaks[-1][0] > last)
    return finished % every == 0 and not rested


def form_view(progress: Progress, form: Form) -> dict[str, Any]:
    """A form with its fields, for an operator."""
    return {
        "form": form.name,
        "title": form.title or form.name,
        "text": form.text,
        "fields": [_field(field, progress) for field in form.fields],
    }


def forms_view(progress: Progress) -> list[dict[str, Any]]:
    """The forms of an operator as the experimenter sees them: which are filled in, and by whom.

    ``state`` is ``filled``, ``paper`` (to be typed in), ``due`` or ``later``; ``can`` is whether it
    may be typed in now.
    """
    views = []
    for form in progress.plan.protocol.forms:
        at, answers = progress.forms.get(form.name, (None, None))
        who = progress.typed.get(form.name, "")
        state = "filled"
        if answers is None and form.name in progress.on_paper:
            state = "paper"
            at, who = progress.on_paper[form.name]
        elif answers is None:
            state = "due" if progress.step.form == form.name else "later"
        views.append(
            {
                **form_view(progress, form),
                "state": state,
                "at": None if at is None else 1e3 * at.timestamp(),
                "who": who,
                "answers": answers,
                "can": progress.can_type(form),
            }
        )
    return views


def _field(field: FormField, progress: Progress) -> dict[str, Any]:
    view = asdict(field)
    if field.kind == "ranking":
        view["ranked"] = [
            {"label": label, "where": _met(label, progress)} for label in progress.ranked_labels()
        ]
    return view


def _met(label: str, progress: Progress) -> str:
    """In which blocks an operator has met a label: what they remember it by."""
    blocks = {(t.block.task.name, t.block.number): t.block for t in progress.trials}
    return ", ".join(
        f"{block.task.title or block.task.name}, block {block.number}"
        for block in blocks.values()
        if block.condition.label == label
    )


def operator_view(
    plan: Plan, current: Progress | None, words: TlxWords = ENGLISH
) -> dict[str, Any]:
    """All of the operator's page."""
    view: dict[str, Any] = {
        "study": plan.protocol.name,
        "what": "wait",
        "operator": None,
        "texts": dict(words.texts),
    }
    if current is None:
        return view
    step = current.step
    view |= {"operator": current.operator, "after": current.number, "step": step.what}
    if step.what == "break" or _nothing_follows(step):
        view["what"] = "break" if step.what == "break" else "done"
    view["key"] = asked_key(current, step)
    if step.what == "form":
        form = next(form for form in plan.protocol.forms if form.name == step.form)
        return {**view, "what": "form", **form_view(current, form)}
    if step.block is None:
        return view
    view |= place(step.block, None, current)
    if step.what == "questionnaire":
        view |= {"what": "questionnaire", "point": step.point, "trial": step.trial}
        view |= scales_view(words)
    elif step.what == "weights":
        shown = shown_pairs(plan.protocol.seed, current.operator)
        view |= {"what": "weights", "pairs": pairs_view(words, shown)}
    return view


def scales_view(words: TlxWords) -> dict[str, Any]:
    """The six scales of NASA-TLX."""
    return {
        "scales": [asdict(scale) for scale in words.scales],
        "step_of_scale": STEP,
        "highest": HIGHEST,
    }


def pairs_view(words: TlxWords, shown: Sequence[tuple[str, str]] = PAIRS) -> list[dict[str, Any]]:
    """Pairs of scales, each with its place among those of the instrument."""
    scales = {scale.name: asdict(scale) for scale in words.scales}
    return [
        {
            "place": PAIRS.index((left, right) if (left, right) in PAIRS else (right, left)),
            "scales": [scales[left], scales[right]],
        }
        for left, right in shown
    ]


def _nothing_follows(step: Step) -> bool:
    """True if nothing more is asked of the operator."""
    return step.what in ("done", "withdrawn", "refused")


def asked_key(progress: Progress, step: Step) -> str:
    """Identifies one questionnaire, one that is asked again after an undo included."""
    undone = sum(isinstance(record.event, Undone) for record in progress.records)
    block = step.block
    where = "" if block is None else f"{block.task.name}/{block.number}"
    name = step.point or step.form or ""
    return f"{progress.operator}/{where}/{step.what}/{name}/{undone}"


def place(block: Block, condition: str | None, progress: Progress) -> dict[str, Any]:
    """Task, block and session of something."""
    place = {
        "task": block.task.name,
        "title": block.task.title or block.task.name,
        "instruction": block.task.instruction,
        "block": block.number,
        "blocks": sum(b.task.name == block.task.name for b in progress.blocks),
        "session": block.session,
        "sessions": len({b.task.name for b in progress.blocks}),
        "trials": block.task.trials,
        "limit_s": block.task.time_limit_s,
    }
    return place if condition is None else {**place, "condition": condition}


_LONGEST_LOG: Final = 250


def study_view(plan: Plan, blind: bool) -> dict[str, Any]:
    """The part of the page that does not change while operators come and go."""
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
        "resets": protocol.resets,
        "rate_hz": protocol.rate_hz,
    }


def overview(progress: Progress, named: Named) -> dict[str, Any]:
    """One operator's blocks, and what is due."""
    step = progress.step
    blocks = []
    for block in progress.blocks:
        key = (block.task.name, block.number)
        state = "done" if progress.finished(block) else "on" if block == step.block else "next"
        blocks.append(
            {
                "task": block.task.name,
                "number": block.number,
                "condition": named(block.condition.name),
                "trials": block.task.trials,
                "scored": progress.scored[key],
                "state": "left" if key in progress.ended_early else state,
            }
        )
    return {
        "operator": progress.operator,
        "step": step_in_words(step),
        "what": step.what,
        "begun": progress.number > 0,
        "replaces": progress.replaces,
        "blocks": blocks,
    }


def step_view(progress: Progress, named: Named, words: TlxWords = ENGLISH) -> dict[str, Any]:
    """The step that is due for an operator, with the rubric of the current task.

    ``asked`` is NASA-TLX as it is asked now, for typing in what stands on paper.
    """
    step, protocol = progress.step, progress.plan.protocol
    view: dict[str, Any] = {
        "operator": progress.operator,
        "what": step.what,
        "trial": step.trial,
        "point": step.point,
        "since": _milliseconds(step.since),
        "after": progress.number,
        "words": step_in_words(step),
        "form": step.form,
        "asked": asked_view(progress, words),
        "break_possible": can_happen(progress, BreakStarted()),
        "break_due": break_is_due(progress),
        "ends": None,
        "scored": scored_view(progress, named),
        "forms": forms_view(progress),
        "withdrawn": None,
        "undoable": None,
    }
    if progress.records:  # counted from the last event, so that the page's clock runs
        view["ends"] = 1e3 * (progress.records[-1].at.timestamp() + time_left(progress))
    if (left := progress.withdrawn) is not None:
        view["withdrawn"] = {"keep": left.keep, "reason": left.reason}
    if (last := progress.undoable) is not None:
        view["undoable"] = {
            "number": last.number,
            "text": last.event.in_words(named, sums=_is_known(progress, last)),
        }
    if step.block is None:
        return view
    view |= place(step.block, named(step.block.condition.name), progress)
    running = progress.running
    resets = running.resets if running is not None else 0
    view |= {
        "paused_ms": 0.0 if running is None else 1e3 * running.paused_s,
        "started": None if running is None else _milliseconds(running.started),
        "can_calibrate": can_happen(progress, Recalibrated(step.block.task.name)),
        "can_end_block": can_happen(
            progress, BlockEnded(step.block.task.name, step.block.number, "asked")
        ),
        "resets": resets,
        "resets_left": max(0, protocol.resets - resets),
        "reset_cap": protocol.reset_cap,
        "undone_time_s": running.undone_time_s if running is not None else None,
        "rubric": rubric_view(step.block, resets, protocol.reset_cap),
    }
    return view


def asked_view(progress: Progress, words: TlxWords) -> dict[str, Any] | None:
    """The scales or the pairs that are due, in the order of the instrument; None without them."""
    what = progress.step.what
    if what not in ("questionnaire", "weights"):
        return None
    view = scales_view(words) if what == "questionnaire" else {"pairs": pairs_view(words)}
    return {"key": asked_key(progress, progress.step), **view}


def scored_view(progress: Progress, named: Named) -> list[dict[str, Any]]:
    """Blocks with their scored trials, which can be amended."""
    blocks: dict[tuple[str, int], dict[str, Any]] = {}
    for trial in progress.trials:
        if not trial.counts:
            continue
        key = (trial.block.task.name, trial.block.number)
        block = blocks.setdefault(
            key,
            {
                "task": key[0],
                "block": key[1],
                "condition": named(trial.block.condition.name),
                "trials": [],
            },
        )
        block["trials"].append(
            {
                "trial": trial.number,
                "score": trial.score,
                "line": trial.line,
                "time_s": trial.time_s,
                "resets": trial.resets,
                "amended": trial.amended,
            }
        )
    return list(blocks.values())


def can_happen(progress: Progress, event: Event) -> bool:
    """True if the protocol allows an event now."""
    try:
        progress.check(event)
    except StudyError:
        return False
    return True


def rubric_view(block: Block, resets: int, cap: float) -> list[dict[str, Any]]:
    """Lines of the rubric; off are those by which the trial can't end, with its resets."""
    return [{**asdict(line), "possible": line.possible(resets, cap)} for line in block.task.rubric]


def log_view(progress: Progress, named: Named) -> list[dict[str, Any]]:
    """The audit trail, newest first, undone events marked."""
    undone = {r.event.number for r in progress.records if isinstance(r.event, Undone)}
    return [
        {
            "number": record.number,
            "at": _milliseconds(record.at),
            "author": record.author,
            "kind": record.event.kind,
            "text": record.event.in_words(named, sums=_is_known(progress, record)),
            "undone": record.number in undone,
        }
        for record in reversed(progress.records[-_LONGEST_LOG:])
    ]


def _is_known(progress: Progress, record: Record) -> bool:
    """True if who scores may know the workload of an event: not before its block is over."""
    event = record.event
    return not isinstance(event, QuestionnaireAnswered) or any(
        block.task.name == event.task and block.number == event.block and progress.finished(block)
        for block in progress.blocks
    )


def experimenter_view(
    plan: Plan,
    everyone: Sequence[Progress],
    current: Progress | None,
    blind: bool,
    words: TlxWords = ENGLISH,
) -> dict[str, Any]:
    """All of the experimenter's page that comes from the store."""
    named = naming(plan, blind)
    return {
        "study": study_view(plan, blind),
        "overview": [overview(progress, named) for progress in everyone],
        "now": None if current is None else step_view(current, named, words),
        "log": [] if current is None else log_view(current, named),
    }


def _milliseconds(moment: datetime | None) -> float | None:
    return None if moment is None else 1e3 * moment.timestamp()
