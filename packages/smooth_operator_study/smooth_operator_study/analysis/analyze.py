"""Analysis of a whole study, in both modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator_study.analysis.frame import Frame, Index, frame_of, outcome_frames
from smooth_operator_study.analysis.learning import linear_slope, logistic_slope
from smooth_operator_study.analysis.operators import leave_out, variance
from smooth_operator_study.analysis.outcomes import analyze
from smooth_operator_study.analysis.readings import (
    Interaction,
    Readings,
    interactions,
    read_further,
)
from smooth_operator_study.analysis.results import (
    MODES,
    POOLED,
    Mode,
    Outcome,
    Refused,
    ScopeResult,
    plain,
)
from smooth_operator_study.analysis.spearman import correlations
from smooth_operator_study.data.rows import StudyData, answers
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES

_DEFAULT_BASELINE: Final = "dexpilot"
"""Baseline of the paper, for data without a plan."""
_SLOPES: Final[tuple[tuple[str, Index, tuple[Outcome, ...]], ...]] = (
    ("trial_global", "global", ("time", "success")),
    ("trial_in_block", "in block", ("time", "success")),
    ("tlx_index", "global", ("tlx",)),
    ("in_block", "in block", ("tlx",)),
)
"""Name, index and outcomes of the slopes of learning."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """Results of a study in both modes.

    Attributes:
        data: data of the analysis.
        baseline: retargeter that the others are compared with.
        scopes: ``pooled`` and the tasks.
        retargeters: names of the retargeters, the baseline first.
        results: results by mode, outcome and scope.
        learning: slopes by scope, index and outcome.
        spearman: correlations by ``METRIC~OUTCOME``.
        tlx_items: results of the six scales by scope and scale, mode small-sample.
        interaction: test of retargeter x task by outcome.
        seed: seed of bootstraps and permutations.
    """

    data: StudyData
    baseline: str
    scopes: tuple[str, ...]
    retargeters: tuple[str, ...]
    results: dict[Mode, dict[Outcome, dict[str, ScopeResult]]]
    learning: dict[str, Any] = field(default_factory=dict)
    spearman: dict[str, Any] = field(default_factory=dict)
    tlx_items: dict[str, dict[str, ScopeResult]] = field(default_factory=dict)
    interaction: dict[Outcome, Interaction | Refused] = field(default_factory=dict)
    seed: int = 11

    @property
    def primary(self) -> tuple[str, str] | None:
        """Outcome and scope of the primary endpoint; None if no plan names one."""
        named = "" if self.data.plan is None else self.data.plan.primary
        outcome, _, scope = named.partition("/")
        return (outcome, scope) if named else None

    def role(self, outcome: str, scope: str) -> str:
        """Returns ``primary`` or ``exploratory``; empty if no plan names a primary endpoint."""
        if self.primary is None:
            return ""
        return "primary" if (outcome, scope) == self.primary else "exploratory"

    @cached_property
    def readings(self) -> Readings:
        """Sensitivity analyses, equivalence, interaction and preference."""
        small = self.results[MODES[0]]
        return read_further(
            self.data, self.retargeters, self.scopes, small, self.interaction, seed=self.seed
        )

    def to_json(self) -> dict[str, Any]:
        """Returns the content of ``results.json``."""
        content: dict[str, Any] = {mode: plain(outcomes) for mode, outcomes in self.results.items()}
        for mode in self.results:
            for outcome, scopes in content[mode].items():
                for scope, result in scopes.items():
                    result["role"] = self.role(outcome, scope) or None
        content["learning"] = plain(self.learning)
        content["spearman"] = plain(self.spearman)
        content["tlx_items"] = plain(self.tlx_items)
        content["readings"] = plain(self.readings)
        content["operator_variance"] = plain(variance(self.data))
        content["flow"] = plain(self.data.flow)
        planned, filled = self.data.plan, self.data.questionnaires
        content["study"] = {
            "baseline": self.baseline,
            "planned_baseline": None if planned is None else planned.baseline,
            "primary": None if self.primary is None else "/".join(self.primary),
            "margins": {} if planned is None else dict(planned.margins),
            "retargeters": list(self.retargeters),
            "tasks": [scope for scope in self.scopes if scope != POOLED],
            "operators": sorted({str(name) for name in self.data.trials.operator}),
            "trials": len(self.data.trials),
            "questionnaires": 0 if filled is None else len(filled),
            "workload": "raw",
            "notes": list(self.data.notes),
            "files": list(self.data.sources),
            "default_mode": MODES[0],
        }
        return content


def analyze_study(
    data: StudyData,
    baseline: str | None = None,
    *,
    exclude: Mapping[str, str] | None = None,
    seed: int = 11,
) -> Analysis:
    """Analyses success, time and workload, pooled and per task, in both modes.

    Args:
        data: data of the study; operators who withdrew with their data are left out.
        baseline: retargeter that the others are compared with; None for the plan's, or dexpilot
            without a plan.
        exclude: operator -> reason to leave them out as well.
        seed: seed of bootstraps and permutations.

    Returns:
        The analysis. A part that can't be analysed is refused with its reason.

    Raises:
        StudyError: the study has one operator or one retargeter, or an exclusion has no reason.
        UnknownNameError: no trial has the baseline, or there is no such operator to exclude.
    """
    data = leave_out(data, exclude)
    planned = _DEFAULT_BASELINE if data.plan is None else data.plan.baseline
    if data.plan is not None and baseline not in (None, planned):
        note = f"the baseline {baseline} was requested, but that of the plan is {planned}"
        data = replace(data, notes=(*data.notes, note))
    baseline = baseline or planned
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
            f"the study has one operator, {min(operators)}: results can't be generalised to "
            "other operators; at least two are needed, and ten or more are recommended"
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
        seed=seed,
    )
    for scope in analysis.scopes:
        _analyze_scope(analysis, scope)
        analysis.learning[scope] = _learning(data, scope, baseline)
        analysis.tlx_items[scope] = _items(analysis, scope)
    _warn_of_interactions(analysis)
    return replace(analysis, spearman=correlations(data, seed=seed))


def _analyze_scope(analysis: Analysis, scope: str) -> None:
    trials, filled = analysis.data.trials, analysis.data.questionnaires
    if scope != POOLED:
        trials = trials[trials.task == scope]
        filled = None if filled is None else filled[filled.task == scope]
    notes = {}
    if untimed := int((trials.success & trials.time.isna()).sum()):
        notes["time"] = f"{untimed} successful trial(s) without a time are excluded"
    if unanswered := 0 if filled is None else int(filled.workload.isna().sum()):
        notes["tlx"] = f"{unanswered} questionnaire(s) with a missing answer are excluded"
    for outcome, frame in outcome_frames(analysis.data, scope, analysis.baseline).items():
        missing = (*_missing(analysis, frame, scope), *filter(None, [notes.get(outcome)]))
        for mode, result in analyze(outcome, frame, missing).items():
            analysis.results[mode].setdefault(outcome, {})[scope] = result
    if filled is None:
        reason = "no questionnaires were given"
        none = ScopeResult(refused=reason, warnings=(f"not tested: {reason}",))
        for mode in MODES:
            analysis.results[mode].setdefault("tlx", {})[scope] = none


def _warn_of_interactions(analysis: Analysis) -> None:
    """Adds a warning to pooled results whose differences depend on the task."""
    analysis.interaction.update(interactions(analysis.data, analysis.baseline))
    for outcome, test in analysis.interaction.items():
        if isinstance(test, Refused) or not test.found:
            continue
        warning = (
            f"differences between retargeters depend on the task (p = {test.test.p:.2g}): "
            "look at each task; their mean gives all tasks equal weight"
        )
        for mode in MODES:
            scopes = analysis.results[mode][outcome]
            if scopes[POOLED].refused is None:
                pooled = scopes[POOLED]
                scopes[POOLED] = replace(pooled, warnings=(*pooled.warnings, warning))


def _missing(analysis: Analysis, frame: Frame, scope: str) -> tuple[str, ...]:
    """Notes on retargeters and tasks of the study without a row in the frame."""
    notes = []
    for name in analysis.retargeters:
        if name not in frame.retargeters:
            extra = ", so nothing is compared with it" if name == analysis.baseline else ""
            notes.append(f"no rows of {name}: it is excluded{extra}")
    if scope == POOLED:
        notes += [
            f"no rows of task {task}: means are over the other tasks"
            for task in analysis.scopes[1:]
            if task not in frame.tasks
        ]
    return tuple(notes)


def _learning(data: StudyData, scope: str, baseline: str) -> dict[str, Any]:
    rows = data.outcomes()
    slopes = {"success": logistic_slope, "time": linear_slope, "tlx": linear_slope}
    return {
        name: {one: slopes[one](frame_of(rows[one], scope, baseline, index)) for one in outcomes}
        for name, index, outcomes in _SLOPES
        if outcomes[0] in rows
    }


def _items(analysis: Analysis, scope: str) -> dict[str, ScopeResult]:
    table = analysis.data.questionnaires
    if table is None:
        return {}
    return {
        scale: analyze(
            "tlx",
            frame_of(answers(table, scale), scope, analysis.baseline),
            modes=MODES[:1],
            limits=False,
        )[MODES[0]]
        for scale in SCALE_NAMES
    }
