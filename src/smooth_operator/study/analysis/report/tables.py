"""Tables of the report, and numbers and names as a reader expects them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final

from smooth_operator.reporting.html import (
    Html,
    element,
    escape,
    failed_cell,
    join,
    name_cell,
    paragraph,
    table,
    text_table,
)
from smooth_operator.study.analysis.dunnett import holm
from smooth_operator.study.analysis.frame import INDEX, INTERCEPT
from smooth_operator.study.analysis.results import POOLED, Outcome, ScopeResult

MINUS = "\N{MINUS SIGN}"


def number(value: float | None, digits: int = 2) -> str:
    """A number with so many decimals; a dash where there is none, ∞ for infinity."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    text = f"{value:.{digits}f}"
    if text.startswith("-"):
        text = text[1:] if not text.strip("-0.") else MINUS + text[1:]
    return text


def signed(value: float | None, digits: int = 2) -> str:
    """A number with its sign, + or minus; none for a zero."""
    text = number(value, digits)
    plain = value is None or not math.isfinite(value) or not text.strip("0.")
    return text if plain or text.startswith(MINUS) else f"+{text}"


def span(lower: float | None, upper: float | None, digits: int = 2, *, sign: bool = False) -> str:
    """An interval."""
    shown = signed if sign else number
    return f"{shown(lower, digits)} to {shown(upper, digits)}"


def with_minus(text: str) -> str:
    """A sentence with minus signs for the hyphens of its numbers."""
    return re.sub(r"(?<![\w.,)-])-(?=\d)", MINUS, text)


def p_text(p: float | None) -> str:
    """A p-value as it is printed."""
    if p is None or math.isnan(p):
        return "–"
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def p_said(p: float | None) -> str:
    """``p = 0.012`` or ``p < 0.001``."""
    text = p_text(p)
    return f"p {text}" if text.startswith("<") else f"p = {text}"


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
    names = {INTERCEPT: f"intercept: {retargeters[0]}" if retargeters else "intercept"}
    if len(tasks) > 1 and retargeters:
        names[INTERCEPT] += f", task {tasks[0]}"
    names |= {f"retargeter{name}": f"{name} instead of {retargeters[0]}" for name in retargeters}
    names |= {f"task{name}": f"task {name} instead of {tasks[0]}" for name in tasks}
    names[INDEX] = "trial index, per standard deviation"
    return {name: names.get(name, name) for name in result.coefficients}


def slope_name(index: str) -> str:
    """What a learning slope is counted in."""
    return _SLOPES.get(index, index)


def _cells(result: ScopeResult) -> dict[str, dict[str, int]]:
    return dict(result.diagnostics.get("rows_per_cell", {}))


DIGITS: dict[Outcome, tuple[float, int, str]] = {
    "success": (100.0, 1, "%"),
    "time": (1.0, 2, "s"),
    "tlx": (1.0, 2, "points"),
}


_OUTCOMES = {"success": "success", "time": "completion time", "tlx": "workload"}


_LEVELS = {
    "operator": "operators",
    "operator:retargeter": "operators' preferences",
    "block": "blocks",
    "residual": "trials",
}


def scope_name(scope: str) -> str:
    """A scope as a reader knows it."""
    return "all tasks" if scope == POOLED else f"task {scope}"


def means_table(
    outcome: Outcome, result: ScopeResult, colors: Mapping[str, str], baseline: str
) -> Html:
    """Means with intervals, and each retargeter against the baseline."""
    scale, digits, unit = DIGITS[outcome]
    rows = []
    for name, mean in result.emm.items():
        cells = [
            name_cell(name, colors.get(name, ""), "baseline" if name == baseline else ""),
            escape(number(scale * mean.estimate, digits)),
            escape(number(scale * mean.se, digits)),
            escape(span(scale * mean.lower, scale * mean.upper, digits)),
        ]
        test = result.dunnett.get(name)
        if test is None:
            cells += [Html("")] * 4
        else:
            cells += [
                escape(signed(scale * test.difference, digits)),
                escape(span(scale * test.lower, scale * test.upper, digits, sign=True)),
                escape(p_text(test.p_dunnett)),
                escape(f"{test.effect_words} ({signed(test.effect)})"),
            ]
        rows.append(cells)
    for name, exact in result.separated.items():
        at = f"{'≥' if exact.rate else '≤'} {number(scale * exact.bound, digits)}"
        swapped = exact.against.get(baseline)
        p = None if swapped is None else swapped.p_dunnett
        rows.append(
            [
                name_cell(name, colors.get(name, ""), "not in the model"),
                escape(number(scale * exact.rate, digits)),
                escape("exact"),
                escape(at),
                escape(signed(scale * swapped.difference, digits) if swapped else ""),
                Html(""),
                escape("" if p is None else p_text(p)),
                Html(""),
            ]
        )
    headers = [
        Html("retargeter"),
        Html(f"mean<small>{unit}</small>"),
        Html("SE"),
        Html("95 % interval"),
        escape(f"against {baseline}"),
        Html("simultaneous 95 %"),
        Html("p<small>Dunnett</small>"),
        Html("effect"),
    ]
    return table(headers, rows)


def pairs_table(outcome: Outcome, result: ScopeResult) -> Html:
    """All pairs with Holm's correction."""
    scale, digits, _ = DIGITS[outcome]
    rows = [
        (
            f"{pair.a} − {pair.b}",
            signed(scale * pair.difference, digits),
            number(scale * pair.se, digits),
            number(pair.statistic),
            number(pair.df, 1),
            p_text(pair.p_raw),
            p_text(pair.p_holm),
            f"{pair.effect_words} ({signed(pair.effect)})",
        )
        for pair in result.pairs.values()
    ]
    headers = ("pair", "difference", "SE", "statistic", "df", "p raw", "p Holm", "effect")
    return text_table(headers, rows)


def coefficients_table(result: ScopeResult) -> Html:
    """Coefficients of the model."""
    names = term_names(result)
    rows = [
        (
            names[name],
            number(one.estimate, 4),
            number(one.se, 4),
            number(one.df, 1),
            p_text(one.p),
        )
        for name, one in result.coefficients.items()
    ]
    return text_table(("coefficient", "estimate", "SE", "df", "p"), rows)


def observed_table(outcome: Outcome, result: ScopeResult, colors: Mapping[str, str]) -> Html:
    """What was seen, without a model."""
    scale, digits, unit = DIGITS[outcome]
    rows = [
        [
            name_cell(name, colors.get(name, "")),
            escape(facts["n"]),
            escape(number(scale * facts["mean"], digits)),
            escape(number(scale * facts["median"], digits)),
        ]
        for name, facts in result.observed.items()
    ]
    return table(
        [Html("retargeter"), Html("rows"), Html(f"mean<small>{unit}</small>"), Html("median")], rows
    )


def learning_table(learning: Mapping[str, Any]) -> Html:
    """Slopes over trials by scope and index; p-values corrected over all of the table."""
    entries = [
        (scope, index, outcome, entry)
        for scope, indices in learning.items()
        for index, outcomes in indices.items()
        for outcome, entry in outcomes.items()
    ]
    raw = {i: _slope_p(entry) for i, (*_, entry) in enumerate(entries)}
    tested = {i: p for i, p in raw.items() if p is not None and not math.isnan(p)}
    adjusted = dict(zip(tested, holm(list(tested.values())), strict=True))
    rows = []
    for i, (scope, index, outcome, entry) in enumerate(entries):
        name = name_cell(f"{scope_name(scope)}: {_OUTCOMES[outcome]} {slope_name(index)}")
        if "refused" in entry:
            rows.append([name, failed_cell(entry["refused"], 4)])
            continue
        if "slope_logit" in entry:  # as percentage points: nobody thinks in logits
            slope = 100 * entry["ame_prob_per_unit"]
            # The error of mode small-sample, so that it goes with the p-value.
            wider = entry.get("se_mancl_derouen", entry["se"]) / entry["se"]
            se = 100 * entry["ame_se"] * wider
        else:
            slope, se = entry["slope"], entry.get("se_mancl_derouen", entry["se"])
        unit = {"success": "percentage points", "time": "s", "tlx": "points"}[outcome]
        rows.append(
            [
                name,
                escape(f"{signed(slope, 3)} {unit}"),
                escape(number(se, 3)),
                escape(p_text(raw[i])),
                escape(p_text(adjusted.get(i))),
            ]
        )
    headers = ["slope", "a step", "SE", "p raw", f"p Holm, {len(tested)} slopes"]
    return table([Html(header) for header in headers], rows)


def _slope_p(entry: Mapping[str, Any]) -> float | None:
    """p in mode small-sample."""
    for key in ("p_t", "p_satterthwaite"):
        if key in entry:
            return float(entry[key])
    return None


def correlation_table(spearman: Mapping[str, Any]) -> Html:
    """Correlations within operators and over the retargeters' means, with n."""
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
    if not rows:
        return Html("")
    headers = (
        "metric ~ outcome", "all points", "within operators", "p", f"p Holm, {len(rows)}",
        "over means of retargeters",
    )  # fmt: skip
    return text_table(headers, rows)


def warning_list(result: ScopeResult) -> Html:
    """What to know before believing a result."""
    return join(paragraph(with_minus(text), "warning") for text in result.warnings)


def model_facts(result: ScopeResult) -> Html:
    """Formula and variances in a line."""
    facts = dict(result.model)
    parts = [
        f"{facts.get('kind', '')}: {facts.get('formula', '')}",
        f"{result.n} rows, {result.operators} operators",
    ]
    variances = facts.get("variances", {})
    if variances:
        spreads = (
            f"{_LEVELS.get(name, name)} {number(math.sqrt(value))}"
            for name, value in variances.items()
        )
        parts.append(f"standard deviations: {', '.join(spreads)}")
    if "alpha" in facts:
        parts.append(f"working correlation {number(facts['alpha'], 3)}")
    return element("p", escape("; ".join(parts)), class_="soft")
