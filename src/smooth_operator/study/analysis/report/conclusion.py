"""Conclusion of a study in a few lines, for the top of its report."""

from __future__ import annotations

from typing import Final

from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.report.report_tables import DIGITS, p_text
from smooth_operator.study.analysis.results import MODES, OUTCOMES, POOLED, Outcome, ScopeResult

_ALPHA: Final = 0.05
_NAMES: Final[dict[Outcome, str]] = {
    "success": "Success", "time": "Completion time", "tlx": "Workload",
}  # fmt: skip
_FIXED: Final = "\N{NO-BREAK SPACE}"  # a figure stays in the line of its unit


def conclusion(analysis: Analysis) -> list[str]:
    """Which retargeters differ from the baseline, by outcome; only what the tables hold.

    All tasks together, in the mode that is to be reported, Dunnett's p under 0.05. That none
    differs is no evidence that they are alike, and is not said to be.

    Returns:
        What was compared, then a line for each outcome; empty where there is no result.
    """
    found = analysis.results.get(MODES[0], {})
    parts = [
        f"{_NAMES[outcome]}: {_differences(outcome, found[outcome][POOLED])}."
        for outcome in OUTCOMES
        if POOLED in found.get(outcome, {})
    ]
    if not parts:
        return []
    compared = (
        f"Against {analysis.baseline}, all tasks together (mode {MODES[0]}, Dunnett, "
        f"p{_FIXED}<{_FIXED}{_ALPHA:g}):"
    )
    return [compared, *parts]


def _differences(outcome: Outcome, result: ScopeResult) -> str:
    if result.refused is not None or not result.dunnett:
        return "no result"
    scale, digits, unit = DIGITS[outcome]
    shown = [
        f"{'higher' if one.difference > 0 else 'lower'} with {name} "
        f"({scale * one.difference:+.{digits}f}{_FIXED}{_unit(unit)}, {_p(one.p_dunnett)})"
        for name, one in result.dunnett.items()
        if one.p_dunnett < _ALPHA
    ]
    return ", ".join(shown) or "no difference shown"


def _unit(unit: str) -> str:
    return "percentage points" if unit == "%" else unit


def _p(value: float) -> str:
    text = p_text(value)
    shown = f"p {text}" if text.startswith("<") else f"p = {text}"
    return shown.replace(" ", _FIXED)
