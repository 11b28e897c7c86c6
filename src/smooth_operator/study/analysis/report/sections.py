"""Sections of the report on participants and on further readings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from smooth_operator.reporting.html import (
    Html,
    details,
    join,
    paragraph,
)
from smooth_operator.reporting.html import text_table as _table
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.readings import WaldTest
from smooth_operator.study.analysis.report.tables import (
    DIGITS,
    number,
    p_text,
    scope_name,
    signed,
    span,
    with_minus,
)
from smooth_operator.study.analysis.resampling import Drawn
from smooth_operator.study.analysis.results import MODES, POOLED, Outcome, Refused
from smooth_operator.study.analysis.time_to_success import TimeToSuccess

_NAMES: dict[Outcome, str] = {"success": "Success", "time": "Completion time", "tlx": "Workload"}


_OUTCOMES: Mapping[Outcome, str] = {
    "success": "success [%]", "time": "time [s]", "tlx": "workload [points]",
}  # fmt: skip


def by_scope(analysis: Analysis, write: Any) -> Html:
    """The same for all scopes, all tasks together open."""
    return join(
        details(scope_name(scope), write(analysis, scope), opened=scope == POOLED)
        for scope in analysis.scopes
    )


def score_table(analysis: Analysis, scope: str) -> Html:
    """Success at both cuts of the score."""
    full = analysis.readings.full_success[scope]
    rows = []
    for name in analysis.retargeters:
        row = [name]
        for result in (analysis.results[MODES[0]]["success"][scope], full):
            mean, test = result.emm.get(name), result.dunnett.get(name)
            row.append(number(100 * mean.estimate, 1) if mean else "–")
            row.append(_difference(test, 100.0, 1) if test else "")
        rows.append(row)
    against = f"against {analysis.baseline}"
    headers = ("retargeter", "score ≥ 0.5 [%]", against, "score = 1 [%]", against)
    refused = with_minus(f"Score = 1: {full.refused}") if full.refused else ""
    return join([_table(headers, rows), paragraph(refused, "warning") if refused else Html("")])


def time_table(analysis: Analysis, scope: str) -> Html:
    """Time with failures."""
    reading = analysis.readings.time_to_success[scope]
    if isinstance(reading, Refused):
        return paragraph(reading.refused, "warning")
    against = f"against {analysis.baseline}"
    columns: list[tuple[str, Mapping[str, Drawn], float, bool]] = [
        ("restricted mean time [s]", reading.restricted_mean, 1.0, False),
        (against, reading.difference, 1.0, True),
        ("succeeded by 30 s [%]", reading.by_30_s, 100.0, False),
        (against, reading.by_30_s_difference, 100.0, True),
        ("by the limit [%]", reading.by_limit, 100.0, False),
    ]
    if reading.if_gone_on:
        header = f"{against}, had the given up gone on [s]"
        columns.append((header, reading.if_gone_on_difference, 1.0, True))
    rows = [
        [
            name,
            *(
                _drawn(figures.get(name), 1, scale, sign=sign)
                for _, figures, scale, sign in columns
            ),
        ]
        for name in analysis.retargeters
    ]
    headers = ("retargeter", *(header for header, *_ in columns))
    return join([_table(headers, rows), paragraph(_limits(reading), "soft")])


def _limits(reading: TimeToSuccess) -> str:
    limits = ", ".join(f"{task} {number(value, 0)} s" for task, value in reading.limits.items())
    source = "of the plan" if reading.planned else "the longest time of the task, no limit planned"
    left = (
        f"; {reading.left_out} success(es) without a time are left out" if reading.left_out else ""
    )
    return f"Limits ({source}): {limits}; {reading.operators} operators drawn 2,000 times{left}."


def equivalence_table(analysis: Analysis, outcome: Outcome, scope: str) -> Html:
    """Two one-sided tests of every pair."""
    tests = analysis.readings.equivalence[outcome][scope]
    if not tests:
        return paragraph("The model is refused.", "warning")
    scale, digits, unit = DIGITS[outcome]
    rows = []
    for one in tests.values():
        if one.margin is None:
            verdict = f"± {number(scale * one.smallest_margin, digits)} {unit}, post hoc"
        else:
            verdict = "equivalent" if one.equivalent else "not shown"
        rows.append(
            [
                f"{one.a} − {one.b}",
                signed(scale * one.difference, digits),
                span(scale * one.lower, scale * one.upper, digits, sign=True),
                "–" if one.margin is None else f"± {number(scale * one.margin, digits)} {unit}",
                p_text(one.p),
                p_text(one.p_holm),
                verdict,
            ]
        )
    last = "smallest margin" if next(iter(tests.values())).margin is None else "within the margin"
    headers = ("pair", f"difference [{unit}]", "90 % interval", "margin", "p", "p Holm", last)
    return _table(headers, rows)


def interaction_table(analysis: Analysis) -> Html:
    """Retargeter x task."""
    rows = [
        [_OUTCOMES[outcome], test.refused if isinstance(test, Refused) else _wald(test.test)]
        for outcome, test in analysis.readings.interaction.items()
    ]
    return _table(("outcome", "retargeter × task"), rows)


def rater_table(analysis: Analysis) -> Html:
    """Agreement of two raters."""
    agreement = analysis.readings.second_rater
    if agreement is None or isinstance(agreement, Refused):
        return paragraph(agreement.refused, "warning") if agreement else Html("")
    rows = [
        ["weighted κ", _drawn(agreement.kappa, 2)],
        ["κ of equal scores", _drawn(agreement.kappa_unweighted, 2)],
        ["κ of success", _drawn(agreement.kappa_success, 2)],
        ["equal scores", f"{number(100 * agreement.agreed, 1)} % of {agreement.n} trials"],
    ]
    counts = [[score, *map(str, row.values())] for score, row in agreement.table.items()]
    return join(
        [
            _table(("measure", f"[95 %, {agreement.operators} operators drawn]"), rows),
            _table(("first rater, second:", *agreement.table), counts),
        ]
    )


def preference_table(analysis: Analysis) -> Html:
    """Final rankings."""
    preference = analysis.readings.preference
    if preference is None or isinstance(preference, Refused):
        return paragraph(preference.refused, "warning") if preference else Html("")
    rows = [
        [name, _drawn(preference.mean_rank[name], 2), _drawn(preference.strength[name], 2)]
        for name in sorted(preference.mean_rank, key=lambda one: preference.mean_rank[one].estimate)
    ]
    note = (
        f"Friedman's χ² = {number(preference.friedman)}, p {_equals(preference.p)} (permutation), "
        f"Kendall's W = {number(preference.kendall_w)}; {preference.operators} operators"
        + (
            f", {preference.left_out} without a whole ranking left out."
            if preference.left_out
            else "."
        )
    )
    headers = ("retargeter", "mean rank (1 is best)", "Bradley–Terry strength")
    return join([_table(headers, rows), paragraph(note, "soft")])


def _difference(test: Any, scale: float, digits: int) -> str:
    low, high = scale * test.lower, scale * test.upper
    return (
        f"{signed(scale * test.difference, digits)} [{span(low, high, digits, sign=True)}], "
        f"{p_text(test.p_dunnett)}"
    )


def _drawn(one: Drawn | None, digits: int, scale: float = 1.0, *, sign: bool = False) -> str:
    if one is None:
        return ""
    shown = signed if sign else number
    return (
        f"{shown(scale * one.estimate, digits)} "
        f"[{span(scale * one.lower, scale * one.upper, digits, sign=sign)}]"
    )


def _wald(test: WaldTest) -> str:
    return (
        f"F({number(test.df1, 0)}, {number(test.df2, 1)}) = {number(test.f)}, p {_equals(test.p)}"
    )


def _equals(p: float) -> str:
    text = p_text(p)
    return text if text.startswith("<") else f"= {text}"
