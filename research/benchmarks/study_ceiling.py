"""Tests of success where a retargeter never fails: their error in null studies, and their power.

    python research/benchmarks/study_ceiling.py

Null studies: all retargeters succeed alike, so often that one of them may never fail. Counted is
how often any comparison is significant at 5 %, in all studies and in those with such a retargeter.
Power: one retargeter never fails; the same studies are analysed again with one and with three of
its trials failed. The other three are equally good, so every difference that is found between them
is an error, although one retargeter does differ. A study has a seed of its own. Only success is
analysed, in mode small-sample.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import tyro

from smooth_operator_research.run_report import markdown
from smooth_operator_study.analysis.frame import frame_of
from smooth_operator_study.analysis.outcomes import analyze
from smooth_operator_study.analysis.results import MODES, POOLED, ScopeResult
from smooth_operator_study.data.rows import StudyData, successes
from smooth_operator_study.design.plan import make_plan
from smooth_operator_study.design.protocol import ALPHA, Condition, Protocol, Task
from smooth_operator_study.power.power_run import rate
from smooth_operator_study.power.simulated_study import Simulator, Spread, assumptions_for

NAMES: Final = ("dexpilot", "geort", "hybrid", "sbr")
PERFECT: Final = "sbr"
DESIGNS: Final = {
    "6 operators, 10 trials": (6, 10),
    "8 operators, 10 trials": (8, 10),
    "6 operators, 20 trials": (6, 20),
}
"""Design -> operators, and trials of a block; four retargeters, one task."""
RATES: Final = (0.93, 0.97, 0.985)
PREFERENCES: Final = (0.3, 0.8)
"""Standard deviation of an operator's preference for single retargeters [logit]."""
OTHERS: Final = (0.55, 0.7, 0.8)
FAILURES: Final = (0, 1, 3)


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes:
        studies: studies of each design and rate.
        seed: seed of all studies.
    """

    studies: int = 400
    seed: int = 0


def main(settings: Settings) -> None:
    errors, powers = [], []
    for design in DESIGNS:
        for share in RATES:
            for preference in PREFERENCES:
                counts = null_counts(design, share, preference, settings)
                errors.append([design, f"{100 * share:g}", f"{preference:g}", *_cells(counts)])
        for share in OTHERS:
            counts = power_counts(design, share, settings)
            cells = [
                _percent(counts[f"{what} {failures}"], settings.studies)
                for what in ("power", "error")
                for failures in FAILURES
            ]
            powers.append([design, f"{100 * share:g}", *cells])
    titles = (
        "design",
        "success [%]",
        "preference [logit]",
        "studies with a separated retargeter",
        "Dunnett",
        "Holm",
        "Dunnett, separated",
        "Holm, separated",
        "refused",
    )
    print(markdown(titles, errors), end="\n\n")
    heading = (
        "design",
        "others succeed [%]",
        *(f"power, {k} failures" for k in FAILURES),
        *(f"error among the others, {k} failures" for k in FAILURES),
    )
    print(markdown(heading, powers))


def simulator(design: str, share: float, preference: float) -> Simulator:
    """Simulator of a design whose retargeters all have the same success rate."""
    operators, trials = DESIGNS[design]
    task = Task("A", trials=trials)
    conditions = tuple(Condition(name) for name in NAMES)
    plan = make_plan(Protocol("ceiling", conditions, (task,), NAMES[0], operators))
    truth = assumptions_for(
        NAMES, success=dict.fromkeys(NAMES, share), interaction=Spread(preference, 2.0, 5.0)
    )
    return Simulator(plan, truth)


def success_of(study: StudyData) -> ScopeResult:
    """Decisions on the success of a study."""
    frame = frame_of(successes(study.trials), POOLED, NAMES[0])
    return analyze("success", frame, modes=MODES[:1], decide=ALPHA)[MODES[0]]


def null_counts(design: str, share: float, preference: float, settings: Settings) -> Counter[str]:
    """Counts significant and refused null studies, all and those with a separated retargeter."""
    drawn, counts = simulator(design, share, preference), Counter(all=settings.studies)
    for number in range(settings.studies):
        result = success_of(drawn.draw(np.random.default_rng([settings.seed, number])))
        found = {
            "dunnett": any(one.p_dunnett <= ALPHA for one in result.dunnett.values()),
            "holm": any(one.p_holm <= ALPHA for one in result.pairs.values()),
            "refused": result.refused is not None,
        }
        for name, yes in found.items():
            counts[name] += yes
            counts[f"{name}, separated"] += yes and bool(result.separated)
        counts["separated"] += bool(result.separated)
    return counts


def power_counts(design: str, share: float, settings: Settings) -> Counter[str]:
    """Counts studies in which the perfect retargeter is better, and those in which one of the
    others is found better than another, by the number of failures of the perfect one."""
    drawn, counts = simulator(design, share, PREFERENCES[0]), Counter[str]()
    for number in range(settings.studies):
        rng = np.random.default_rng([settings.seed, number])
        study = drawn.draw(rng)
        own = study.trials.index[study.trials.retargeter == PERFECT]
        lost = rng.permutation(own)
        for failures in FAILURES:
            success = study.trials.success.where(study.trials.retargeter != PERFECT, other=True)
            success[lost[:failures]] = False
            trials = study.trials.assign(success=success, score=success.astype(float))
            result = success_of(replace(study, trials=trials))
            test = result.dunnett.get(PERFECT)
            better = test is not None and test.p_dunnett <= ALPHA and test.difference > 0
            counts[f"power {failures}"] += better
            wrong = [one.p_dunnett for name, one in result.dunnett.items() if name != PERFECT]
            wrong += [one.p_holm for one in result.pairs.values() if PERFECT not in (one.a, one.b)]
            counts[f"error {failures}"] += any(p <= ALPHA for p in wrong)
    return counts


def _cells(counts: Counter[str]) -> list[str]:
    cells = [str(counts["separated"])]
    cells += [_percent(counts[name], counts["all"]) for name in ("dunnett", "holm")]
    for name in ("dunnett, separated", "holm, separated"):
        cells.append(_percent(counts[name], counts["separated"]))
    return [*cells, _percent(counts["refused"], counts["all"])]


def _percent(hits: int, studies: int) -> str:
    """Share with its 95 % interval (Wilson) [%]."""
    if not studies:
        return "–"
    share = rate(hits, studies)
    return f"{100 * share.rate:.1f} [{100 * share.lower:.1f}, {100 * share.upper:.1f}]"


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))
