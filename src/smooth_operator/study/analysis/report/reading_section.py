"""The section of further readings."""

from __future__ import annotations

from smooth_operator.reporting.html import Html, details, element, escape, join, paragraph
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.report import reading_tables as tables
from smooth_operator.study.analysis.report.report_tables import scope_name
from smooth_operator.study.analysis.results import OUTCOMES, POOLED, Outcome

_NAMES: dict[Outcome, str] = {"success": "Success", "time": "Completion time", "tlx": "Workload"}


def reading_section(analysis: Analysis, incidence: Html) -> Html:
    """All readings: sensitivity of what was found, and questions that the models leave open.

    Args:
        analysis: of the study.
        incidence: the figure of the time to success.
    """
    parts = [
        paragraph(
            "Sensitivity and secondary analyses, all exploratory unless the plan says otherwise. "
            "p-values are corrected within a table at most."
        ),
        _part(
            "Where success begins",
            "Success from a score of 0.5 on, as reported, and only from 1.",
            tables.by_scope(analysis, tables.score_table),
        ),
        _part(
            "Time, failures included",
            "Completion times know successes only. Here every trial counts: one that fails never "
            "succeeds, and counts with the limit. Intervals: bootstrap over operators.",
            join([incidence, tables.by_scope(analysis, tables.time_table)]),
        ),
        _part(
            "Equivalence",
            "Two one-sided tests at 5 %: alike if the 90 % interval lies within the margin that "
            "was planned. A margin found from the data is post hoc and shows nothing.",
            _equivalence(analysis),
        ),
        _part(
            "Does it depend on the task?",
            "One joint test of retargeter × task an outcome.",
            tables.interaction_table(analysis),
        ),
    ]
    if analysis.readings.preference is not None:
        said = "Operators' ranking at the end. Intervals: bootstrap over operators."
        parts.append(_part("Preference", said, tables.preference_table(analysis)))
    if analysis.readings.second_rater is not None:
        said = "Cohen's κ of two raters of the same trials."
        parts.append(_part("Second rater", said, tables.rater_table(analysis)))
    return join(parts)


def _equivalence(analysis: Analysis) -> Html:
    parts = []
    for outcome in OUTCOMES:
        if outcome == "tlx" and analysis.data.questionnaires is None:
            continue
        for scope in analysis.scopes:
            title = f"{_NAMES[outcome]}, {scope_name(scope)}"
            content = tables.equivalence_table(analysis, outcome, scope)
            parts.append(details(title, content, opened=scope == POOLED))
    return join(parts)


def _part(title: str, said: str, content: Html) -> Html:
    return join([element("h3", escape(title)), paragraph(said, "soft"), content])
