"""The whole analysis of a study, in both modes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.study.analysis.frame import Frame, make_frame
from smooth_operator.study.analysis.learning import linear_slope, logistic_slope
from smooth_operator.study.analysis.linear_outcome import analyze_linear
from smooth_operator.study.analysis.operators import variance
from smooth_operator.study.analysis.results import (
    MODES,
    POOLED,
    Mode,
    Outcome,
    ScopeResult,
    plain,
)
from smooth_operator.study.analysis.spearman import correlations
from smooth_operator.study.analysis.success_outcome import analyze_success
from smooth_operator.study.data.rows import ITEMS, Questionnaires, StudyData, Trials, Workload

Report = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Analysis:
    """What came of a study.

    Attributes:
        data: what was analysed.
        baseline: the retargeter that others are compared with.
        scopes: ``pooled`` and the tasks.
        retargeters: the baseline first.
        results: by mode, outcome and scope.
        learning: by scope, index and outcome.
        spearman: by ``METRIC~OUTCOME``.
        tlx_items: by scope and item, ``emm`` and ``dunnett`` as in the results, mode small-sample.
    """

    data: StudyData
    baseline: str
    scopes: tuple[str, ...]
    retargeters: tuple[str, ...]
    results: dict[Mode, dict[Outcome, dict[str, ScopeResult]]]
    learning: dict[str, Any] = field(default_factory=dict)
    spearman: dict[str, Any] = field(default_factory=dict)
    tlx_items: dict[str, dict[str, ScopeResult]] = field(default_factory=dict)

    @property
    def workload(self) -> Workload:
        """What is meant by workload."""
        return "raw" if self.data.questionnaires is None else self.data.questionnaires.kind

    def to_json(self) -> dict[str, Any]:
        """The content of ``results.json``."""
        found: dict[str, Any] = {mode: plain(outcomes) for mode, outcomes in self.results.items()}
        found["learning"] = plain(self.learning)
        found["spearman"] = plain(self.spearman)
        found["tlx_items"] = plain(self.tlx_items)
        found["operator_variance"] = plain(variance(self.data))
        found["study"] = {
            "baseline": self.baseline,
            "retargeters": list(self.retargeters),
            "tasks": [scope for scope in self.scopes if scope != POOLED],
            "operators": sorted({str(name) for name in self.data.trials.operator}),
            "trials": len(self.data.trials),
            "questionnaires": len(self.data.questionnaires or ()),
            "workload": self.workload,
            "notes": list(self.data.notes),
            "files": list(self.data.sources),
            "default_mode": MODES[0],
        }
        return found


def analyze_study(
    data: StudyData, baseline: str = "dexpilot", *, seed: int = 11, report: Report | None = None
) -> Analysis:
    """Analyses success, time and workload, pooled and per task, in both modes.

    Args:
        data: the study.
        baseline: the retargeter that others are compared with.
        seed: of the bootstrap.
        report: is called with a text on what is being done.

    Returns:
        The analysis. What can't be analysed is refused there, with its reason, part by part.

    Raises:
        StudyError: one operator or one retargeter in all the study.
        UnknownNameError: no trial has the baseline.
    """
    tell = report or (lambda text: None)
    trials = data.trials
    names = sorted({str(name) for name in trials.retargeter})
    if len(names) < 2:
        raise StudyError(
            f"the study has one retargeter, {names[0]}: there is nothing to compare it with"
        )
    if baseline not in names:
        raise UnknownNameError("baseline", baseline, names)
    operators = {str(name) for name in trials.operator}
    if len(operators) < 2:
        raise StudyError(
            f"the study has one operator, {min(operators)}: nothing can be said about operators in "
            "general; at least two are needed, and ten or more to be worth it"
        )
    tasks = sorted({str(name) for name in trials.task})
    if POOLED in tasks:
        raise StudyError(f"a task is called {POOLED!r}, which names all tasks together; rename it")
    analysis = Analysis(
        data=data,
        baseline=baseline,
        scopes=(POOLED, *tasks),
        retargeters=(baseline, *(name for name in names if name != baseline)),
        results={mode: {} for mode in MODES},
    )
    for scope in analysis.scopes:
        tell(f"{scope}: success, time, workload")
        _analyze_scope(analysis, scope)
        analysis.learning[scope] = _learning(data, scope, baseline)
        analysis.tlx_items[scope] = _items(analysis, scope)
    tell("simulation against study")
    return replace(analysis, spearman=correlations(data, seed=seed))


def success_frame(trials: Trials, scope: str, baseline: str, index: str = "global") -> Frame:
    """All trials of a scope; the outcome is 1 for a score of 0.5 or 1."""
    return _trial_frame(
        trials, trials.success.astype(float), _within(trials, scope), baseline, index
    )


def time_frame(trials: Trials, scope: str, baseline: str, index: str = "global") -> Frame:
    """Successful trials of a scope that have a time; the outcome is the time [s]."""
    rows = _within(trials, scope) & trials.success & np.isfinite(trials.time)
    return _trial_frame(trials, trials.time, rows, baseline, index)


def tlx_frame(
    table: Questionnaires,
    scope: str,
    baseline: str,
    index: str = "global",
    item: int | None = None,
) -> Frame:
    """Questionnaires of a scope; the outcome is the workload, or the answer to one item."""
    outcome = table.workload if item is None else table.answers[:, item]
    rows = _within(table, scope) & np.isfinite(outcome)
    return make_frame(
        outcome[rows],
        table.retargeter[rows],
        table.task[rows],
        table.operator[rows],
        (table.index if index == "global" else table.point)[rows],
        baseline,
    )


def _trial_frame(
    trials: Trials, outcome: Float[np.ndarray, " n"], rows: np.ndarray, baseline: str, index: str
) -> Frame:
    return make_frame(
        outcome[rows],
        trials.retargeter[rows],
        trials.task[rows],
        trials.operator[rows],
        (trials.trial_global if index == "global" else trials.trial_in_block)[rows],
        baseline,
    )


def _within(table: Trials | Questionnaires, scope: str) -> np.ndarray:
    everything = np.ones(len(table), bool)
    return everything if scope == POOLED else np.asarray(table.task == scope)


def _analyze_scope(analysis: Analysis, scope: str) -> None:
    data, baseline = analysis.data, analysis.baseline
    frame = success_frame(data.trials, scope, baseline)
    found: dict[Outcome, dict[Mode, ScopeResult]] = {
        "success": analyze_success(frame, _missing(analysis, frame, scope))
    }
    frame = time_frame(data.trials, scope, baseline)
    said = _missing(analysis, frame, scope)
    untimed = int(
        np.sum(_within(data.trials, scope) & data.trials.success & np.isnan(data.trials.time))
    )
    if untimed:
        said = (*said, f"{untimed} successful trial(s) without a time are left out")
    found["time"] = analyze_linear(frame, said)
    if data.questionnaires is None:
        reason = "no questionnaires were given"
        none = ScopeResult(refused=reason, warnings=(f"refused: {reason}",))
        found["tlx"] = dict.fromkeys(MODES, none)
    else:
        frame = tlx_frame(data.questionnaires, scope, baseline)
        said = _missing(analysis, frame, scope)
        left_out = int(
            np.sum(_within(data.questionnaires, scope) & np.isnan(data.questionnaires.workload))
        )
        if left_out:
            said = (*said, f"{left_out} questionnaire(s) with an answer missing are left out")
        found["tlx"] = analyze_linear(frame, said)
    for outcome, by_mode in found.items():
        for mode, result in by_mode.items():
            analysis.results[mode].setdefault(outcome, {})[scope] = result


def _missing(analysis: Analysis, frame: Frame, scope: str) -> tuple[str, ...]:
    """Retargeters and tasks of the study that have no row here."""
    said = []
    for name in analysis.retargeters:
        if name not in frame.retargeters:
            extra = ", so nothing is compared with it" if name == analysis.baseline else ""
            said.append(f"no rows of {name}: it is left out{extra}")
    if scope == POOLED:
        said += [
            f"no rows of task {task}: means are over the other tasks"
            for task in analysis.scopes[1:]
            if task not in frame.tasks
        ]
    return tuple(said)


def _learning(data: StudyData, scope: str, baseline: str) -> dict[str, Any]:
    trials = data.trials
    found: dict[str, Any] = {
        name: {
            "time": linear_slope(time_frame(trials, scope, baseline, index)),
            "success": logistic_slope(success_frame(trials, scope, baseline, index)),
        }
        for name, index in (("trial_global", "global"), ("trial_in_block", "in block"))
    }
    if data.questionnaires is not None:
        for name, index in (("tlx_index", "global"), ("in_block", "in block")):
            frame = tlx_frame(data.questionnaires, scope, baseline, index)
            found[name] = {"tlx": linear_slope(frame)}
    return found


def _items(analysis: Analysis, scope: str) -> dict[str, ScopeResult]:
    table = analysis.data.questionnaires
    if table is None:
        return {}
    return {
        item: analyze_linear(
            tlx_frame(table, scope, analysis.baseline, item=k), modes=MODES[:1], limits=False
        )[MODES[0]]
        for k, item in enumerate(ITEMS)
    }
