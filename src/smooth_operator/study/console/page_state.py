"""What the two pages show, as plain values for JSON. The operator's never holds a condition."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from typing import Any, Final

from smooth_operator.study.console.event_texts import Named, event_in_words, naming, step_in_words
from smooth_operator.study.design.plan import Block, Plan
from smooth_operator.study.store.events import Undone
from smooth_operator.study.store.nasa_tlx import HIGHEST, PAIRS, SCALES, STEP
from smooth_operator.study.store.progress import Progress, Step

_LONGEST_LOG: Final = 250


def study_view(plan: Plan, blind: bool) -> dict[str, Any]:
    """What does not change while operators come and go."""
    protocol = plan.protocol
    return {
        "name": protocol.name,
        "blind": blind,
        "tasks": [{"name": t.name, "title": t.title or t.name} for t in protocol.tasks],
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
    due = None if step.block is None else (step.block.task.name, step.block.number)
    blocks = []
    passed = True  # blocks before the one that is due are finished
    for block in progress.blocks:
        key = (block.task.name, block.number)
        passed = passed and key != due
        blocks.append(
            {
                "task": block.task.name,
                "number": block.number,
                "condition": named(block.condition.name),
                "trials": block.task.trials,
                "scored": scored[key],
                "state": "done" if passed else "on" if key == due else "next",
            }
        )
    return {
        "operator": progress.operator,
        "step": step_in_words(step),
        "what": step.what,
        "begun": progress.number > 0,
        "blocks": blocks,
    }


def step_view(progress: Progress, named: Named) -> dict[str, Any]:
    """What is due for an operator, with the rubric of the current task."""
    step, protocol = progress.step, progress.plan.protocol
    view: dict[str, Any] = {
        "operator": progress.operator,
        "what": step.what,
        "trial": step.trial,
        "point": step.point,
        "since": _milliseconds(step.since),
        "after": progress.number,
        "words": step_in_words(step),
        "break_possible": step.what not in ("break", "trial", "familiarise", "done"),
        "undoable": None,
    }
    if (last := progress.undoable) is not None:
        view["undoable"] = {"number": last.number, "text": event_in_words(last, named)}
    if step.block is None:
        return view
    view |= _place(step.block, named(step.block.condition.name), progress)
    running = progress.running
    resets = running.resets if running is not None else 0
    view |= {
        "resets": resets,
        "resets_left": max(0, protocol.resets - resets),
        "reset_cap": protocol.reset_cap,
        "undone_time_s": running.undone_time_s if running is not None else None,
        "rubric": rubric_view(step.block, resets, protocol.reset_cap),
        "results": [
            {"trial": t.number, "score": t.score, "line": t.line, "time_s": t.time_s}
            for t in progress.trials
            if t.block == step.block and t.score is not None
        ],
    }
    return view


def rubric_view(block: Block, resets: int, cap: float) -> list[dict[str, Any]]:
    """Lines of the rubric; after a reset those that score more than is possible are off."""
    return [
        {
            "name": line.name,
            "score": line.score,
            "text": line.text,
            "possible": not resets or line.score <= cap,
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
            "text": event_in_words(record, named),
            "undone": record.number in undone,
        }
        for record in reversed(progress.records[-_LONGEST_LOG:])
    ]


def experimenter_view(
    plan: Plan, everyone: Sequence[Progress], current: Progress | None, blind: bool
) -> dict[str, Any]:
    """All of the experimenter's page that comes from the store."""
    named = naming(plan, blind)
    return {
        "study": study_view(plan, blind),
        "overview": [overview(progress, named) for progress in everyone],
        "now": None if current is None else step_view(current, named),
        "log": [] if current is None else log_view(current, named),
    }


def operator_view(plan: Plan, current: Progress | None) -> dict[str, Any]:
    """All of the operator's page."""
    view: dict[str, Any] = {"study": plan.protocol.name, "what": "wait", "operator": None}
    if current is None:
        return view
    step = current.step
    view |= {"operator": current.operator, "after": current.number, "step": step.what}
    if step.what in ("break", "done"):
        view["what"] = step.what
    if step.block is None:
        return view
    view |= _place(step.block, None, current)
    if step.what == "questionnaire":
        view |= {
            "what": "questionnaire",
            "point": step.point,
            "trial": step.trial,
            "scales": [
                {"name": s.name, "title": s.title, "question": s.question,
                 "low": s.low, "high": s.high}
                for s in SCALES
            ],
            "step_of_scale": STEP,
            "highest": HIGHEST,
        }  # fmt: skip
    elif step.what == "weights":
        titles = {s.name: (s.title, s.question) for s in SCALES}
        view |= {
            "what": "weights",
            "pairs": [
                [{"name": n, "title": titles[n][0], "question": titles[n][1]} for n in pair]
                for pair in PAIRS
            ],
        }
    view["key"] = asked_key(current, step)
    return view


def asked_key(progress: Progress, step: Step) -> str:
    """Identifies one questionnaire, one that is asked again after an undo included."""
    undone = sum(isinstance(record.event, Undone) for record in progress.records)
    block = step.block
    where = "" if block is None else f"{block.task.name}/{block.number}"
    return f"{progress.operator}/{where}/{step.what}/{step.point or ''}/{undone}"


def _place(block: Block, condition: str | None, progress: Progress) -> dict[str, Any]:
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


def _milliseconds(moment: datetime | None) -> float | None:
    return None if moment is None else 1e3 * moment.timestamp()
