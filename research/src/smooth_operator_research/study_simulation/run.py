"""Runs the trials of a plan in workers, keeps each, and writes what ``study analyze`` reads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, TypeAlias

from smooth_operator.atomic_files import atomic_write, write_json
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.lab.benchmark.cells import benchmark_code
from smooth_operator.result_cache import (
    Job,
    Note,
    ResultLog,
    no_note,
)
from smooth_operator.study.chunks import chunk_values
from smooth_operator.study.data.checked_tables import QUESTIONNAIRE_COLUMNS, TRIAL_COLUMNS
from smooth_operator.study.design.plan_file import plan_table
from smooth_operator_research.code import research_digest
from smooth_operator_research.study_simulation.jobs import (
    PREFIX,
    Chunk,
    SimulationSettings,
    chunks,
    simulate_chunk,
)
from smooth_operator_research.virtual_operator import draw_person

LOG: Final = "simulated-trials.jsonl"
"""Finished trials, some of a block on each line; by it a stopped run goes on."""

NOTICE: Final = (
    "Simulated operators, a model of how people look and correct: no person took part, and no "
    "person is replaced. Workload (NASA-TLX) is not simulated and left empty."
)
"""Stands in the output and in the files."""

_DETAILS: Final = (
    *TRIAL_COLUMNS, "duration_s", "line", "ended", "reason", "resets", "attempts", "diverged",
)  # fmt: skip

Report: TypeAlias = Callable[[int, int], None]
"""Called with the trials that are done, and all."""


def simulate_study(
    settings: SimulationSettings,
    folder: Path,
    *,
    workers: int | None = None,
    report: Report | None = None,
    note: Note = no_note,
) -> list[dict[str, Any]]:
    """Simulates every trial; goes on where an earlier run in the same folder stopped.

    Args:
        settings: what to simulate.
        folder: keeps what is done, and gets the tables; must exist.
        workers: processes; None for as many as there are cores, 0 for none.
        report: called after each chunk of trials.
        note: called with what is in the folder and can't be used.

    Returns:
        Rows of the trials, in the order of the plan.

    Raises:
        StudyError: a trial could not be simulated; says why.
        OutputError: the folder can't be written to.
    """
    code = _code()
    jobs = [Job("", chunk.key, code, chunk) for chunk in chunks(settings)]
    log = ResultLog(folder / LOG, note)
    known = dict(
        chunk_values(
            jobs,
            log,
            simulate_chunk,
            field="trials",
            count=lambda chunk: len(chunk.trials),
            failure=lambda chunk: (
                f"simulating operator {chunk.operator}, task {chunk.task}, condition "
                f"{chunk.condition}"
            ),
            workers=workers,
            report=report,
        )
    )
    rows = [row for job in jobs for row in _rows(job.task, known[job.task])]
    _write(settings, folder, rows)
    return rows


def _code() -> str:
    """Digest of what a trial depends on."""
    return benchmark_code() + research_digest(
        "study_simulation", "virtual_operator", "demonstrations", "simulation", "synthetic"
    )


def _rows(chunk: Chunk, trials: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        {
            "operator": PREFIX + chunk.operator,
            "task": chunk.task,
            "retargeter": chunk.condition,
            "block": chunk.block,
            "trial_global": chunk.done + trial["trial_in_block"],
            # The time of a failure is not the time that the task takes.
            "time_s": trial["duration_s"] if trial["score"] > 0 else None,
            **trial,
        }
        for trial in trials
    ]


def _write(settings: SimulationSettings, folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    asked = [
        {
            "operator": PREFIX + block.operator,
            "task": block.task.name,
            "retargeter": block.condition.name,
            "block": block.number,
            "point": point,
        }
        for block in settings.plan.schedule()
        for point in block.questionnaires.values()
    ]
    tables = {"trials.csv": (TRIAL_COLUMNS, rows), "details.csv": (_DETAILS, rows)}
    if asked:
        tables["tlx.csv"] = (QUESTIONNAIRE_COLUMNS, asked)
    for name, (columns, table) in tables.items():
        with atomic_write(folder / name) as file:
            file.write(csv_text(columns, table).encode("utf-8"))
    persons = [
        _plain(asdict(draw_person(k, settings.seed))) for k in range(len(settings.plan.codes))
    ]
    about = {
        "simulated": True,
        "notice": NOTICE,
        "hand": settings.hand,
        "body": settings.body,
        "seed": settings.seed,
        "code": _code(),
        "plan": plan_table(settings.plan),
        "persons": dict(zip(settings.plan.codes, persons, strict=True)),
    }
    write_json(folder / "simulation.json", about, indent=1)


def _plain(person: dict[str, Any]) -> dict[str, Any]:
    """A person's figures without the anatomy's tables."""
    length = person.pop("anatomy")["hand_length"]
    return {"hand_length": length} | {
        name: value.tolist() if hasattr(value, "tolist") else value
        for name, value in person.items()
    }
