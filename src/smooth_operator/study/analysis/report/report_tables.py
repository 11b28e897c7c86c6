"""Tables of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

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
from smooth_operator.study.analysis.results import Outcome, ScopeResult

DIGITS: dict[Outcome, tuple[float, int, str]] = {
    "success": (100.0, 1, "%"),
    "time": (1.0, 2, "s"),
    "tlx": (1.0, 2, "points"),
}


def p_text(p: float) -> str:
    """A p-value as it is printed."""
    if math.isnan(p):
        return "–"
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def means_table(
    outcome: Outcome, result: ScopeResult, colors: Mapping[str, str], baseline: str
) -> Html:
    """Means with intervals, and each retargeter against the baseline."""
    scale, digits, unit = DIGITS[outcome]
    rows = []
    for name, mean in result.emm.items():
        cells = [
            name_cell(name, colors.get(name, ""), "baseline" if name == baseline else ""),
            escape(f"{scale * mean.estimate:.{digits}f}"),
            escape(f"{scale * mean.se:.{digits}f}"),
            escape(f"{scale * mean.lower:.{digits}f} to {scale * mean.upper:.{digits}f}"),
        ]
        test = result.dunnett.get(name)
        if test is None:
            cells += [Html("")] * 4
        else:
            cells += [
                escape(f"{scale * test.difference:+.{digits}f}"),
                escape(f"{scale * test.lower:+.{digits}f} to {scale * test.upper:+.{digits}f}"),
                escape(p_text(test.p_dunnett)),
                escape(f"{test.effect_words} ({test.effect:+.2f})"),
            ]
        rows.append(cells)
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
            f"{scale * pair.difference:+.{digits}f}",
            f"{scale * pair.se:.{digits}f}",
            f"{pair.statistic:.2f}",
            "∞" if pair.df == float("inf") else f"{pair.df:.1f}",
            p_text(pair.p_raw),
            p_text(pair.p_holm),
            f"{pair.effect_words} ({pair.effect:+.2f})",
        )
        for pair in result.pairs.values()
    ]
    headers = ("pair", "difference", "SE", "statistic", "df", "p raw", "p Holm", "effect")
    return text_table(headers, rows)


def coefficients_table(result: ScopeResult) -> Html:
    """Coefficients of the model."""
    rows = [
        (
            name,
            f"{one.estimate:.4f}",
            f"{one.se:.4f}",
            "∞" if one.df == float("inf") else f"{one.df:.1f}",
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
            escape(f"{scale * facts['mean']:.{digits}f}"),
            escape(f"{scale * facts['median']:.{digits}f}"),
        ]
        for name, facts in result.observed.items()
    ]
    return table(
        [Html("retargeter"), Html("rows"), Html(f"mean<small>{unit}</small>"), Html("median")], rows
    )


def learning_table(learning: Mapping[str, Any]) -> Html:
    """Slopes over trials by scope and index."""
    rows = []
    for scope, indices in learning.items():
        for index, outcomes in indices.items():
            for outcome, entry in outcomes.items():
                name = name_cell(f"{scope}: {outcome} over {index}")
                if "refused" in entry:
                    rows.append([name, failed_cell(entry["refused"], 4)])
                    continue
                slope = entry.get("slope", entry.get("slope_logit"))
                small = entry.get("p_satterthwaite", entry.get("p_t", float("nan")))
                unit = (
                    "logit" if "slope_logit" in entry else ("s" if outcome == "time" else "points")
                )
                rows.append(
                    [
                        name,
                        escape(f"{slope:+.4f} {unit}"),
                        escape(f"{entry.get('se_mancl_derouen', entry['se']):.4f}"),
                        escape(p_text(small)),
                        escape(p_text(entry["p_z"])),
                    ]
                )
    headers = ["slope", "a step", "SE", "p small-sample", "p paper"]
    return table([Html(header) for header in headers], rows)


def warning_list(result: ScopeResult) -> Html:
    """What to know before believing a result."""
    return join(paragraph(text, "warning") for text in result.warnings)


def model_facts(result: ScopeResult) -> Html:
    """Formula and variances in a line."""
    facts = dict(result.model)
    said = [
        f"{facts.get('kind', '')}: {facts.get('formula', '')}",
        f"{result.n} rows, {result.operators} operators",
    ]
    if "sd_operator" in facts:
        said.append(
            f"standard deviation of operators {facts['sd_operator']:.3g}, of trials "
            f"{facts['sd_residual']:.3g}"
        )
    if "alpha" in facts:
        said.append(f"working correlation {facts['alpha']:.3f}")
    return element("p", escape("; ".join(said)), class_="soft")
