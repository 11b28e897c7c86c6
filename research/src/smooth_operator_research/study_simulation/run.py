"""Runs the trials of a plan in workers, stores each, and writes the input of ``study analyze``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeAlias

from smooth_operator.atomic_files import atomic_write, write_json
from smooth_operator.errors import HandModelError, StudyError, UnknownNameError
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.hands.registry import load_hand
from smooth_operator.result_cache import Job, Note, no_note
from smooth_operator.retargeting.known_gaps import known_gaps
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig
from smooth_operator.simulation.scenes.task_scenes import scene_for
from smooth_operator.simulation.tasks.catalogue import task_named
from smooth_operator.synthetic.tracker import tracker_model
from smooth_operator_benchmark.cells import benchmark_code
from smooth_operator_research.code import research_digest
from smooth_operator_research.demonstrations.demonstration import DEFAULT_HAND
from smooth_operator_research.virtual_operator import draw_person, make_familiar, simulate_trial
from smooth_operator_research.virtual_operator.hand_model import Body
from smooth_operator_research.virtual_operator.trial import Familiar
from smooth_operator_study.chunks import chunk_values
from smooth_operator_study.design.plan import Block, Plan, lot, make_plan, scaled
from smooth_operator_study.design.plan_file import plan_table
from smooth_operator_study.result_log import ResultLog
from smooth_operator_study.store.export import QUESTIONNAIRE_COLUMNS, TRIAL_COLUMNS

MOST_OPERATORS: Final = 1000
PREFIX: Final = "simulated-"
"""Prefix of the codes of virtual operators, which distinguishes their rows from those of people."""

_CHUNK: Final = 5
"""Number of trials that a worker does at once; a stop can lose them."""


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of a simulation.

    Attributes:
        plan: plan of the study.
        hand: robot hand, which must be able to do the tasks.
        body: kinematics of the persons' hands.
        tracker: kind of tracker that sees them: ``glove``, ``headset`` or ``camera``; at the
            plan's rate, if it has one. The retargeters know the pinch gaps of that kind.
        seed: seed of persons and trials.
    """

    plan: Plan
    hand: str = DEFAULT_HAND
    body: Body = "matched"
    tracker: str = "glove"
    seed: int = 0

    def __post_init__(self) -> None:
        tracker_model(self.tracker)  # which checks the name
        if self.seed < 0:
            raise StudyError(f"the seed must be 0 or more, not {self.seed}")
        for task in self.plan.protocol.tasks:
            try:
                scene_for(task_named(task.name).name, load_hand(self.hand, "right"))
            except (HandModelError, UnknownNameError) as error:
                raise StudyError(
                    f"task {task.name!r} of the plan can't be simulated: {error}"
                ) from error
        for condition in self.plan.protocol.conditions:
            try:
                config = method_config(condition.method, condition.preset)
            except UnknownNameError as error:
                raise StudyError(f"condition {condition.name!r} of the plan: {error}") from error
            if isinstance(config, TrajectoryMethodConfig):
                raise StudyError(
                    f"condition {condition.name!r} of the plan needs a whole recording, and can't "
                    "be driven live; choose a causal preset"
                )


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some consecutive trials of a block.

    Attributes:
        settings: settings of the simulation.
        block: the block of an operator.
        trials: numbers of the trials in the block.
    """

    settings: SimulationSettings
    block: Block
    trials: tuple[int, ...]

    @property
    def key(self) -> dict[str, Any]:
        """Key of the trials: everything that they depend on, as JSON values."""
        block, protocol = self.block, self.settings.plan.protocol
        return {
            "operator": block.operator,
            "person": self.settings.plan.codes.index(block.operator),
            "task": block.task.name,
            "block": block.number,
            "method": block.condition.method,
            "preset": block.condition.preset,
            "trials": self.trials,
            "done": block.trial_global(1) - 1,  # trials of the task before this block
            "tracker": self.settings.tracker,
            "rate_hz": protocol.rate_hz,
            "resets": min(protocol.resets, 1),
            "reset_cap": protocol.reset_cap,
            "limit_s": block.task.time_limit_s,
            "hand": self.settings.hand,
            "body": self.settings.body,
            "seed": self.settings.seed,
        }


def plan_for(plan: Plan, operators: int | None) -> Plan:
    """Returns the plan for a number of operators; the plan itself if it has that number."""
    if operators is None:
        if not plan.enrolled:
            raise StudyError("the plan has no operators; give their number with --operators")
        return plan
    if not 1 <= operators <= MOST_OPERATORS:
        raise StudyError(f"operators must be from 1 to {MOST_OPERATORS}, not {operators}")
    return plan if operators == len(plan.enrolled) else make_plan(scaled(plan.protocol, operators))


def chunks(settings: SimulationSettings) -> Iterator[Chunk]:
    """All trials of a plan."""
    for block in settings.plan.schedule():
        for first in range(1, block.task.trials + 1, _CHUNK):
            last = min(first + _CHUNK, block.task.trials + 1)
            yield Chunk(settings, block, tuple(range(first, last)))


def simulate_chunk(chunk: Chunk) -> list[dict[str, Any]]:
    """Simulates some trials in a worker; returns their rows."""
    key = chunk.key
    familiar = _familiar(
        key["person"],
        key["seed"],
        key["hand"],
        key["method"],
        key["preset"],
        key["body"],
        key["tracker"],
    )
    tracker = tracker_model(key["tracker"])
    if key["rate_hz"] is not None:
        tracker = replace(tracker, rate_hz=key["rate_hz"])
    rows = []
    for number in chunk.trials:
        place = (key["operator"], key["task"], key["block"], number)
        trial = simulate_trial(
            familiar,
            task_named(key["task"]),
            tracker=tracker,
            practised=key["done"] + number - 1,
            practised_here=number - 1,
            resets=key["resets"],
            seconds=key["limit_s"],
            seed=int(lot(key["seed"], "simulated trial", *place) * 2**32),
        )
        outcome = trial.outcome
        score = min(outcome.score, key["reset_cap"]) if outcome.resets else outcome.score
        rows.append(
            {
                "trial_in_block": number,
                "score": score,
                "duration_s": round(outcome.seconds, 3),
                **{name: getattr(outcome, name) for name in ("line", "ended", "reason", "resets")},
                "attempts": trial.attempts,
                "diverged": trial.diverged,
            }
        )
    return rows


@lru_cache(maxsize=4)
def _retargeter(hand: str, method: str, preset: str | None, tracker: str) -> Retargeter:
    return Retargeter(
        load_hand(hand, "right"), method=method, preset=preset, pinch_gaps=known_gaps(tracker)
    )


@lru_cache(maxsize=8)
def _familiar(
    person: int, seed: int, hand: str, method: str, preset: str | None, body: Body, tracker: str
) -> Familiar:
    retargeter = _retargeter(hand, method, preset, tracker)
    model = tracker_model(tracker)
    return make_familiar(draw_person(person, seed), retargeter, model, body, seed)


LOG: Final = "simulated-trials.jsonl"
"""File of finished trials, some of a block per line, from which a stopped run continues."""

NOTICE: Final = (
    "Simulated operators, a model of how people look and correct: no person took part, and no "
    "person is replaced. Workload (NASA-TLX) is not simulated and left empty."
)
"""Warning in the output and in the files."""

_DETAILS: Final = (
    *TRIAL_COLUMNS,
    "duration_s",
    "line",
    "ended",
    "reason",
    "resets",
    "attempts",
    "diverged",
)

Report: TypeAlias = Callable[[int, int], None]
"""Function of the numbers of finished trials and of all trials."""


def simulate_study(
    settings: SimulationSettings,
    folder: Path,
    *,
    workers: int | None = None,
    report: Report | None = None,
    note: Note = no_note,
) -> list[dict[str, Any]]:
    """Simulates every trial; continues an earlier run in the same folder.

    Args:
        folder: existing folder for finished trials and the tables.
        workers: number of processes; None for one per core, 0 for none.
        report: called after each chunk of trials.
        note: called with a message about files in the folder that can't be used.

    Returns:
        Rows of the trials, in the order of the plan.
    """
    code = _code()
    jobs = [
        Job(
            "",
            one.key,
            code,
            one,
            f"simulating operator {one.block.operator}, task {one.block.task.name}, "
            f"condition {one.block.condition.name}",
            len(one.trials),
        )
        for one in chunks(settings)
    ]
    log = ResultLog(folder / LOG, note)
    results = dict(
        chunk_values(
            jobs,
            log,
            simulate_chunk,
            field="trials",
            workers=workers,
            report=report,
        )
    )
    rows = [row for job in jobs for row in _rows(job.task, results[job.task])]
    _write(settings, folder, rows)
    return rows


def _code() -> str:
    """Digest of the code that a trial depends on."""
    return benchmark_code() + research_digest(
        "study_simulation", "virtual_operator", "demonstrations", "simulation", "synthetic"
    )


def _place(block: Block) -> dict[str, Any]:
    return {
        "operator": PREFIX + block.operator,
        "task": block.task.name,
        "retargeter": block.condition.name,
        "block": block.number,
    }


def _rows(chunk: Chunk, trials: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    block = chunk.block
    return [
        {
            **_place(block),
            "trial_global": block.trial_global(trial["trial_in_block"]),
            # The time of a failure is not the time that the task takes.
            "time_s": trial["duration_s"] if trial["score"] > 0 else None,
            **trial,
        }
        for trial in trials
    ]


def _write(settings: SimulationSettings, folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    request = [
        {**_place(block), "point": point}
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
    """Parameters of a person without the tables of anatomy."""
    length = person.pop("anatomy")["hand_length"]
    return {"hand_length": length} | {
        name: value.tolist() if hasattr(value, "tolist") else value
        for name, value in person.items()
    }
