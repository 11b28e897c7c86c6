"""Runs the trials of a plan in workers, keeps each, and writes what ``study analyze`` reads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeAlias

from smooth_operator.atomic_files import atomic_write, write_json
from smooth_operator.errors import HandModelError, StudyError, UnknownNameError
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark.cells import benchmark_code
from smooth_operator.methods.presets import method_config
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.result_cache import (
    Job,
    Note,
    ResultLog,
    no_note,
)
from smooth_operator.simulation.scenes.task_scenes import scene_for
from smooth_operator.simulation.tasks.task import task_named
from smooth_operator.study.chunks import chunk_values
from smooth_operator.study.data.reading import QUESTIONNAIRE_COLUMNS, TRIAL_COLUMNS
from smooth_operator.study.design.plan import Plan, lot, make_plan, scaled
from smooth_operator.study.design.plan_file import plan_table
from smooth_operator_research.code import research_digest
from smooth_operator_research.demonstrations.demonstration import DEFAULT_HAND
from smooth_operator_research.virtual_operator import draw_person, make_familiar, simulate_trial
from smooth_operator_research.virtual_operator.hand_model import Body
from smooth_operator_research.virtual_operator.trial import Familiar

MOST_OPERATORS: Final = 1000
PREFIX: Final = "simulated-"
"""Begins the codes of virtual operators, so that no row of theirs is taken for a person's."""

_RATE_HZ: Final = 100.0  # where the plan has none
_CHUNK: Final = 5
"""Trials of a block that a worker does in one go: what a stop can lose."""


@dataclass(frozen=True)
class SimulationSettings:
    """How a plan is simulated.

    Attributes:
        plan: who does what.
        hand: robot hand, which must be able to do the tasks.
        body: whose kinematics the persons' hands have.
        seed: of persons and trials.
    """

    plan: Plan
    hand: str = DEFAULT_HAND
    body: Body = "matched"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise StudyError(f"the seed must be 0 or more, not {self.seed}")
        for task in self.plan.protocol.tasks:
            try:
                simulated = task_named(task.name)
            except UnknownNameError as error:
                raise StudyError(
                    f"task {task.name!r} of the plan can't be simulated: {error}"
                ) from error
            try:
                scene_for(simulated.name, load_hand(self.hand, "right"))
            except HandModelError as error:
                raise StudyError(
                    f"task {task.name!r} of the plan can't be simulated: {error}"
                ) from error
        for condition in self.plan.protocol.conditions:
            try:
                config = method_config(condition.method, condition.preset)
            except UnknownNameError as error:
                raise StudyError(f"condition {condition.name!r} of the plan: {error}") from error
            if config.trajectory is not None:
                raise StudyError(
                    f"condition {condition.name!r} of the plan needs a whole recording, and can't "
                    "be driven live; choose a causal preset"
                )


@dataclass(frozen=True)
class Chunk:
    """Some trials of a block, in turn.

    Attributes:
        operator: code in the plan.
        person: number of the person.
        task: name in the plan.
        condition: name in the plan.
        block: number of the block in the task.
        method: of the condition.
        preset: of the condition.
        trials: numbers in the block.
        done: trials of the task before this block.
        rate_hz: commands a second.
        resets: allowed in a trial.
        reset_cap: the best score after one.
        limit_s: of a trial, from the plan; None for the task's own.
        hand: robot hand.
        body: whose kinematics the person's hand has.
        seed: of the simulation.
    """

    operator: str
    person: int
    task: str
    condition: str
    block: int
    method: str
    preset: str | None
    trials: tuple[int, ...]
    done: int
    rate_hz: float
    resets: int
    reset_cap: float
    limit_s: float | None
    hand: str
    body: Body
    seed: int
    key: dict[str, Any] = field(init=False, repr=False, compare=False, default_factory=dict)

    def __post_init__(self) -> None:
        content = {k: v for k, v in asdict(self).items() if k not in ("key", "condition")}
        object.__setattr__(self, "key", content)


def plan_for(plan: Plan, operators: int | None) -> Plan:
    """The plan for so many operators; the plan itself where these are its own.

    Raises:
        StudyError: the number is not from 1 to 1000, or the plan has no operators.
    """
    if operators is None:
        if not plan.enrolled:
            raise StudyError("the plan has no operators; give their number with --operators")
        return plan
    if not 1 <= operators <= MOST_OPERATORS:
        raise StudyError(f"operators must be from 1 to {MOST_OPERATORS}, not {operators}")
    return plan if operators == len(plan.enrolled) else make_plan(scaled(plan.protocol, operators))


def chunks(settings: SimulationSettings) -> Iterator[Chunk]:
    """All trials of a plan."""
    plan, protocol = settings.plan, settings.plan.protocol
    for block in plan.schedule():
        for first in range(1, block.task.trials + 1, _CHUNK):
            yield Chunk(
                operator=block.operator,
                person=plan.codes.index(block.operator),
                task=block.task.name,
                condition=block.condition.name,
                block=block.number,
                method=block.condition.method,
                preset=block.condition.preset,
                trials=tuple(range(first, min(first + _CHUNK, block.task.trials + 1))),
                done=block.trial_global(1) - 1,
                rate_hz=_RATE_HZ if protocol.rate_hz is None else protocol.rate_hz,
                resets=min(protocol.resets, 1),
                reset_cap=protocol.reset_cap,
                limit_s=block.task.time_limit_s,
                hand=settings.hand,
                body=settings.body,
                seed=settings.seed,
            )


def simulate_chunk(chunk: Chunk) -> list[dict[str, Any]]:
    """Rows of some trials; what a worker does."""
    familiar = _familiar(
        chunk.person, chunk.seed, chunk.hand, chunk.method, chunk.preset, chunk.body
    )
    rows = []
    for number in chunk.trials:
        place = (chunk.operator, chunk.task, chunk.block, number)
        trial = simulate_trial(
            familiar,
            task_named(chunk.task),
            rate_hz=chunk.rate_hz,
            practised=chunk.done + number - 1,
            practised_here=number - 1,
            resets=chunk.resets,
            seconds=chunk.limit_s,
            seed=int(lot(chunk.seed, "simulated trial", *place) * 2**32),
        )
        outcome = trial.outcome
        score = min(outcome.score, chunk.reset_cap) if outcome.resets else outcome.score
        rows.append(
            {
                "trial_in_block": number,
                "score": score,
                "duration_s": round(outcome.seconds, 3),
                "line": outcome.line,
                "ended": outcome.ended,
                "reason": outcome.reason,
                "resets": outcome.resets,
                "attempts": trial.attempts,
                "diverged": trial.diverged,
            }
        )
    return rows


@lru_cache(maxsize=4)
def _retargeter(hand: str, method: str, preset: str | None) -> Retargeter:
    return Retargeter(load_hand(hand, "right"), method=method, preset=preset)


@lru_cache(maxsize=8)
def _familiar(
    person: int, seed: int, hand: str, method: str, preset: str | None, body: Body
) -> Familiar:
    return make_familiar(draw_person(person, seed), _retargeter(hand, method, preset), body, seed)


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
    known_settings = dict(
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
    rows = [row for job in jobs for row in _rows(job.task, known_settings[job.task])]
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
    request = [
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
    if request:
        tables["tlx.csv"] = (QUESTIONNAIRE_COLUMNS, request)
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
