"""Runs thousands of simulated studies in processes, stores finished ones, and reports power.

The seed of a study depends only on its settings and its number, so the results do not depend on the
number of workers or on interruptions.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import msgspec
import numpy as np
from scipy.stats import binomtest

from smooth_operator.atomic_files import atomic_write, write_json
from smooth_operator.errors import StudyError
from smooth_operator.result_cache import Job, Note, no_note
from smooth_operator_study.analysis.dunnett import quantile
from smooth_operator_study.analysis.frame import outcome_frames
from smooth_operator_study.analysis.outcomes import analyze
from smooth_operator_study.analysis.results import (
    MODES,
    OUTCOMES,
    POOLED,
    Mode,
    Outcome,
    ScopeResult,
)
from smooth_operator_study.chunks import chunk_values, study_digest
from smooth_operator_study.data.rows import StudyData
from smooth_operator_study.design.plan import make_plan, scaled
from smooth_operator_study.design.plan_file import plan_of, plan_table
from smooth_operator_study.design.protocol import ALPHA, Protocol
from smooth_operator_study.power.simulated_study import Assumptions, Simulator
from smooth_operator_study.result_log import ResultLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Truth: TypeAlias = Literal["effects", "null"]
TRUTHS: Final[tuple[Truth, ...]] = ("effects", "null")
"""Simulated truths: the assumed differences, and every condition as good as the baseline."""
LOG: Final = "studies.jsonl"
"""Name of the file with the counts of finished chunks, one line each."""
_CHUNK: Final = 10
_LEAST_OPERATORS: Final = 3
Tally: TypeAlias = "Counter[str]"
"""Counts of verdicts: ``studies``, and ``OUTCOME/SCOPE/MODE/COUNT`` (see ``count``)."""
Tallies: TypeAlias = Mapping[tuple[int, "Truth"], Tally]
"""Counts for each number of operators and truth."""
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
            raise StudyError(f"power needs at least one simulated study, not {self.studies}")
        if not self.operators or min(self.operators) < _LEAST_OPERATORS:
            raise StudyError(
                f"power needs numbers of operators of at least {_LEAST_OPERATORS}, not "
                f"{list(self.operators)}"
            )
        if len(set(self.operators)) < len(self.operators):
            raise StudyError(f"a number of operators occurs twice: {list(self.operators)}")

    @property
    def outcomes(self) -> list[Outcome]:
        """Outcomes of the analysis."""
        return [one for one in OUTCOMES if one != "tlx" or self.protocol.questionnaires]

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
) -> Tallies:
    """Simulates and analyses studies; continues an earlier run in the same folder.

    Args:
        folder: existing folder for the finished chunks.
        workers: number of processes; None for one for each core, 0 for this process.
        note: called with a text on each entry of the folder that can't be used.
    """
    code = study_digest()
    jobs = [
        Job("", one, code, one, f"simulating {one.operators} operators", one.count)
        for one in _chunks(settings)
    ]
    log = ResultLog(folder / LOG, note)
    tallies = {(n, truth): Counter[str]() for n in settings.operators for truth in TRUTHS}
    for chunk, counts in chunk_values(
        jobs, log, simulate_chunk, field="counts", workers=workers, report=report
    ):
        tallies[chunk.operators, chunk.truth].update(counts)
    return tallies


def simulate_chunk(chunk: Chunk) -> dict[str, int]:
    """Simulates and analyses the studies of a chunk in a worker; returns the counts."""
    simulator, truth, protocol, scopes, seed = _prepared(
        chunk.setting, chunk.operators, chunk.truth
    )
    tally = Counter(studies=chunk.count)
    for number in range(chunk.first, chunk.first + chunk.count):
        rng = np.random.default_rng([seed, chunk.operators, TRUTHS.index(chunk.truth), number])
        for one in verdicts(simulator.draw(rng), protocol.baseline, scopes):
            where = f"{one.outcome}/{one.scope}/{one.mode}"
            counts = count(one, truth, protocol.baseline, protocol.margins)
            tally.update({f"{where}/{what}": number for what, number in counts.items()})
    return dict(tally)


@lru_cache(maxsize=8)
def _prepared(
    setting: str, operators: int, which: Truth
) -> tuple[Simulator, Assumptions, Protocol, list[str], int]:
    values = json.loads(setting)
    protocol = plan_of(values["plan"], "the plan").protocol
    truth = msgspec.convert(values["truth"], Assumptions)
    if which == "null":
        truth = truth.null(protocol.baseline)
    simulator = Simulator(make_plan(scaled(protocol, operators)), truth)
    return simulator, truth, protocol, values["scopes"], values["seed"]


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


Counts = dict[str, int]
"""Name of a count (see ``count``) -> number of studies."""


@dataclass(frozen=True)
class Verdict:
    """Significant differences of one outcome in one scope and mode.

    Attributes:
        outcome: success, time or tlx.
        scope: ``pooled`` or a task.
        mode: mode of the analysis.
        against: condition -> sign of its significant difference from the baseline by Dunnett, or 0.
        pairs: (condition, condition) -> sign of the significant difference by Holm, the first minus
            the second, or 0.
        smallest_margin: condition -> larger absolute end of the 90 % interval of its difference
            from the baseline. By two one-sided tests at 5 % both are equivalent within any larger
            margin.
        refused: reason why the analysis has no figures; None if it has.
    """

    outcome: Outcome
    scope: str
    mode: Mode
    against: dict[str, int]
    pairs: dict[tuple[str, str], int]
    refused: str | None = None
    smallest_margin: dict[str, float] = field(default_factory=dict)


def verdicts(
    study: StudyData,
    baseline: str,
    scopes: Sequence[str] = (POOLED,),
    outcomes: Sequence[Outcome] = OUTCOMES,
) -> Iterator[Verdict]:
    """Yields the verdicts on the outcomes of a study, in both modes.

    Args:
        baseline: retargeter that the others are compared with.
        scopes: ``pooled`` and tasks.
        outcomes: outcomes to analyse; one that the study lacks is left out.
    """
    for scope in scopes:
        for outcome, frame in outcome_frames(study, scope, baseline).items():
            if outcome not in outcomes:
                continue
            for mode, result in analyze(outcome, frame, decide=ALPHA).items():
                yield _verdict(Verdict(outcome, scope, mode, {}, {}), result, baseline)


def _verdict(blank: Verdict, result: ScopeResult, baseline: str) -> Verdict:
    """Makes the verdict from the tests of a model."""
    count = len(result.emm)
    if result.refused is not None or len(result.pairs) < count * (count - 1) // 2:
        return replace(blank, refused=result.refused or "a difference has no estimated error")
    pairs = {(one.a, one.b): _sign(one.difference, one.p_holm) for one in result.pairs.values()}
    against = {name: _sign(one.difference, one.p_dunnett) for name, one in result.dunnett.items()}
    margins = {
        name: abs(one.difference) + one.se * quantile(one.df, ALPHA)
        for name, one in result.dunnett.items()
    }
    return replace(blank, against=against, pairs=pairs, smallest_margin=margins)


def _sign(difference: float, p: float) -> int:
    return int(np.sign(difference)) if p <= ALPHA else 0


@dataclass(frozen=True)
class Rate:
    """Share of the simulated studies, with its error.

    Attributes:
        rate: share of the studies.
        se: Monte-Carlo standard error of the share.
        lower: lower end of the 95 % interval (Wilson 1927).
        upper: upper end of the 95 % interval.
    """

    rate: float
    se: float
    lower: float
    upper: float


def count(
    verdict: Verdict, truth: Assumptions, baseline: str, margins: Mapping[str, float] | None = None
) -> Counts:
    """Counts the right and wrong decisions of a verdict.

    Args:
        baseline: condition that the others are compared with.
        margins: outcome -> margin of equivalence in its unit.

    Returns:
        ``dunnett:NAME`` and ``holm:A-B``: a true difference was significant with its sign;
        ``dunnett:all`` and ``holm:all``: all true differences were; ``family:dunnett`` and
        ``family:holm``: a difference was significant that does not exist, or with the wrong sign;
        ``equivalent:NAME``: the difference from the baseline was shown to be below the margin;
        ``refused``: the analysis was refused.
    """
    if verdict.refused is not None:
        return {"refused": 1}
    values = {"success": truth.success, "time": truth.time_s, "tlx": truth.workload}
    value = values[verdict.outcome]
    counts: Counts = {}
    margin = (margins or {}).get(verdict.outcome)
    if margin is not None:
        for name, smallest in verdict.smallest_margin.items():
            if smallest < margin:
                counts[f"equivalent:{name}"] = 1
    families = {
        "dunnett": {name: (name, baseline, sign) for name, sign in verdict.against.items()},
        "holm": {f"{a}-{b}": (a, b, sign) for (a, b), sign in verdict.pairs.items()},
    }
    for family, tests in families.items():
        wrong, true, right = False, 0, 0
        for name, (a, b, sign) in tests.items():
            really = int(np.sign(value[a] - value[b]))
            true += really != 0
            if sign and sign == really:
                counts[f"{family}:{name}"] = 1
                right += 1
            wrong = wrong or (sign != 0 and sign != really)
        if wrong:
            counts[f"family:{family}"] = 1
        if true and right == true:
            counts[f"{family}:all"] = 1
    return counts


def rate(hits: int, studies: int) -> Rate:
    """Computes a share with its error."""
    p = hits / studies
    interval = binomtest(hits, studies).proportion_ci(method="wilson")
    return Rate(p, float(np.sqrt(p * (1 - p) / studies)), *map(float, interval))


FORMAT: Final = 1
RESULT: Final = "power.json"
PLOT: Final = "power.png"
TITLES: Final[dict[Outcome, str]] = {"success": "success", "time": "time", "tlx": "workload"}
ENOUGH: Final = 0.8
"""Usual target for the power."""
MOST_ERROR: Final = 0.07
"""Family-wise error above which a test is unreliable: 5 % plus the error of the simulation."""
_LINES: Final[dict[Mode, str]] = {"small-sample": "-", "paper": "--"}


def power_json(settings: PowerSettings, tallies: Tallies) -> dict[str, Any]:
    """Returns the content of ``power.json``.

    ``cells`` has an entry for each number of operators, truth, outcome, scope and mode. ``power``
    has the rates at which the true difference of a condition from the baseline (``dunnett``), that
    of a pair (``holm``) and ``all`` of them were significant, and at which a condition was shown to
    be ``equivalent`` to the baseline within the plan's margin. ``family_error`` is the rate of
    studies with a significant difference that does not exist; ``errs`` is true above 7 %.
    """
    cells = []
    analyses = product(tallies, settings.scopes, settings.outcomes, MODES)
    for (operators, truth), scope, outcome, mode in analyses:
        tally, where = tallies[operators, truth], f"{outcome}/{scope}/{mode}"
        power: dict[str, dict[str, Any]] = {"dunnett": {}, "holm": {}, "equivalent": {}}
        for what in sorted(key for key in tally if key.startswith(f"{where}/")):
            family, _, name = what.removeprefix(f"{where}/").partition(":")
            if family in power:
                power[family][name] = asdict(rate(tally[what], tally["studies"]))
        error = rate_of(tally, outcome, scope, mode, "family:dunnett")
        cells.append(
            {
                "operators": operators,
                "truth": truth,
                "outcome": outcome,
                "scope": scope,
                "mode": mode,
                "studies": tally["studies"],
                "power": power,
                "family_error": {
                    "dunnett": asdict(error),
                    "holm": asdict(rate_of(tally, outcome, scope, mode, "family:holm")),
                },
                "errs": truth == "null" and errs(error),
                "refused": asdict(rate_of(tally, outcome, scope, mode, "refused")),
            }
        )
    return {"format": FORMAT, "alpha": ALPHA, "settings": settings.to_json(), "cells": cells}


def errs(error: Rate) -> bool:
    """True if a family-wise error is above ``MOST_ERROR``."""
    return error.rate > MOST_ERROR


def write_power(settings: PowerSettings, tallies: Tallies, folder: Path) -> list[Path]:
    """Writes ``power.json`` and ``power.png`` into a folder."""
    write_json(folder / RESULT, power_json(settings, tallies), indent=1)
    draw_power(settings, tallies, folder / PLOT)
    return [folder / RESULT, folder / PLOT]


def rate_of(tally: Tally, outcome: str, scope: str, mode: str, what: str) -> Rate:
    """Returns the rate of a count, which may be zero."""
    return rate(tally[f"{outcome}/{scope}/{mode}/{what}"], tally["studies"])


def draw_power(
    settings: PowerSettings, tallies: Tallies, path: Path, *, scope: str = POOLED
) -> None:
    """Draws power over the number of operators by outcome, and the family-wise error below."""
    from matplotlib.figure import Figure  # not pyplot: no global state, no display

    truth = settings.truth
    values = {"success": truth.success, "time": truth.time_s, "tlx": truth.workload}
    outcomes = settings.outcomes
    figure = Figure(figsize=(4.2 * len(outcomes), 7.0), layout="constrained")
    axes = figure.subplots(2, len(outcomes), sharex=True, sharey="row", squeeze=False)
    baseline = settings.protocol.baseline
    others = [name for name in settings.protocol.condition_names if name != baseline]
    numbers = sorted(settings.operators)

    def line(
        on: Axes, outcome: Outcome, mode: Mode, truth: Truth, what: str, colour: str, label: str
    ) -> None:
        rows = [rate_of(tallies[n, truth], outcome, scope, mode, what) for n in numbers]
        bars = [[row.rate - row.lower for row in rows], [row.upper - row.rate for row in rows]]
        on.errorbar(
            numbers,
            [row.rate for row in rows],
            yerr=bars,
            color=colour,
            linestyle=_LINES[mode],
            marker="o",
            markersize=3,
            linewidth=1.2,
            elinewidth=0.8,
            label=label,
        )

    for column, outcome in enumerate(outcomes):
        top, bottom = axes[0, column], axes[1, column]
        for number, name in enumerate(others):
            difference = values[outcome][name] - values[outcome][baseline]
            if difference == 0:
                continue
            for mode in MODES:
                shown = f"{name} ({_shown(outcome, difference)})" if mode == MODES[0] else ""
                line(top, outcome, mode, "effects", f"dunnett:{name}", f"C{number}", shown)
        for mode in MODES:
            line(bottom, outcome, mode, "null", "family:dunnett", "black", mode)
        top.set_title(f"{TITLES[outcome]}, against {baseline}")
        top.axhline(ENOUGH, color="0.7", linewidth=0.8, zorder=0)
        bottom.axhline(ALPHA, color="0.7", linewidth=0.8, zorder=0)
        bottom.axhspan(MOST_ERROR, 1.0, color="C3", alpha=0.08, linewidth=0, zorder=0)
        bottom.set_xlabel("operators")
        top.legend(fontsize=8, loc="lower right")
    axes[0, 0].set_ylim(-0.02, 1.02)
    axes[0, 0].set_ylabel("power (solid small-sample, dashed paper)")
    worst = [
        rate_of(tallies[n, "null"], outcome, scope, mode, "family:dunnett").upper
        for n in settings.operators
        for outcome in outcomes
        for mode in MODES
    ]
    axes[1, 0].set_ylim(0.0, 1.1 * max([*worst, 1.4 * MOST_ERROR]))
    axes[1, 0].set_ylabel("family-wise error without differences\n(shaded: over 7 %)")
    axes[1, 0].legend(fontsize=8)
    figure.suptitle(
        f"{settings.protocol.name}: {settings.studies} simulated studies each, bars 95 %",
        fontsize=10,
    )
    with atomic_write(path) as file:
        figure.savefig(file, format="png", dpi=120)


def _shown(outcome: Outcome, difference: float) -> str:
    if outcome == "success":
        return f"{100 * difference:+.1f} %"
    return f"{difference:+.1f} {'s' if outcome == 'time' else 'points'}"
