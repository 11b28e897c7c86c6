"""Texts of the report: formatted numbers and names, rows of long tables, and the conclusion."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from smooth_operator_study.analysis.analyze import Analysis
from smooth_operator_study.analysis.dunnett import holm
from smooth_operator_study.analysis.frame import INDEX, INTERCEPT
from smooth_operator_study.analysis.models import NOT_SHOWN
from smooth_operator_study.analysis.outcomes import SKEW
from smooth_operator_study.analysis.readings import Interaction
from smooth_operator_study.analysis.results import (
    MODES,
    OUTCOMES,
    POOLED,
    Against,
    Outcome,
    Pair,
    ScopeResult,
)
from smooth_operator_study.design.protocol import ALPHA, FEW_OPERATORS, TESTED_OPERATORS

MINUS: Final = "\N{MINUS SIGN}"
DIGITS: Final[dict[Outcome, tuple[float, int, str]]] = {
    "success": (100.0, 1, "%"),
    "time": (1.0, 2, "s"),
    "tlx": (1.0, 2, "points"),
}
"""Outcome -> factor, decimals and unit of its numbers."""
NAMES: Final[dict[Outcome, str]] = {
    "success": "Success",
    "time": "Completion time",
    "tlx": "Workload",
}
_LEVELS: Final = {
    "operator": "operators",
    "operator:retargeter": "operators' preferences",
    "block": "blocks",
    "residual": "trials",
}
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


@dataclass(frozen=True)
class Slope:
    """Slope of learning, in the units of the report.

    Attributes:
        scope: ``pooled`` or the task.
        index: name of the index.
        outcome: outcome that changes.
        step: change per step of the index; percentage points for success.
        se: standard error of the change.
        p: uncorrected p-value.
        p_holm: p-value corrected over all slopes of the study; None without a test.
        refused: reason why there is no slope; empty if there is one.
    """

    scope: str
    index: str
    outcome: Outcome
    step: float = math.nan
    se: float = math.nan
    p: float = math.nan
    p_holm: float | None = None
    refused: str = ""


def learning_slopes(learning: Mapping[str, Any]) -> list[Slope]:
    """Collects the slopes of all scopes, indices and outcomes, and corrects their p-values."""
    slopes = []
    for scope, indices in learning.items():
        for index, outcomes in indices.items():
            for outcome, one in outcomes.items():
                if "refused" in one:
                    slopes.append(Slope(scope, index, outcome, refused=one["refused"]))
                    continue
                se = one.get("se_mancl_derouen", one["se"])
                if "slope_logit" in one:  # percentage points are better known than logits
                    # The error of mode small-sample belongs to the p-value.
                    wider = se / one["se"]
                    step, se = 100 * one["ame_prob_per_unit"], 100 * one["ame_se"] * wider
                else:
                    step = one["slope"]
                p = one.get("p_t", one.get("p_satterthwaite", math.nan))
                slopes.append(Slope(scope, index, outcome, step, se, p))
    tested = [i for i, one in enumerate(slopes) if not math.isnan(one.p)]
    for i, p in zip(tested, holm([slopes[i].p for i in tested]), strict=True):
        slopes[i] = replace(slopes[i], p_holm=p)
    return slopes


def learning_rows(learning: Mapping[str, Any]) -> tuple[list[tuple[str, str, list[str]]], int]:
    """Makes rows of the slopes by scope and index.

    Returns:
        Name, reason of a refusal and cells of each slope; and the number of tests.
    """
    slopes = learning_slopes(learning)
    rows: list[tuple[str, str, list[str]]] = []
    for one in slopes:
        title, unit = NAMES[one.outcome].lower(), _unit(DIGITS[one.outcome][2])
        name = f"{scope_name(one.scope)}: {title} {_SLOPES[one.index]}"
        cells = [
            f"{signed(one.step, 3)} {unit}",
            number(one.se, 3),
            p_text(one.p),
            p_text(one.p_holm),
        ]
        rows.append((name, one.refused, [] if one.refused else cells))
    return rows, sum(one.p_holm is not None for one in slopes)


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
    if (least := result.diagnostics.get("least_p")) is not None:
        shown = f"{least:.1e}" if least < 0.001 else number(least, 3)
        parts.append(
            f"smallest p that these rows can reach {shown} (one retargeter always succeeds, "
            "the others never)"
        )
    if "alpha" in facts:
        parts.append(f"working correlation {number(facts['alpha'], 3)}")
    return "; ".join(parts)


SELECTED: Final = (
    "Times include only successful trials, so a retargeter that fails in hard trials looks faster"
)
"""Warning on every comparison of times."""


def row_note(name: str, result: ScopeResult, baseline: str) -> str:
    """Note next to the name of a retargeter: the baseline, or that it never or always succeeds."""
    notes = ["baseline"] if name == baseline else []
    if alone := result.separated.get(name):
        notes.append(f"{'all' if alone.rate else 'none'} of {alone.trials} succeeded")
    return ", ".join(notes)


def effect_text(test: Against | Pair) -> str:
    """Formats an effect size, with its word if the difference is shown."""
    size = signed(test.effect)
    return size if test.effect_words == NOT_SHOWN else f"{test.effect_words} ({size})"


def ratio_rows(result: ScopeResult) -> list[list[str]]:
    """Makes rows of geometric means and of ratios to the baseline, from means of logarithms."""
    rows = []
    for name, mean in result.emm.items():
        row = [
            name,
            number(math.exp(mean.estimate)),
            span(math.exp(mean.lower), math.exp(mean.upper)),
        ]
        if test := result.dunnett.get(name):
            row += [
                number(math.exp(test.difference)),
                span(math.exp(test.lower), math.exp(test.upper)),
                p_text(test.p_dunnett),
            ]
        rows.append(row + [""] * (6 - len(row)))
    return rows


_FIXED: Final = "\N{NO-BREAK SPACE}"  # a figure stays in the line of its unit


def conclusion(analysis: Analysis) -> list[str]:
    """Writes the result in five sentences: the data, each outcome, and what limits them.

    The primary outcome comes first; the others are called exploratory. All differences have effect
    sizes and simultaneous intervals. A difference that is not shown is not evidence of equality,
    and the text says so.
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
    operators, trials = len(analysis.data.flow.analysed), len(analysis.data.trials)
    first = (
        f"{operators} operators did {trials:,} trials with {len(analysis.retargeters)} "
        f"retargeters; each is compared with {analysis.baseline}, over all tasks unless "
        "stated otherwise, with simultaneous 95 % intervals (Dunnett)"
    )
    if outcome is None:
        return f"{first}; no primary outcome was planned, so all results are exploratory."
    return f"{first}; the primary outcome is {NAMES[outcome].lower()}, {scope_name(scope)}."


def _outcome(analysis: Analysis, outcome: Outcome, scope: str, *, primary: bool) -> str:
    result = analysis.results[MODES[0]][outcome][scope]
    rank = "primary" if primary else "exploratory"
    text = f"{NAMES[outcome]} ({rank}): {_differences(outcome, result)}."
    return f"{text} {SELECTED}." if outcome == "time" and result.refused is None else text


def _differences(outcome: Outcome, result: ScopeResult) -> str:
    if result.refused is not None:
        return f"not tested: {with_minus(result.refused)}"
    scale, digits, unit = DIGITS[outcome]
    few = result.operators < TESTED_OPERATORS
    shown_ones: list[str] = []
    open_: list[str] = []
    for name, one in result.dunnett.items():
        alone = result.separated.get(name)
        always = "" if alone is None else f" ({'always' if alone.rate else 'never'} succeeds)"
        size = f"{name}{always} {signed(scale * one.difference, digits)}{_FIXED}{_unit(unit)}"
        low, high = (signed(scale * end, digits) for end in (one.lower, one.upper))
        shown = size if few else f"{size} [{low}, {high}], {_p(one.p_dunnett)}"
        if one.p_dunnett < ALPHA and not few:
            shown_ones.append(f"{shown}, {one.effect_words}")
        else:
            open_.append(shown)
    if not shown_ones and not open_:
        return "no result to compare with the baseline"
    if few:
        return (
            f"not tested with {result.operators} operators, because the tests were validated "
            f"only for {TESTED_OPERATORS} or more; estimated {'; '.join(open_)}"
        )
    if not shown_ones:
        return f"no difference shown ({'; '.join(open_)})"
    return "; ".join(shown_ones) + (f"; not shown for {'; '.join(open_)}" if open_ else "")


def _limits(analysis: Analysis, outcome: Outcome | None, scope: str) -> str:
    parts = []
    count = len(analysis.data.flow.analysed)
    if count < FEW_OPERATORS:
        parts.append(
            f"with {count} operators, only very large differences can be shown; "
            "smooth-operator study power estimates how many are needed"
        )
    for one, test in analysis.readings.interaction.items():
        if isinstance(test, Interaction) and test.found:
            parts.append(
                f"differences in {NAMES[one].lower()} depend on the task "
                f"({_p(test.test.p)}), so their mean over tasks is of little use"
            )
    parts += _learned(analysis)
    parts += _logarithms(analysis, scope if outcome == "time" else POOLED)
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
    parts.append("a difference that is not significant is not evidence of equality")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _learned(analysis: Analysis) -> list[str]:
    """Names the outcomes that change over the trials of all tasks, corrected over all slopes."""
    if len(analysis.data.flow.analysed) < TESTED_OPERATORS:
        return []
    changes = [
        f"{NAMES[one.outcome].lower()} {signed(one.step, 3)}{_FIXED}"
        f"{_unit(DIGITS[one.outcome][2])} {_SLOPES[one.index]} ({_p(one.p_holm)}, Holm)"
        for one in learning_slopes(analysis.learning)
        if one.scope == POOLED and one.index in ("trial_global", "tlx_index")
        if one.p_holm is not None and one.p_holm < ALPHA
    ]
    if not changes:
        return []
    return [f"operators learn: {', '.join(changes)}; the differences are those at the mean trial"]


def _logarithms(analysis: Analysis, scope: str) -> list[str]:
    """Says whether the analysis of log times leads to other conclusions than that of skewed
    times."""
    result, logs = analysis.results[MODES[0]]["time"][scope], analysis.readings.log_time[scope]
    if abs(result.diagnostics.get("skewness", 0.0)) <= SKEW or logs.refused is not None:
        return []
    other = [
        f"{name} ({'shown' if logs.dunnett[name].p_dunnett < ALPHA else 'not shown'} there, "
        f"{_p(logs.dunnett[name].p_dunnett)})"
        for name, one in result.dunnett.items()
        if (one.p_dunnett < ALPHA) != (logs.dunnett[name].p_dunnett < ALPHA)
    ]
    told = (
        f"gives different decisions for {', '.join(other)}" if other else "gives the same decisions"
    )
    return [f"times are skewed, and the model of their logarithms (Further analyses) {told}"]


def _alike(analysis: Analysis, outcome: Outcome, scope: str) -> list[str]:
    tests = analysis.readings.equivalence[outcome].get(scope, {})
    scale, digits, unit = DIGITS[outcome]
    shown = [f"{one.a} and {one.b}" for one in tests.values() if one.equivalent]
    margins = [one.margin for one in tests.values() if one.margin is not None]
    if not margins:
        return ["no equivalence margin was planned"]
    within = f"the planned {number(scale * margins[0], digits)}{_FIXED}{_unit(unit)}"
    if shown:
        return [f"equivalent within {within}, pair by pair: {', '.join(shown)}"]
    return [f"no pair was shown to be equivalent within {within}"]


def _unit(unit: str) -> str:
    return "percentage points" if unit == "%" else unit


def _p(value: float) -> str:
    return p_equation(value).replace(" ", _FIXED)
