"""Writes the folder of an analysis: ``results.json``, CSV tables, methods text, R script,
report."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import atomic_write
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.reporting.drawing import colors_of, styled
from smooth_operator.reporting.report_page import Html, Plots, templates, write_report_page
from smooth_operator_study.analysis.analyze import Analysis
from smooth_operator_study.analysis.methods_text import cited, methods_paragraph
from smooth_operator_study.analysis.operators import flow_rows, operator_means
from smooth_operator_study.analysis.readings import reading_rows
from smooth_operator_study.analysis.report import tables
from smooth_operator_study.analysis.report.figures import FIGURES
from smooth_operator_study.analysis.report.tables import NAMES, conclusion
from smooth_operator_study.analysis.results import ScopeResult, plain

_TRIALS: Final = (
    "operator",
    "task",
    "retargeter",
    "block",
    "trial_in_block",
    "trial_global",
    "score",
    "success",
    "time_s",
)
_TLX: Final = ("operator", "task", "retargeter", "block", "point", "index", "workload")
_FAMILIES: Final = {
    "coefficients": "name",
    "emm": "retargeter",
    "dunnett": "retargeter",
    "pairs": "pair",
    "separated": "retargeter",
}
"""Tables of a scope, and the column with the names of their rows."""


def write_analysis(analysis: Analysis, folder: Path, *, report: bool = True) -> list[str]:
    """Writes results, tables, methods, R script and report.

    Args:
        report: whether to draw figures and write the page, which takes longest.

    Returns:
        Names of the files, the results first. A table without rows is not written; an older one is
        removed.
    """
    results = json.dumps(analysis.to_json(), indent=1, allow_nan=False, ensure_ascii=False)
    methods = methods_paragraph(analysis)
    works = "\n".join(f"[{c.key}] {c.reference}" for c in cited(methods))
    texts = {
        "results.json": f"{results}\n",
        **{f"{name}.csv": _csv(rows) for name, rows in _tables(analysis).items()},
        "methods.txt": f"{methods}\n\n{works}\n",
        **_r_texts(analysis),
    }
    for name, text in texts.items():
        if text is None:
            (folder / name).unlink(missing_ok=True)
            continue
        with atomic_write(folder / name) as file:
            file.write(text.encode())
    written = [name for name, text in texts.items() if text is not None]
    return [*written, write_report(analysis, folder).name] if report else written


def _csv(rows: list[dict[str, Any]]) -> str | None:
    columns = list(dict.fromkeys(column for row in rows for column in row))
    return csv_text(columns, rows) if rows else None


def _tables(analysis: Analysis) -> dict[str, list[dict[str, Any]]]:
    tables: dict[str, list[dict[str, Any]]] = {}
    for family, label in _FAMILIES.items():
        tables[family] = [
            {**where, label: name, **plain(entry)}
            for where, result in _scopes(analysis)
            for name, entry in getattr(result, family).items()
        ]
    tables["warnings"] = [
        {**where, "warning": text}
        for where, result in _scopes(analysis)
        for text in result.warnings
    ]
    tables["learning"] = [
        {"scope": scope, "index": index, "outcome": outcome, "retargeter": "all", **_flat(entry)}
        for scope, indices in analysis.learning.items()
        for index, outcomes in indices.items()
        for outcome, entry in outcomes.items()
    ]
    tables["spearman"] = [
        {"metric": pair.split("~")[0], "outcome": pair.split("~")[1], **_flat(entry)}
        for pair, entry in analysis.spearman.items()
    ]
    tables["readings"] = reading_rows(analysis.readings)
    tables["flow"] = flow_rows(analysis.data.flow)
    tables["operators"] = operator_means(analysis.data).to_dict("records")
    return tables


def _scopes(analysis: Analysis) -> Iterator[tuple[dict[str, str], ScopeResult]]:
    for mode, outcomes in analysis.results.items():
        for outcome, scopes in outcomes.items():
            for scope, result in scopes.items():
                yield {"mode": mode, "outcome": outcome, "scope": scope}, result


def _flat(entry: Mapping[str, Any]) -> dict[str, Any]:
    row = {}
    for key, value in plain(entry).items():
        if key == "per_retargeter":
            continue
        if isinstance(value, Mapping):
            row.update({f"{key}_{inner}": number for inner, number in value.items()})
        else:
            row[key] = value
    return row


def _r_texts(analysis: Analysis) -> dict[str, str | None]:
    """``analysis.R``, which fits the same models in R, and the rows that it reads."""
    data, table = analysis.data, analysis.data.questionnaires
    margins = (data.plan.margins if data.plan else {}).items()
    named = ", ".join(f"{json.dumps(name)} = {value!r}" for name, value in margins)
    script = files("smooth_operator_study.analysis").joinpath("analysis.R").read_text("utf-8")
    script = script.replace("@BASELINE@", json.dumps(analysis.baseline))
    trials = data.trials.assign(success=data.trials.success.astype(int), time_s=data.trials.time)
    return {
        "analysis.R": script.replace("@MARGINS@", named),
        "rows_trials.csv": csv_text(_TRIALS, plain(trials.to_dict("records"))),
        "rows_tlx.csv": None if table is None else csv_text(_TLX, plain(table.to_dict("records"))),
    }


_SECTIONS: Final = {
    "success": "Success",
    "time": "Time",
    "workload": "Workload",
    "learning": "Learning",
    "readings": "Further analyses",
    "simulation": "Simulation",
    "participants": "Participants",
    "checks": "Checks",
    "methods": "Methods",
    "published": "Appendix: as published",
}
"""Macro of each section, which is also its anchor, and its title."""


def write_report(analysis: Analysis, folder: Path) -> Path:
    """Writes the page and its figures.

    Returns:
        The page. It needs no other file, and nothing from the network.
    """
    plots, colors = Plots(folder / "figures"), colors_of(analysis.retargeters)

    def figure(stem: str, caption: str) -> Html:
        with styled():
            drawn = FIGURES[stem](analysis, colors)
        return plots.element(drawn, stem, caption)

    text = methods_paragraph(analysis)
    template = templates(f"{__package__}.report").get_template("sections.html.j2")
    macros = template.make_module(
        {
            "analysis": analysis,
            "colors": colors,
            "conclusion": conclusion(analysis),
            "figure": figure,
            "flow": analysis.data.flow,
            "names": NAMES,
            "operators": len(analysis.data.flow.analysed),
            "tables": tables,
            "text": text,
            "works": cited(text),
        }
    )
    return write_report_page(
        folder / "report.html",
        "User study",
        Html(str(macros.header())),  # type: ignore[attr-defined]
        [
            (title, name, Html(str(getattr(macros, name)())))
            for name, title in _SECTIONS.items()
            if name != "simulation" or analysis.spearman
        ],
        "Made by smooth-operator study analyze. Numbers: results.json and the CSV tables; "
        "plots as files: figures/.",
    )
