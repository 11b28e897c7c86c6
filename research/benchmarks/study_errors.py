"""Family-wise error of a study's analysis: how often it finds a difference where there is none.

    python research/benchmarks/study_errors.py --studies 1000 --workers 2

Every retargeter of a simulated study is as good as the others; a family (Dunnett's against the
baseline, Holm's of all pairs) errs if any difference is significant at 5 %. Designs and noise are
in ``DESIGNS``. Studies have seeds of their own, and finished ones are kept: a stopped run goes on,
and one with more studies adds to them. The generator is not that of ``study power``.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import tyro

from smooth_operator.cli.console import Progressing
from smooth_operator.result_cache import Job
from smooth_operator_research.run_report import markdown
from smooth_operator_study.analysis.results import MODES, OUTCOMES, POOLED
from smooth_operator_study.chunks import chunk_values, study_digest
from smooth_operator_study.data import StudyData
from smooth_operator_study.data.rows import questionnaires_table
from smooth_operator_study.design.plan import Plan, make_plan
from smooth_operator_study.design.protocol import Condition, Protocol, Task
from smooth_operator_study.power.power_run import rate, verdicts
from smooth_operator_study.power.simulated_study import codes_of, planned_data
from smooth_operator_study.result_log import ResultLog
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES

Three = tuple[float, float, float]
"""Effects on success [logit], time [s] and workload [points]."""

NONE: Final[Three] = (0.0, 0.0, 0.0)
MODEST: Final[Three] = (0.3, 2.0, 5.0)
LARGE: Final[Three] = (0.6, 3.0, 8.0)
OPERATORS: Final[Three] = (0.6, 4.0, 10.0)
TRIALS: Final = (7.0, 6.0, 8.0)
"""Between trials [s], between questionnaires, and between the scales of one [points]."""
TASKS: Final = {"A": (0.55, -5.0, -4.0), "B": (-0.1, 0.5, 0.0), "C": (-0.45, 4.5, 4.0)}
MEANS: Final = (24.0, 42.0)
"""Time [s] and workload."""
CHUNK: Final = 20
FOUR: Final = ("dexpilot", "geort", "hybrid", "sbr")


@dataclass(frozen=True)
class Design:
    """Design of the simulated studies, and their variances.

    Attributes:
        operators: how many.
        tasks: name, trials a block, and how many operators do it.
        retargeters: how many.
        own: standard deviation of operator by retargeter.
        block: the same of every block by itself.
        success: probability, on average.
        log_normal: log-normal distribution of times, with the same spread.
        scope: what is analysed.
    """

    operators: int
    tasks: tuple[tuple[str, int, int], ...]
    retargeters: int = 4
    own: Three = NONE
    block: Three = NONE
    success: float = 0.44
    log_normal: bool = False
    scope: str = POOLED


PAPER: Final = (("A", 10, 12), ("B", 10, 8), ("C", 20, 6))
THREE: Final = (("A", 10, 5), ("B", 10, 5), ("C", 10, 5))
QUICK: Final = (("A", 10, 8), ("B", 10, 8))
DESIGNS: Final = {
    "paper's, operators differ": Design(18, PAPER),
    "same, task C alone": Design(18, PAPER, scope="C"),
    "same, log-normal times": Design(18, PAPER, log_normal=True),
    "paper's, operator × retargeter": Design(18, PAPER, own=MODEST),
    "paper's, the same, large": Design(18, PAPER, own=LARGE),
    "paper's, block noise": Design(18, PAPER, block=MODEST),
    "task A alone, operator × retargeter": Design(18, PAPER, own=MODEST, scope="A"),
    "task C alone, operator × retargeter": Design(18, PAPER, own=MODEST, scope="C"),
    "8 operators, 2 × 2, operator × retargeter": Design(8, QUICK, 2, own=MODEST),
    "8 operators, 2 × 2": Design(8, QUICK, 2),
    "5 operators, 4 × 3": Design(5, THREE),
    "5 operators, 4 × 3, operator × retargeter": Design(5, THREE, own=MODEST),
    "5 operators, 4 × 3, 6 % succeed": Design(5, THREE, success=0.06),
    "6 operators, 2 × 1": Design(6, (("A", 10, 6),), 2),
    "6 operators, 2 × 1, operator × retargeter": Design(6, (("A", 10, 6),), 2, own=MODEST),
}


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes:
        studies: studies of each design.
        designs: parts of the names of the designs; all if left out.
        workers: processes.
        seed: seed of all studies.
        output: folder that keeps the studies and the table.
    """

    studies: int = 1000
    designs: tuple[str, ...] = ()
    workers: int = 2
    seed: int = 0
    output: Path = Path("build/benchmarks/study_errors")


@dataclass(frozen=True)
class Chunk:
    """Some studies of one design."""

    design: str
    seed: int
    first: int
    count: int


def main(settings: Settings) -> None:
    chosen = [
        name
        for name in DESIGNS
        if not settings.designs or any(part in name for part in settings.designs)
    ]
    settings.output.mkdir(parents=True, exist_ok=True)
    code = study_digest()
    chunks = [
        Chunk(name, settings.seed, first, min(CHUNK, settings.studies - first))
        for first in range(0, settings.studies, CHUNK)
        for name in chosen
    ]
    jobs = [
        Job(
            "",
            {"chunk": vars(c), "design": repr(DESIGNS[c.design])},
            code,
            c,
            f"simulating {c.design}",
            c.count,
        )
        for c in chunks
    ]
    progress = Progressing()
    counts: dict[str, Counter[str]] = {name: Counter() for name in chosen}
    with progress.bar("simulating studies") as show:
        for chunk, values in chunk_values(
            jobs,
            ResultLog(settings.output / "studies.jsonl", progress.note),
            simulate,
            field="counts",
            workers=settings.workers,
            report=lambda done, total: show(f"{done} of {total} studies", done / total),
        ):
            counts[chunk.design].update(values)
    text = table(counts)
    (settings.output / "table.md").write_text(text, encoding="utf-8")
    plain = {name: dict(of) for name, of in counts.items()}
    (settings.output / "counts.json").write_text(json.dumps(plain, indent=1), encoding="utf-8")
    print(text)


def simulate(chunk: Chunk) -> dict[str, int]:
    """Counts the errors of each family and the refused analyses."""
    design = DESIGNS[chunk.design]
    plan = _plan(chunk.design)
    data = planned_data(plan)
    counts: Counter[str] = Counter(studies=chunk.count)
    for number in range(chunk.first, chunk.first + chunk.count):
        name = [ord(letter) for letter in chunk.design]
        study = draw(design, plan, data, np.random.default_rng([chunk.seed, number, *name]))
        for verdict in verdicts(study, FOUR[0], (design.scope,)):
            key = f"{verdict.outcome}/{verdict.mode}"
            counts[f"{key}/refused"] += verdict.refused is not None
            counts[f"{key}/dunnett"] += any(verdict.against.values())
            counts[f"{key}/holm"] += any(verdict.pairs.values())
    return dict(counts)


@lru_cache(maxsize=32)
def _plan(name: str) -> Plan:
    design = DESIGNS[name]
    conditions = tuple(Condition(name) for name in FOUR[: design.retargeters])
    tasks = tuple(Task(name, trials=n, operators=who) for name, n, who in design.tasks)
    return make_plan(Protocol("null", conditions, tasks, FOUR[0], design.operators))


def draw(design: Design, plan: Plan, data: StudyData, rng: np.random.Generator) -> StudyData:
    """Draws a study in which no retargeter is better than another."""
    conditions, tasks = plan.protocol.condition_names, [t.name for t in plan.protocol.tasks]
    shape = (len(plan.codes), len(conditions), len(tasks), 3)
    shift = (
        np.array(OPERATORS) * rng.standard_normal((shape[0], 1, 1, 3))
        + np.array(design.own) * rng.standard_normal((*shape[:2], 1, 3))
        + np.array(design.block) * rng.standard_normal(shape)
        + np.array([TASKS[name] for name in tasks])
    )

    def about(table: pd.DataFrame, column: str, kind: int, practice: float) -> Any:
        index = table[column].to_numpy()
        where = (
            codes_of(plan.codes, table.operator),
            codes_of(conditions, table.retargeter),
            codes_of(tasks, table.task),
        )
        return shift[(*where, kind)] + practice * (index - index.mean())

    trials, asked = data.trials, data.questionnaires
    assert asked is not None
    logit = np.log(design.success / (1 - design.success)) + about(trials, "trial_global", 0, 0.012)
    success = rng.random(len(logit)) < 1 / (1 + np.exp(-logit))
    mean = MEANS[0] + about(trials, "trial_global", 1, -0.06)
    noise = rng.standard_normal(len(mean))
    if design.log_normal:
        mean = np.maximum(mean, 3.0)
        spread = np.sqrt(np.log1p((TRIALS[0] / mean) ** 2))
        time = mean * np.exp(spread * noise - spread**2 / 2)
    else:
        time = np.maximum(mean + TRIALS[0] * noise, 2.0)
    workload = (
        MEANS[1] + about(asked, "index", 2, -0.4) + TRIALS[1] * rng.standard_normal(len(asked))
    )
    scales = workload[:, None] + TRIALS[2] * rng.standard_normal((len(workload), 6))
    answers = np.clip(5 * np.round(scales / 5), 0, 100)
    return replace(
        data,
        trials=trials.assign(score=success.astype(float), success=success, time=time),
        questionnaires=questionnaires_table(
            {**asked, **dict(zip(SCALE_NAMES, answers.T, strict=True))}
        ),
    )


def table(counts: dict[str, Counter[str]]) -> str:
    """Markdown: errors of both families in each mode with 95 % intervals (Wilson) [%]."""
    rows = []
    for name, own in counts.items():
        for outcome in OUTCOMES:
            cells = [
                _percent(own[f"{outcome}/{mode}/{family}"], own["studies"])
                for mode in MODES
                for family in ("dunnett", "holm")
            ]
            refused = 100 * own[f"{outcome}/small-sample/refused"] / own["studies"]
            rows.append([name, str(own["studies"]), outcome, *cells, f"{refused:.1f}"])
    families = [f"{family}, {mode}" for mode in MODES for family in ("Dunnett", "Holm")]
    return markdown(("design", "studies", "outcome", *families, "refused"), rows) + "\n"


def _percent(hits: int, studies: int) -> str:
    share: Any = rate(hits, studies)
    return f"{100 * share.rate:.1f} [{100 * share.lower:.1f}, {100 * share.upper:.1f}]"


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))
