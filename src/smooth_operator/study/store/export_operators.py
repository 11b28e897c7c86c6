"""An operator's entry in ``study.json``: what happened besides the rows of the tables."""

from __future__ import annotations

from typing import Any

from smooth_operator.study.store.events import payload
from smooth_operator.study.store.progress import Progress, Trial


def operator_json(progress: Progress) -> dict[str, Any]:
    """The entry as plain values."""
    left = progress.withdrawn
    return {
        "operator": progress.operator,
        "done": progress.step.what == "done",
        "withdrawn": left and {"at": left.at.isoformat(), "keep": left.keep, "reason": left.reason},
        "replaces": progress.replaces or None,
        "forms": {
            name: {
                "at": at.isoformat(),
                "answers": answers,
                "typed_by": progress.typed.get(name),
            }
            for name, (at, answers) in progress.forms.items()
        },
        "forms_on_paper": {
            name: {"at": at.isoformat(), "who": who}
            for name, (at, who) in progress.on_paper.items()
        },
        "ranking": list(progress.ranking()),
        "notes": [{"at": at.isoformat(), "text": text} for at, text in progress.notes],
        "breaks": [
            {"started_at": start.isoformat(), "ended_at": end and end.isoformat()}
            for start, end in progress.breaks
        ],
        "recalibrations": [
            {"at": at.isoformat(), "task": task, "detail": detail}
            for at, task, detail in progress.recalibrations
        ],
        **_irregular(progress),
        "events": [
            {
                "number": record.number,
                "at": record.at.isoformat(),
                "author": record.author,
                "kind": record.event.kind,
                "fields": payload(record.event),
            }
            for record in progress.records
        ],
    }


def _irregular(progress: Progress) -> dict[str, Any]:
    conditions = {(b.task.name, b.number): b.condition.name for b in progress.blocks}
    return {
        "voided": [
            {**_place(trial), "reason": trial.void}
            for trial in progress.trials
            if trial.void is not None
        ],
        "pauses": [
            {**_place(trial), "at": at.isoformat(), "length_s": length, "reason": reason}
            for trial in progress.trials
            for at, length, reason in trial.pauses
        ],
        "ended_early": [
            {
                "task": task,
                "retargeter": conditions[task, block],
                "block": block,
                "at": at.isoformat(),
                "reason": reason,
            }
            for (task, block), (at, reason) in progress.ended_early.items()
        ],
        "amendments": [
            {
                "at": one.at.isoformat(),
                "task": one.block.task.name,
                "retargeter": one.block.condition.name,
                "block": one.block.number,
                "trial_in_block": one.trial,
                "before": _scoring(one.before),
                "after": _scoring(one.after),
                "reason": one.reason,
                "who": one.who,
            }
            for one in progress.amendments
        ],
        "undone": dict(progress.undone()),
    }


def _place(trial: Trial) -> dict[str, Any]:
    return {
        "task": trial.block.task.name,
        "retargeter": trial.block.condition.name,
        "block": trial.block.number,
        "trial_in_block": trial.number,
    }


def _scoring(scoring: tuple[str, float, float]) -> dict[str, Any]:
    line, score, seconds = scoring
    return {"line": line, "score": score, "time_s": seconds}
