"""What the experimenter's page shows, as plain values for JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from typing import Any, Final

from smooth_operator.errors import StudyError
from smooth_operator.study.console.event_texts import naming, step_in_words
from smooth_operator.study.console.expected_time import break_is_due, time_left
from smooth_operator.study.console.form_views import forms_view
from smooth_operator.study.console.operator_view import (
    asked_key,
    pairs_view,
    place,
    scales_view,
)
from smooth_operator.study.design.plan import Block, Plan
from smooth_operator.study.store.events import (
    Answered,
    BlockEnded,
    BreakStarted,
    Event,
    Recalibrated,
    Record,
    Undone,
)
from smooth_operator.study.store.progress import Progress
from smooth_operator.study.store.tlx_words import ENGLISH, TlxWords

_LONGEST_LOG: Final = 250


def study_view(plan: Plan, blind: bool) -> dict[str, Any]:
    """What does not change while operators come and go."""
    protocol = plan.protocol
    return {
        "name": protocol.name,
        "blind": blind,
        "tasks": [
            {
                "name": task.name,
                "title": task.title or task.name,
                "rubric": [
                    {"name": line.name, "score": line.score, "text": line.text}
                    for line in task.rubric
                ],
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
    scored: Counter[tuple[str, int]] = Counter()
    for trial in progress.trials:
        if trial.score is not None and trial.void is None:
            scored[trial.block.task.name, trial.block.number] += 1
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
                "scored": scored[key],
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
    """What is due for an operator, with the rubric of the current task.

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
        "left_s": time_left(progress),
        "scored": scored_view(progress, named),
        "forms": forms_view(progress),
        "withdrawn": None,
        "undoable": None,
    }
    if (left := progress.withdrawn) is not None:
        view["withdrawn"] = {"keep": left.keep, "reason": left.reason}
    if (last := progress.undoable) is not None:
        view["undoable"] = {
            "number": last.number,
            "text": last.event.in_words(named, sums=_known(progress, last)),
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
    asked = scales_view(words) if what == "questionnaire" else {"pairs": pairs_view(words)}
    return {"key": asked_key(progress, progress.step), **asked}


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
    """Whether the protocol allows an event now."""
    try:
        progress.check(event)
    except StudyError:
        return False
    return True


def rubric_view(block: Block, resets: int, cap: float) -> list[dict[str, Any]]:
    """Lines of the rubric; off are those by which the trial can't end, with its resets."""
    return [
        {
            "name": line.name,
            "score": line.score,
            "text": line.text,
            "possible": line.possible(resets, cap),
        }
        for line in block.task.rubric
    ]


def log_view(progress: Progress, named: Named) -> list[dict[str, Any]]:
    """The audit trail, newest first, undone events marked."""
    undone = {r.event.number for r in progress.records if isinstance(r.event, Undone)}
    return [
        {
            "number": record.number,
            "at": _milliseconds(record.at),
            "author": record.author,
            "kind": record.event.kind,
            "text": record.event.in_words(named, sums=_known(progress, record)),
            "undone": record.number in undone,
        }
        for record in reversed(progress.records[-_LONGEST_LOG:])
    ]


def _known(progress: Progress, record: Record) -> bool:
    """Whether the workload of an event may be known to who scores: not before its block is over."""
    event = record.event
    return not isinstance(event, Answered) or any(
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
