"""What the operator's page shows, as plain values for JSON. It never holds a condition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from smooth_operator.study.console.form_views import form_view
from smooth_operator.study.design.plan import Block, Plan
from smooth_operator.study.store.events import Undone
from smooth_operator.study.store.nasa_tlx import HIGHEST, PAIRS, STEP
from smooth_operator.study.store.progress import Progress, Step
from smooth_operator.study.store.tlx_words import ENGLISH, TlxWords, shown_pairs


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
    """Whether nothing more is asked of the operator."""
    return step.what in ("done", "withdrawn", "refused")


def asked_key(progress: Progress, step: Step) -> str:
    """Identifies one questionnaire, one that is asked again after an undo included."""
    undone = sum(isinstance(record.event, Undone) for record in progress.records)
    block = step.block
    where = "" if block is None else f"{block.task.name}/{block.number}"
    asked = step.point or step.form or ""
    return f"{progress.operator}/{where}/{step.what}/{asked}/{undone}"


def place(block: Block, condition: str | None, progress: Progress) -> dict[str, Any]:
    """Where in the study something is."""
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
