"""Conclusion of a study in five sentences, for the top of its report."""

from __future__ import annotations

from typing import Final

from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.readings import Interaction
from smooth_operator.study.analysis.report.tables import (
    DIGITS,
    number,
    p_equation,
    scope_name,
    signed,
    with_minus,
)
from smooth_operator.study.analysis.results import MODES, OUTCOMES, POOLED, Outcome, ScopeResult
from smooth_operator.study.design.protocol import FEW_OPERATORS

_ALPHA: Final = 0.05
NAMES: Final[dict[Outcome, str]] = {
    "success": "Success", "time": "Completion time", "tlx": "Workload",
}  # fmt: skip
_FIXED: Final = "\N{NO-BREAK SPACE}"  # a figure stays in the line of its unit


def conclusion(analysis: Analysis) -> list[str]:
    """Writes the result in five sentences: the data, each outcome, and what limits them.

    The primary outcome comes first; the others are called exploratory. All differences have effect
    sizes and simultaneous intervals. A difference that is not shown is no evidence of equality, and
    the text says so.
    """
    outcome, scope = primary_of(analysis)
    order = sorted(OUTCOMES, key=lambda one: one != outcome)
    return [
        _data(analysis, outcome, scope),
        *(
            _outcome(analysis, one, scope if one == outcome else POOLED, primary=one == outcome)
            for one in order
        ),
        _limits(analysis, outcome, scope),
    ]


def primary_of(analysis: Analysis) -> tuple[Outcome | None, str]:
    """Outcome and scope of the primary endpoint; (None, pooled) without a plan."""
    name, scope = analysis.primary or ("", POOLED)
    outcomes = [one for one in OUTCOMES if one == name]
    return (outcomes[0], scope) if outcomes and scope in analysis.scopes else (None, POOLED)


def _data(analysis: Analysis, outcome: Outcome | None, scope: str) -> str:
    trials = analysis.data.trials
    operators = len({str(name) for name in trials.operator})
    first = (
        f"{operators} operators did {len(trials):,} trials with {len(analysis.retargeters)} "
        f"retargeters; each is compared with {analysis.baseline}, all tasks together unless said "
        "otherwise, with simultaneous 95 % intervals (Dunnett)"
    )
    if outcome is None:
        return f"{first}; no primary outcome was planned, so all of it is exploratory."
    return f"{first}; the primary outcome is {NAMES[outcome].lower()}, {scope_name(scope)}."


def _outcome(analysis: Analysis, outcome: Outcome, scope: str, *, primary: bool) -> str:
    result = analysis.results[MODES[0]][outcome][scope]
    rank = "primary" if primary else "exploratory"
    return f"{NAMES[outcome]} ({rank}): {_differences(outcome, result, analysis.baseline)}."


def _differences(outcome: Outcome, result: ScopeResult, baseline: str) -> str:
    if result.refused is not None:
        return f"not tested: {with_minus(result.refused)}"
    scale, digits, unit = DIGITS[outcome]
    shown_ones: list[str] = []
    open_: list[str] = []
    for name, exact in result.separated.items():
        test = exact.against.get(baseline)
        always = "always" if exact.rate else "never"
        if test is None or test.p_dunnett is None:
            shown_ones.append(f"{name} {always} succeeds")
            continue
        shown = f"{name} {always} succeeds, exact {_p(test.p_dunnett)}"
        (shown_ones if test.p_dunnett < _ALPHA else open_).append(shown)
    for name, one in result.dunnett.items():
        low, high = (signed(scale * end, digits) for end in (one.lower, one.upper))
        shown = (
            f"{name} {signed(scale * one.difference, digits)}{_FIXED}{_unit(unit)} "
            f"[{low}, {high}], {_p(one.p_dunnett)}"
        )
        if one.p_dunnett < _ALPHA:
            shown_ones.append(f"{shown}, {one.effect_words}")
        else:
            open_.append(shown)
    if not shown_ones and not open_:
        return "no result, nothing to compare with the baseline"
    if not shown_ones:
        return f"no difference shown ({'; '.join(open_)})"
    return "; ".join(shown_ones) + (f"; not shown for {'; '.join(open_)}" if open_ else "")


def _limits(analysis: Analysis, outcome: Outcome | None, scope: str) -> str:
    parts = []
    count = len({str(name) for name in analysis.data.trials.operator})
    if count < FEW_OPERATORS:
        parts.append(
            f"with {count} operators only very large differences can be shown; smooth-operator "
            "study power says how many are needed"
        )
    for one, test in analysis.readings.interaction.items():
        if isinstance(test, Interaction) and test.found:
            parts.append(
                f"differences in {NAMES[one].lower()} depend on the task "
                f"({_p(test.test.p)}), so their mean over tasks says little"
            )
    if outcome is not None:
        parts += _alike(analysis, outcome, scope)
    refused = [
        f"{NAMES[one].lower()} in {scope_name(part)}"
        for one in OUTCOMES
        for part, result in analysis.results[MODES[0]][one].items()
        if result.refused is not None and (one != "tlx" or analysis.data.questionnaires is not None)
    ]
    if refused:
        parts.append(f"not tested, for the reasons in their sections: {', '.join(refused)}")
    parts.append("a difference that is not shown is no evidence of equality")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _alike(analysis: Analysis, outcome: Outcome, scope: str) -> list[str]:
    tests = analysis.readings.equivalence[outcome].get(scope, {})
    scale, digits, unit = DIGITS[outcome]
    shown = [f"{one.a} and {one.b}" for one in tests.values() if one.equivalent]
    margins = [one.margin for one in tests.values() if one.margin is not None]
    if not margins:
        return ["no margin of equivalence was planned"]
    within = f"the planned {number(scale * margins[0], digits)}{_FIXED}{_unit(unit)}"
    if shown:
        return [f"equivalent within {within}, pair by pair: {', '.join(shown)}"]
    return [f"no pair was shown to be equivalent within {within}"]


def _unit(unit: str) -> str:
    return "percentage points" if unit == "%" else unit


def _p(value: float) -> str:
    return p_equation(value).replace(" ", _FIXED)
