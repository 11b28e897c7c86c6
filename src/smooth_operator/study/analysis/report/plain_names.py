"""Names of model terms and learning indices for readers."""

from __future__ import annotations

from typing import Final

from smooth_operator.study.analysis.frame import INDEX, INTERCEPT
from smooth_operator.study.analysis.results import ScopeResult

_SLOPES: Final = {
    "trial_global": "per trial of the task",
    "trial_in_block": "per trial of the block",
    "tlx_index": "per questionnaire of the task",
    "in_block": "per questionnaire of the block",
}


def term_names(result: ScopeResult) -> dict[str, str]:
    """What each coefficient is, by its name in the results."""
    retargeters = list(result.emm)
    tasks = sorted({task for row in _cells(result).values() for task in row})
    found = {INTERCEPT: f"intercept: {retargeters[0]}" if retargeters else "intercept"}
    if len(tasks) > 1 and retargeters:
        found[INTERCEPT] += f", task {tasks[0]}"
    found |= {f"retargeter{name}": f"{name} instead of {retargeters[0]}" for name in retargeters}
    found |= {f"task{name}": f"task {name} instead of {tasks[0]}" for name in tasks}
    found[INDEX] = "trial index, per standard deviation"
    return {name: found.get(name, name) for name in result.coefficients}


def slope_name(index: str) -> str:
    """What a learning slope is counted in."""
    return _SLOPES.get(index, index)


def _cells(result: ScopeResult) -> dict[str, dict[str, int]]:
    return dict(result.diagnostics.get("rows_per_cell", {}))
