"""Exports stored data to files for analysis: two tables, and one JSON file with everything.

``trials.csv`` and ``tlx.csv`` hold the rows that count. ``study.json`` holds the same rows with
more columns, and the whole log: void trials, undone events, notes, breaks. ``study analyze`` reads
either.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import OutputError
from smooth_operator.formats.csv_table import csv_text
from smooth_operator_study.design.plan import Block
from smooth_operator_study.design.plan_file import plan_table
from smooth_operator_study.store.events import (
    BlockEnded,
    Event,
    Noted,
    QuestionnaireAnswered,
    Recalibrated,
    Withdrawn,
    payload,
)
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES, raw_workload
from smooth_operator_study.store.progress import Progress, Trial
from smooth_operator_study.store.study_store import StudyStore

FORMAT: Final = 1
"""Version of ``study.json``."""
TRIAL_COLUMNS: Final = (
    "operator",
    "task",
    "retargeter",
    "block",
    "trial_in_block",
    "trial_global",
    "score",
    "time_s",
)
MORE_TRIAL_COLUMNS: Final = ("duration_s", "line", "resets", "started_at", "place", "amended")
"""Further columns of exported trials, which the analysis does not read."""
QUESTIONNAIRE_COLUMNS: Final = ("operator", "task", "retargeter", "block", "point", *SCALE_NAMES)
_TRIALS, _TLX, _ALL = "trials.csv", "tlx.csv", "study.json"
_SCORING: Final = ("line", "score", "time_s")


def export_study(
    store: StudyStore, folder: str | Path, *, operators: Sequence[str] | None = None
) -> list[Path]:
    """Writes the files into a folder; replaces those of an earlier export.

    Args:
        folder: folder of the files, created if missing.
        operators: operators to export; None for all.

    Returns:
        The files: trials.csv, tlx.csv if there are questionnaires, study.json.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error) from error
    content = study_json(store, operators)
    trials, questionnaires = content["trials"], content["questionnaires"]
    files = {_TRIALS: _table((*TRIAL_COLUMNS, *MORE_TRIAL_COLUMNS), trials)}
    if questionnaires:
        files[_TLX] = _table(QUESTIONNAIRE_COLUMNS, questionnaires)
    else:
        _remove(folder / _TLX)
    files[_ALL] = json.dumps(content, indent=1, allow_nan=False) + "\n"
    for name, text in files.items():
        with atomic_write(folder / name) as file:
            file.write(text.encode("utf-8"))
    return [folder / name for name in files]


def study_json(store: StudyStore, operators: Sequence[str] | None = None) -> dict[str, Any]:
    """Returns everything that is stored, as plain values.

    Args:
        operators: operators to export; None for all.
    """
    plan = store.plan
    everyone = [store.progress(code) for code in (plan.codes if operators is None else operators)]
    return {
        "format": FORMAT,
        "study": plan_table(plan),
        "erased": list(store.erased),
        "trials": [_trial(one, trial) for one in everyone for trial in one.trials if trial.counts],
        "questionnaires": [
            _questionnaire(one, at, event)
            for one in everyone
            for at, event in one.events(QuestionnaireAnswered)
        ],
        "operators": [operator_json(one) for one in everyone],
    }


def _trial(progress: Progress, trial: Trial) -> dict[str, Any]:
    assert trial.score is not None
    assert trial.time_s is not None
    return {
        "operator": progress.operator,
        **_trial_place(trial),
        "trial_global": trial.block.trial_global(trial.number),
        "score": trial.score,
        # The time of a failure is not the time that the task takes.
        "time_s": trial.time_s if trial.score > 0 and trial.time_s > 0 else None,
        "duration_s": trial.time_s,
        "line": trial.line,
        "resets": trial.resets,
        "started_at": trial.started.isoformat(),
        "place": progress.blocks.index(trial.block) + 1,
        "amended": int(trial.amended),
    }


def _questionnaire(
    progress: Progress, at: datetime, event: QuestionnaireAnswered
) -> dict[str, Any]:
    block = next(one for one in progress.blocks if one.place == (event.task, event.block))
    return {
        "operator": progress.operator,
        **_place(block),
        "point": event.point,
        **{name: event.ratings[name] for name in SCALE_NAMES},
        "raw_workload": raw_workload(event.ratings),
        "answered_at": at.isoformat(),
    }


def _table(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    return csv_text(columns, ({name: _short(row[name]) for name in columns} for row in rows))


def _short(value: Any) -> Any:
    whole = isinstance(value, float) and value.is_integer()
    return int(value) if whole else value  # a score is 1, not 1.0


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"can't remove the {path.name} of an earlier export: {error}") from error


def operator_json(progress: Progress) -> dict[str, Any]:
    """Returns an operator's forms, notes, irregular events and whole log as plain values."""
    blocks = {block.place: block for block in progress.blocks}

    def events(kind: type[Event]) -> list[dict[str, Any]]:
        """Fields of the events of a kind that count, with their times."""
        return [{"at": at.isoformat(), **payload(one)} for at, one in progress.events(kind)]

    return {
        "operator": progress.operator,
        "done": progress.step.what == "done",
        "withdrawn": next(iter(events(Withdrawn)), None),
        "forms": {
            name: {"at": at.isoformat(), "answers": answers}
            for name, (at, answers) in progress.forms.items()
        },
        "ranking": list(progress.ranking()),
        "notes": events(Noted),
        "breaks": [
            {"started_at": start.isoformat(), "ended_at": end and end.isoformat()}
            for start, end in progress.breaks
        ],
        "recalibrations": events(Recalibrated),
        "voided": [
            {**_trial_place(trial), "reason": trial.void}
            for trial in progress.trials
            if trial.void is not None
        ],
        "pauses": [
            {
                **_trial_place(trial),
                "at": at.isoformat(),
                "length_s": length,
                "reason": reason,
            }
            for trial in progress.trials
            for at, length, reason in trial.pauses
        ],
        "ended_early": [
            {**_place(blocks[one["task"], one["block"]]), "at": one["at"], "reason": one["reason"]}
            for one in events(BlockEnded)
        ],
        "amendments": [
            {
                **_trial_place(trial),
                "at": record.at.isoformat(),
                "before": dict(zip(_SCORING, before, strict=True)),
                "after": {name: getattr(record.event, name) for name in _SCORING},
                "reason": getattr(record.event, "reason", ""),
                "who": getattr(record.event, "who", ""),
            }
            for record, trial, before in progress.amendments
        ],
        "undone": dict(progress.undone()),
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


def _place(block: Block) -> dict[str, Any]:
    return {"task": block.task.name, "retargeter": block.condition.name, "block": block.number}


def _trial_place(trial: Trial) -> dict[str, Any]:
    return {**_place(trial.block), "trial_in_block": trial.number}
