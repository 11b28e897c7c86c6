"""Stored data as files for analysis: tables, and one JSON file with everything.

``trials.csv`` and ``tlx.csv`` hold what counts; ``study.json`` holds the same rows with more
columns, and the whole log: void trials, undone events, notes, breaks. ``study analyze`` reads
either.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import OutputError
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.study.data.checked_tables import (
    MORE_TRIAL_COLUMNS,
    QUESTIONNAIRE_COLUMNS,
    TRIAL_COLUMNS,
    WEIGHT_COLUMNS,
)
from smooth_operator.study.design.plan import Block
from smooth_operator.study.design.plan_file import plan_table
from smooth_operator.study.store.events import payload
from smooth_operator.study.store.nasa_tlx import (
    SCALE_NAMES,
    raw_workload,
    weighted_workload,
    weights,
)
from smooth_operator.study.store.operator_state import Trial
from smooth_operator.study.store.progress import Progress
from smooth_operator.study.store.study_store import StudyStore

FORMAT: Final = 1
"""Version of ``study.json``."""
BLOCK_WEIGHT_COLUMNS: Final = ("operator", "task", "retargeter", "block", *SCALE_NAMES)
_TRIALS, _TLX, _WEIGHTS, _ALL = "trials.csv", "tlx.csv", "tlx_weights.csv", "study.json"
_SCORING: Final = ("line", "score", "time_s")


def export_study(
    store: StudyStore, folder: str | Path, *, operators: Sequence[str] | None = None
) -> list[Path]:
    """Writes the files into a folder; those that stand there are replaced.

    Args:
        store: of the study.
        folder: made if it is not there.
        operators: None for all.

    Returns:
        The files: trials.csv, tlx.csv and tlx_weights.csv where there are such rows, study.json.

    Raises:
        OutputError: a file can't be written.
        UnknownNameError: there is no such operator.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error) from error
    everything = study_json(store, operators)
    weighted = (*WEIGHT_COLUMNS, "weighted_workload")
    files = {
        _TRIALS: ((*TRIAL_COLUMNS, *MORE_TRIAL_COLUMNS), everything["trials"]),
        _TLX: (
            (*QUESTIONNAIRE_COLUMNS, *(weighted if everything["weights"] else ())),
            everything["questionnaires"],
        ),
        _WEIGHTS: (BLOCK_WEIGHT_COLUMNS, everything["weights"]),
    }
    written = []
    for name, (columns, rows) in files.items():
        if rows or name == _TRIALS:
            written.append(_write(folder / name, _table(columns, rows)))
        else:
            _remove(folder / name)  # of an earlier export, when there was more
    text = json.dumps(everything, indent=1, allow_nan=False) + "\n"
    written.append(_write(folder / _ALL, text))
    return written


def study_json(store: StudyStore, operators: Sequence[str] | None = None) -> dict[str, Any]:
    """Everything that is stored, as plain values.

    Args:
        store: of the study.
        operators: None for all.
    """
    plan = store.plan
    codes = plan.codes if operators is None else tuple(operators)
    content: dict[str, Any] = {
        "format": FORMAT,
        "study": plan_table(plan),
        "erased": list(store.erased),
        "trials": [],
        "questionnaires": [],
        "weights": [],
        "operators": [],
    }
    for code in codes:
        progress = store.progress(code)
        places = {(b.task.name, b.number): n for n, b in enumerate(progress.blocks, 1)}
        content["trials"] += [
            _trial(code, trial, places) for trial in progress.trials if trial.counts
        ]
        content["questionnaires"] += list(_questionnaires(progress))
        content["weights"] += list(_weights(progress))
        content["operators"].append(operator_json(progress))
    return content


def _trial(code: str, trial: Trial, places: Mapping[tuple[str, int], int]) -> dict[str, Any]:
    assert trial.score is not None
    assert trial.time_s is not None
    block = trial.block
    return {
        "operator": code,
        **_place(block),
        "trial_in_block": trial.number,
        "trial_global": block.trial_global(trial.number),
        "score": trial.score,
        # The time of a failure is not the time that the task takes.
        "time_s": trial.time_s if trial.score > 0 and trial.time_s > 0 else None,
        "duration_s": trial.time_s,
        "line": trial.line,
        "resets": trial.resets,
        "started_at": trial.started.isoformat(),
        "place": places[block.task.name, block.number],
        "amended": int(trial.amended),
    }


def _questionnaires(progress: Progress) -> Iterator[dict[str, Any]]:
    for questionnaire in progress.questionnaires:
        block = questionnaire.block
        winners = progress.winners.get((block.task.name, block.number))
        chosen = {} if winners is None else weights(winners)
        yield {
            "operator": progress.operator,
            **_place(block),
            "point": questionnaire.point,
            **{name: questionnaire.ratings[name] for name in SCALE_NAMES},
            **{
                column: chosen.get(name)
                for column, name in zip(WEIGHT_COLUMNS, SCALE_NAMES, strict=True)
            },
            "raw_workload": raw_workload(questionnaire.ratings),
            "weighted_workload": winners and weighted_workload(questionnaire.ratings, winners),
            "answered_at": questionnaire.at.isoformat(),
            "typed_by": questionnaire.who or None,
        }


def _weights(progress: Progress) -> Iterator[dict[str, Any]]:
    blocks = {(block.task.name, block.number): block for block in progress.blocks}
    for key, winners in progress.winners.items():
        yield {"operator": progress.operator, **_place(blocks[key]), **weights(winners)}


def _table(columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> str:
    return csv_text(columns, ({name: _short(row[name]) for name in columns} for row in rows))


def _short(value: Any) -> Any:
    whole = isinstance(value, float) and value.is_integer()
    return int(value) if whole else value  # a score is 1, not 1.0


def _write(path: Path, text: str) -> Path:
    with atomic_write(path) as file:
        file.write(text.encode("utf-8"))
    return path


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"can't remove the {path.name} of an earlier export: {error}") from error


def operator_json(progress: Progress) -> dict[str, Any]:
    """An operator's forms, notes, irregular events and whole log as plain values."""
    left = progress.withdrawn
    blocks = {(block.task.name, block.number): block for block in progress.blocks}
    return {
        "operator": progress.operator,
        "done": progress.step.what == "done",
        "withdrawn": left and {"at": left.at.isoformat(), "keep": left.keep, "reason": left.reason},
        "replaces": progress.replaces or None,
        "forms": {
            name: {"at": at.isoformat(), "answers": answers, "typed_by": progress.typed.get(name)}
            for name, (at, answers) in progress.forms.items()
        },
        "forms_on_paper": {
            name: {"at": at.isoformat(), "who": who}
            for name, (at, who) in progress.on_paper.items()
        },
        "ranking": list(progress.ranking()),
        "notes": _rows(("at", "text"), progress.notes),
        "breaks": _rows(("started_at", "ended_at"), progress.breaks),
        "recalibrations": _rows(("at", "task", "detail"), progress.recalibrations),
        "voided": [
            {**_place(trial.block), "trial_in_block": trial.number, "reason": trial.void}
            for trial in progress.trials
            if trial.void is not None
        ],
        "pauses": [
            {**_place(trial.block), "trial_in_block": trial.number, **pause}
            for trial in progress.trials
            for pause in _rows(("at", "length_s", "reason"), trial.pauses)
        ],
        "ended_early": [
            {**_place(blocks[key]), "at": at.isoformat(), "reason": reason}
            for key, (at, reason) in progress.ended_early.items()
        ],
        "amendments": [
            {
                **_place(one.block),
                "trial_in_block": one.trial,
                "at": one.at.isoformat(),
                "before": dict(zip(_SCORING, one.before, strict=True)),
                "after": dict(zip(_SCORING, one.after, strict=True)),
                "reason": one.reason,
                "who": one.who,
            }
            for one in progress.amendments
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


def _rows(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> list[dict[str, Any]]:
    """Rows as plain values by name; moments are ISO text."""
    return [
        {
            name: value.isoformat() if isinstance(value, datetime) else value
            for name, value in zip(names, row, strict=True)
        }
        for row in rows
    ]


def _place(block: Block) -> dict[str, Any]:
    return {"task": block.task.name, "retargeter": block.condition.name, "block": block.number}
