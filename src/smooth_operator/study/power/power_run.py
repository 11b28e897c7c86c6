"""Runs thousands of simulated studies in processes, and stores finished ones.

The seed of a study depends on its settings and its number only: any number of workers, and any
interruption, give the same figures.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from smooth_operator.errors import StudyError
from smooth_operator.result_cache import (
    Job,
    Note,
    ResultLog,
    code_digest,
    no_note,
)
from smooth_operator.study.analysis.gee import require_statsmodels
from smooth_operator.study.analysis.results import POOLED
from smooth_operator.study.chunks import chunk_values
from smooth_operator.study.design.plan import make_plan, scaled
from smooth_operator.study.design.plan_file import plan_of, plan_table
from smooth_operator.study.design.protocol import Protocol
from smooth_operator.study.power.simulated_study import Assumptions, Simulator, Spread
from smooth_operator.study.power.verdicts import Tally, verdicts

Truth: TypeAlias = Literal["effects", "null"]
TRUTHS: Final[tuple[Truth, ...]] = ("effects", "null")
"""Simulated truths: the assumed differences, and every condition as good as the baseline."""
LOG: Final = "studies.jsonl"
"""Name of the file with the counts of finished chunks, one line each."""
_CHUNK: Final = 10
_LEAST_OPERATORS: Final = 3
Report: TypeAlias = Callable[[int, int], None]
"""Function of the number of finished studies and the number of all studies."""


@dataclass(frozen=True)
class PowerSettings:
    """Settings of a simulation of power.

    Attributes:
        protocol: protocol of the study, which is scaled to each number of operators.
        truth: assumptions of the simulation.
        operators: numbers of operators, each its own study design.
        studies: number of simulated studies for each number of operators and each truth.
        per_task: whether to analyse each task by itself as well.
        seed: seed of all simulated studies.
    """

    protocol: Protocol
    truth: Assumptions
    operators: tuple[int, ...]
    studies: int = 1000
    per_task: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if self.studies < 1:
            raise StudyError(f"power needs one simulated study or more, not {self.studies}")
        if not self.operators or min(self.operators) < _LEAST_OPERATORS:
            raise StudyError(
                f"power needs numbers of operators from {_LEAST_OPERATORS} on, not "
                f"{list(self.operators)}"
            )
        if len(set(self.operators)) < len(self.operators):
            raise StudyError(f"a number of operators comes twice: {list(self.operators)}")

    @property
    def scopes(self) -> tuple[str, ...]:
        """Scopes of the analysis."""
        tasks = tuple(task.name for task in self.protocol.tasks)
        return (POOLED, *tasks) if self.per_task and len(tasks) > 1 else (POOLED,)

    def to_json(self) -> dict[str, Any]:
        """Returns the settings as plain values."""
        return {
            "plan": plan_table(make_plan(self.protocol)),
            "truth": asdict(self.truth),
            "operators": list(self.operators),
            "studies": self.studies,
            "per_task": self.per_task,
            "seed": self.seed,
        }


@dataclass(frozen=True)
class Chunk:
    """Studies that one worker simulates.

    Attributes:
        setting: JSON of the common settings.
        operators: number of operators.
        truth: ``effects`` or ``null``.
        first: number of the first study.
        count: number of studies.
    """

    setting: str
    operators: int
    truth: Truth
    first: int
    count: int


def run_power(
    settings: PowerSettings,
    folder: Path,
    *,
    workers: int | None = None,
    report: Report | None = None,
    note: Note = no_note,
) -> dict[tuple[int, Truth], Tally]:
    """Simulates and analyses studies; continues an earlier run in the same folder.

    Args:
        settings: settings of the simulation.
        folder: existing folder for the finished chunks.
        workers: number of processes; None for one for each core, 0 for this process.
        report: called after every chunk.
        note: called with a text on each entry of the folder that can't be used.

    Returns:
        Counts for each number of operators and truth.

    Raises:
        StudyError: a study can't be simulated; says why.
        OutputError: the folder can't be written to.
        MissingExtraError: statsmodels is not installed.
    """
    code = code_digest("study/design", "study/power", "study/analysis")
    jobs = [Job("", chunk, code, chunk) for chunk in _chunks(settings)]
    log = ResultLog(folder / LOG, note)
    tallies: dict[tuple[int, Truth], Tally] = {
        (n, truth): Tally() for n in settings.operators for truth in TRUTHS
    }
    for chunk, counts in chunk_values(
        jobs,
        log,
        simulate_chunk,
        field="counts",
        count=lambda chunk: chunk.count,
        failure=lambda chunk: f"simulating {chunk.operators} operators",
        workers=workers,
        report=report,
        prepare=require_statsmodels,  # one error here, not one from each worker
    ):
        tallies[chunk.operators, chunk.truth].merge(chunk.count, counts)
    return tallies


def simulate_chunk(chunk: Chunk) -> dict[str, dict[str, int]]:
    """Simulates and analyses the studies of a chunk in a worker; returns the counts."""
    simulator, truth, protocol, scopes, seed = _prepared(
        chunk.setting, chunk.operators, chunk.truth
    )
    tally = Tally()
    for number in range(chunk.first, chunk.first + chunk.count):
        rng = np.random.default_rng([seed, chunk.operators, TRUTHS.index(chunk.truth), number])
        results = verdicts(simulator.draw(rng), protocol.baseline, scopes)
        tally.add(results, truth, protocol.baseline, protocol.margins)
    return {key: dict(counts) for key, counts in tally.counts.items()}


@lru_cache(maxsize=8)
def _prepared(
    setting: str, operators: int, which: Truth
) -> tuple[Simulator, Assumptions, Protocol, list[str], int]:
    values = json.loads(setting)
    protocol = plan_of(values["plan"], "the plan").protocol
    truth = _assumptions(values["truth"])
    if which == "null":
        truth = truth.null(protocol.baseline)
    simulator = Simulator(make_plan(scaled(protocol, operators)), truth)
    return simulator, truth, protocol, values["scopes"], values["seed"]


def _assumptions(values: Mapping[str, Any]) -> Assumptions:
    spreads = {
        name: Spread(**values[name]) for name in ("operators", "interaction", "trials", "practice")
    }
    tasks = {name: Spread(**spread) for name, spread in values["tasks"].items()}
    return Assumptions(**{**values, **spreads, "tasks": tasks})


def _chunks(settings: PowerSettings) -> Iterator[Chunk]:
    values = settings.to_json()
    shared = {name: values[name] for name in ("plan", "truth", "seed")}
    shared["scopes"] = list(settings.scopes)
    # Only the operators' shares of the tasks matter, so that an enrolment keeps finished chunks.
    shared["plan"] = {k: v for k, v in shared["plan"].items() if k not in ("orders", "enrolled")}
    setting = json.dumps(shared, sort_keys=False)
    for first in range(0, settings.studies, _CHUNK):
        count = min(_CHUNK, settings.studies - first)
        for operators in settings.operators:
            for truth in TRUTHS:
                yield Chunk(setting, operators, truth, first, count)
