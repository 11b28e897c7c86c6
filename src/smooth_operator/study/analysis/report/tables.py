"""Texts of the report: numbers and names, rows of longer tables, the conclusion at its top."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final

from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.dunnett import holm
from smooth_operator.study.analysis.frame import INDEX, INTERCEPT
from smooth_operator.study.analysis.readings import Interaction
from smooth_operator.study.analysis.results import MODES, OUTCOMES, POOLED, Outcome, ScopeResult
from smooth_operator.study.design.protocol import FEW_OPERATORS

MINUS: Final = "\N{MINUS SIGN}"
DIGITS: Final[dict[Outcome, tuple[float, int, str]]] = {
    "success": (100.0, 1, "%"), "time": (1.0, 2, "s"), "tlx": (1.0, 2, "points"),
}  # fmt: skip
"""Outcome -> factor, decimals and unit of its numbers."""
_OUTCOMES: Final = {
    "success": ("success", "percentage points"),
    "time": ("completion time", "s"),
    "tlx": ("workload", "points"),
}
_LEVELS: Final = {
    "operator": "operators", "operator:retargeter": "operators' preferences", "block": "blocks",
    "residual": "trials",
}  # fmt: skip
_SLOPES: Final = {
    "trial_global": "per trial of the task",
    "trial_in_block": "per trial of the block",
    "tlx_index": "per questionnaire of the task",
    "in_block": "per questionnaire of the block",
}


def number(value: float | None, digits: int = 2) -> str:
    """Formats a number with decimals; a dash for None and NaN, ∞ for infinity."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    text = f"{value:.{digits}f}"
    if text.startswith("-"):
        text = text[1:] if not text.strip("-0.") else MINUS + text[1:]
    return text


def signed(value: float | None, digits: int = 2) -> str:
    """Formats a number with its sign, + or minus; no sign for zero."""
    text = number(value, digits)
    plain = value is None or not math.isfinite(value) or not text.strip("0.")
    return text if plain or text.startswith(MINUS) else f"+{text}"


def span(lower: float | None, upper: float | None, digits: int = 2, *, sign: bool = False) -> str:
    """Formats an interval."""
    shown = signed if sign else number
    return f"{shown(lower, digits)} to {shown(upper, digits)}"


def with_minus(text: str) -> str:
    """Replaces the hyphens of the numbers in a text by minus signs."""
    return re.sub(r"(?<![\w.,)-])-(?=\d)", MINUS, text)


def p_text(p: float | None) -> str:
    """Formats a p-value."""
    if p is None or math.isnan(p):
        return "–"
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def p_equation(p: float | None) -> str:
    """Formats a p-value as ``p = 0.012`` or ``p < 0.001``."""
    text = p_text(p)
    return f"p {text}" if text.startswith("<") else f"p = {text}"


def scope_name(scope: str) -> str:
    """Name of a scope for readers."""
    return "all tasks" if scope == POOLED else f"task {scope}"


def term_names(result: ScopeResult) -> dict[str, str]:
    """Names of the coefficients for readers, by their names in the results."""
    retargeters = list(result.emm)
    cells = result.diagnostics.get("rows_per_cell", {})
    tasks = sorted({task for row in cells.values() for task in row})
    names = {INTERCEPT: f"intercept: {retargeters[0]}" if retargeters else "intercept"}
    if len(tasks) > 1 and retargeters:
        names[INTERCEPT] += f", task {tasks[0]}"
    names |= {f"retargeter{name}": f"{name} instead of {retargeters[0]}" for name in retargeters}
    names |= {f"task{name}": f"task {name} instead of {tasks[0]}" for name in tasks}
    names[INDEX] = "trial index, per standard deviation"
    return {name: names.get(name, name) for name in result.coefficients}


def learning_rows(learning: Mapping[str, Any]) -> tuple[list[tuple[str, str, list[str]]], int]:
    """Makes rows of the slopes by scope and index, with p-values corrected over the whole table.

    Returns:
        Name, reason of a refusal and cells of each slope; and the number of tests.
    """
    entries = [
        (f"{scope_name(scope)}: {_OUTCOMES[outcome][0]} {_SLOPES.get(index, index)}", outcome, one)
        for scope, indices in learning.items()
        for index, outcomes in indices.items()
        for outcome, one in outcomes.items()
    ]
    raw = [one.get("p_t", one.get("p_satterthwaite", math.nan)) for *_, one in entries]
    tested = [i for i, p in enumerate(raw) if not math.isnan(p)]
    adjusted = dict(zip(tested, holm([raw[i] for i in tested]), strict=True))
    rows: list[tuple[str, str, list[str]]] = []
    for i, (name, outcome, one) in enumerate(entries):
        if "refused" in one:
            rows.append((name, one["refused"], []))
            continue
        if "slope_logit" in one:  # percentage points are better known than logits
            slope = 100 * one["ame_prob_per_unit"]
            # The error of mode small-sample belongs to the p-value.
            wider = one.get("se_mancl_derouen", one["se"]) / one["se"]
            se = 100 * one["ame_se"] * wider
        else:
            slope, se = one["slope"], one.get("se_mancl_derouen", one["se"])
        step = f"{signed(slope, 3)} {_OUTCOMES[outcome][1]}"
        rows.append((name, "", [step, number(se, 3), p_text(raw[i]), p_text(adjusted.get(i))]))
    return rows, len(tested)


def correlation_rows(spearman: Mapping[str, Any]) -> list[list[str]]:
    """Makes rows of the correlations within operators and over the retargeters' means."""
    rows = []
    for pair, entry in spearman.items():
        if "rho" not in entry:
            continue
        within, means = entry["within"], entry["means"]
        row = [pair.replace("~", " ~ "), f"{signed(entry['rho'])}, n = {entry['n']}"]
        if "refused" in within:
            row += [within["refused"], "", ""]
        else:
            interval = span(within["lcl"], within["ucl"], sign=True)
            row.append(f"{signed(within['rho'])} [{interval}], {within['operators']} operators")
            row += [p_text(within["p"]), p_text(within["p_holm"])]
        rows.append([*row, f"{signed(means['rho'])}, n = {means['n']}"])
    return rows


def model_facts(result: ScopeResult) -> str:
    """Describes formula, rows and variances of a model in a line."""
    facts = result.model
    parts = [
        f"{facts.get('kind', '')}: {facts.get('formula', '')}",
        f"{result.n} rows, {result.operators} operators",
    ]
    if variances := facts.get("variances", {}):
        spreads = (
            f"{_LEVELS.get(name, name)} {number(math.sqrt(value))}"
            for name, value in variances.items()
        )
        parts.append(f"standard deviations: {', '.join(spreads)}")
    if "alpha" in facts:
        parts.append(f"working correlation {number(facts['alpha'], 3)}")
    return "; ".join(parts)


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
