"""Rows of each outcome, of all tasks or one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from smooth_operator.study.analysis.frame import Frame, make_frame
from smooth_operator.study.analysis.results import POOLED
from smooth_operator.study.data.rows import Questionnaires, Trials


def success_frame(trials: Trials, scope: str, baseline: str, index: str = "global") -> Frame:
    """All trials of a scope; the outcome is 1 for a score of 0.5 or 1."""
    return _trial_frame(
        trials, trials.success.astype(float), within(trials, scope), baseline, index
    )


def time_frame(trials: Trials, scope: str, baseline: str, index: str = "global") -> Frame:
    """Successful trials of a scope that have a time; the outcome is the time [s]."""
    rows = within(trials, scope) & trials.success & np.isfinite(trials.time)
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
    rows = within(table, scope) & np.isfinite(outcome)
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


def within(table: Trials | Questionnaires, scope: str) -> np.ndarray:
    """Which rows are of a scope (n,)."""
    everything = np.ones(len(table), bool)
    return everything if scope == POOLED else np.asarray(table.task == scope)
