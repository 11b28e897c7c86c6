"""Thousands of simulated studies over many processes; what is done is kept, and not done again.

Each study has a seed of its own, from what it is and not from who computes it: any number of
workers, and any interruption, give the same figures.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np

import smooth_operator
from smooth_operator.errors import StudyError
from smooth_operator.io.atomic import output_error
from smooth_operator.io.documents import parse_json
from smooth_operator.parallel import run_tasks
from smooth_operator.study.analysis.results import POOLED
from smooth_operator.study.design.plan import make_plan, scaled
from smooth_operator.study.design.plan_file import plan_of, plan_table
from smooth_operator.study.design.protocol import Protocol
from smooth_operator.study.power.assumptions import Assumptions, Spread
from smooth_operator.study.power.layout import layout
from smooth_operator.study.power.simulation import Simulator
from smooth_operator.study.power.tally import Tally
from smooth_operator.study.power.verdicts import Analyst

Truth: TypeAlias = Literal["effects", "null"]
TRUTHS: Final[tuple[Truth, ...]] = ("effects", "null")
"""As assumed; and with every condition as good as the baseline."""

LOG: Final = "studies.jsonl"
"""Counts of finished chunks, a line each."""
_CHUNK: Final = 10
_CODE: Final = ("study/design", "study/power", "study/analysis")
_LEAST_OPERATORS: Final = 3

Report: TypeAlias = Callable[[int, int], None]
"""Called with the studies that are done, and all."""


@dataclass(frozen=True)
class PowerSettings:
    """What to simulate.

    Attributes:
        protocol: of the study; its operators are scaled to each of ``operators``.
        truth: what is assumed.
        operators: numbers of operators, each a study design of its own.
        studies: simulated studies of each number and each truth.
        per_task: analyse each task by itself as well.
        seed: of all of it.
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
        """What is analysed."""
        tasks = tuple(task.name for task in self.protocol.tasks)
        return (POOLED, *tasks) if self.per_task and len(tasks) > 1 else (POOLED,)

    def to_json(self) -> dict[str, Any]:
        """All settings, as plain values."""
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
    """Some studies, for a worker.

    Attributes:
        setting: JSON of what they have in common.
        operators: how many.
        truth: which.
        first: number of the first study.
        count: how many studies.
    """

    setting: str
    operators: int
    truth: Truth
    first: int
    count: int

    @property
    def key(self) -> str:
        """What tells whether the chunk was done before: its studies and the code."""
        what = (self.setting, self.operators, self.truth, self.first, self.count, _code_digest())
        return hashlib.sha256(repr(what).encode()).hexdigest()[:24]


def run_power(
    settings: PowerSettings,
    folder: Path,
    *,
    workers: int | None = None,
    report: Report | None = None,
) -> dict[tuple[int, Truth], Tally]:
    """Simulates and analyses; goes on where an earlier run in the same folder stopped.

    Args:
        settings: what to simulate.
        folder: keeps what is done; must exist.
        workers: processes; None for as many as there are cores, 0 for none.
        report: told of every chunk that is done.

    Returns:
        Counts for each number of operators and truth.

    Raises:
        StudyError: a study could not be simulated; says why.
        OutputError: the folder can't be written to.
    """
    chunks = list(_chunks(settings))
    total = sum(chunk.count for chunk in chunks)
    log = folder / LOG
    known = _read_log(log)
    tallies: dict[tuple[int, Truth], Tally] = {
        (n, truth): Tally() for n in settings.operators for truth in TRUTHS
    }
    done = 0
    for chunk in chunks:
        if (line := known.get(chunk.key)) is not None:
            tallies[chunk.operators, chunk.truth].merge(chunk.count, line)
            done += chunk.count
    left = [chunk for chunk in chunks if chunk.key not in known]
    if report is not None:
        report(done, total)
    try:
        with log.open("a", encoding="utf-8") as file:
            for result in run_tasks(simulate_chunk, left, workers=workers):
                chunk = left[result.index]
                if result.value is None:
                    raise StudyError(
                        f"simulating {chunk.operators} operators failed: {result.error}"
                    )
                file.write(json.dumps({"key": chunk.key, "counts": result.value}) + "\n")
                file.flush()
                tallies[chunk.operators, chunk.truth].merge(chunk.count, result.value)
                done += chunk.count
                if report is not None:
                    report(done, total)
    except OSError as error:
        raise output_error(log, error) from error
    return tallies


def simulate_chunk(chunk: Chunk) -> dict[str, dict[str, int]]:
    """Counts over some studies; what a worker does."""
    simulator, analyst, truth, baseline, seed = _prepared(
        chunk.setting, chunk.operators, chunk.truth
    )
    tally = Tally()
    for number in range(chunk.first, chunk.first + chunk.count):
        rng = np.random.default_rng([seed, chunk.operators, TRUTHS.index(chunk.truth), number])
        tally.add(analyst.verdicts(simulator.draw(rng)), truth, baseline)
    return {key: dict(counts) for key, counts in tally.counts.items()}


@lru_cache(maxsize=8)
def _prepared(
    setting: str, operators: int, which: Truth
) -> tuple[Simulator, Analyst, Assumptions, str, int]:
    values = json.loads(setting)
    protocol = plan_of(values["plan"], "the plan").protocol
    rows = layout(make_plan(scaled(protocol, operators)))
    truth = _assumptions(values["truth"])
    if which == "null":
        truth = truth.null(protocol.baseline)
    simulator = Simulator(rows, truth)
    analyst = Analyst(rows, tuple(values["scopes"]))
    return simulator, analyst, truth, protocol.baseline, values["seed"]


def _assumptions(values: Mapping[str, Any]) -> Assumptions:
    return Assumptions(
        success=values["success"],
        time_s=values["time_s"],
        workload=values["workload"],
        operators=Spread(**values["operators"]),
        interaction=Spread(**values["interaction"]),
        trials=Spread(**values["trials"]),
        scales=values["scales"],
        practice=Spread(**values["practice"]),
        tasks={name: Spread(**spread) for name, spread in values["tasks"].items()},
    )


def _chunks(settings: PowerSettings) -> Iterator[Chunk]:
    values = settings.to_json()
    shared = {name: values[name] for name in ("plan", "truth", "seed")}
    shared["scopes"] = list(settings.scopes)
    # How many operators the file plans doesn't matter beyond their shares of the tasks.
    shared["plan"] = {k: v for k, v in shared["plan"].items() if k not in ("orders", "enrolled")}
    setting = json.dumps(shared, sort_keys=False)
    for first in range(0, settings.studies, _CHUNK):
        count = min(_CHUNK, settings.studies - first)
        for operators in settings.operators:
            for truth in TRUTHS:
                yield Chunk(setting, operators, truth, first, count)


def _read_log(path: Path) -> dict[str, dict[str, dict[str, int]]]:
    """Finished chunks; a last line that a kill cut off is none."""
    found: dict[str, dict[str, dict[str, int]]] = {}
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return found
    except (OSError, UnicodeDecodeError) as error:
        raise StudyError(f"can't read {path}, the studies done so far: {error}") from error
    for line in text.splitlines():
        try:
            entry = parse_json(line)
            found[entry["key"]] = entry["counts"]
        except (ValueError, KeyError, TypeError):
            continue
    if text and not text.endswith("\n"):
        with path.open("a", encoding="utf-8") as file:
            file.write("\n")
    return found


@cache
def _code_digest() -> str:
    """Of the code that figures depend on: after a change nothing old is mixed in."""
    home = Path(smooth_operator.__file__).parent
    total = hashlib.sha256()
    for name in _CODE:
        for file in sorted((home / name).glob("*.py")):
            total.update(os.fsencode(file.name) + b"\0" + file.read_bytes())
    return total.hexdigest()
