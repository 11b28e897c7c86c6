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

RESULTS: Final = "results.json"
METHODS: Final = "methods.txt"
SCRIPT: Final = "analysis.R"
TRIALS: Final = "rows_trials.csv"
TLX: Final = "rows_tlx.csv"
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
}
"""Tables of a scope, and the column with the names of their rows."""


def write_analysis(analysis: Analysis, folder: Path, *, report: bool = True) -> list[str]:
    """Writes results, tables, methods, R script and report.

    Args:
        report: whether to draw figures and write the page, which takes longest.

    Returns:
        Names of the files, the results first.
    """
    with atomic_write(folder / RESULTS) as file:
        text = json.dumps(analysis.to_json(), indent=1, allow_nan=False, ensure_ascii=False)
        file.write(text.encode() + b"\n")
    text = methods_paragraph(analysis)
    works = "\n".join(f"[{c.key}] {c.reference}" for c in cited(text))
    with atomic_write(folder / METHODS) as file:
        file.write(f"{text}\n\n{works}\n".encode())
    written = [RESULTS, *write_tables(analysis, folder), METHODS]
    written += write_r_script(analysis, folder)
    if report:
        written.append(write_report(analysis, folder).name)
    return written


def write_tables(analysis: Analysis, folder: Path) -> list[str]:
    """Writes the CSV tables.

    Returns:
        Names of the files. A table without rows is not written; an older one is removed.
    """
    written = []
    for name, rows in _tables(analysis).items():
        path = folder / f"{name}.csv"
        if not rows:
            path.unlink(missing_ok=True)
            continue
        columns = list(dict.fromkeys(column for row in rows for column in row))
        with atomic_write(path) as file:
            file.write(csv_text(columns, rows).encode())
        written.append(path.name)
    return written


def _tables(analysis: Analysis) -> dict[str, list[dict[str, Any]]]:
    tables: dict[str, list[dict[str, Any]]] = {}
    for family, label in _FAMILIES.items():
        tables[family] = [
            {**where, label: name, **plain(entry)}
            for where, result in _scopes(analysis)
            for name, entry in getattr(result, family).items()
        ]
    tables["separated"] = [
        {**where, "retargeter": name, **plain(one)}
        for where, result in _scopes(analysis)
        for name, one in result.separated.items()
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


def _named(numbers: Mapping[str, float]) -> str:
    """Formats the elements of a named vector in R."""
    return ", ".join(f"{json.dumps(name)} = {value!r}" for name, value in numbers.items())


def write_r_script(analysis: Analysis, folder: Path) -> list[str]:
    """Writes ``analysis.R``, which fits the same models in R, and the rows that it reads.

    Args:
        folder: folder with the tables of the analysis.

    Returns:
        Names of the files. A table that the study does not have is not written; an older one is
        removed.
    """
    data, table = analysis.data, analysis.data.questionnaires
    texts = {
        SCRIPT: files("smooth_operator_study.analysis")
        .joinpath(SCRIPT)
        .read_text("utf-8")
        .replace("@BASELINE@", json.dumps(analysis.baseline))
        .replace("@MARGINS@", _named(data.plan.margins if data.plan else {})),
        TRIALS: csv_text(
            _TRIALS,
            plain(
                data.trials.assign(
                    success=data.trials.success.astype(int), time_s=data.trials.time
                ).to_dict("records")
            ),
        ),
        TLX: None if table is None else csv_text(_TLX, plain(table.to_dict("records"))),
    }
    for name, text in texts.items():
        if text is None:
            (folder / name).unlink(missing_ok=True)
            continue
        with atomic_write(folder / name) as file:
            file.write(text.encode("utf-8"))
    return [name for name, text in texts.items() if text is not None]


REPORT: Final = "report.html"
FOLDER: Final = "figures"
_SECTIONS: Final = (
    ("Success", "success", "success"),
    ("Time", "time", "time"),
    ("Workload", "workload", "workload"),
    ("Learning", "learning", "learning"),
    ("Further analyses", "readings", "readings"),
    ("Simulation", "simulation", "simulation"),
    ("Participants", "participants", "participants"),
    ("Checks", "checks", "checks"),
    ("Methods", "methods", "methods"),
    ("Appendix: as published", "published", "published"),
)
"""Title, anchor and macro of each section."""


def write_report(analysis: Analysis, folder: Path) -> Path:
    """Writes the page and its figures.

    Returns:
        The page. It needs no other file, and nothing from the network.
    """
    plots, colors = Plots(folder / FOLDER), colors_of(analysis.retargeters)

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
            "operators": len({str(name) for name in analysis.data.trials.operator}),
            "tables": tables,
            "text": text,
            "works": cited(text),
        }
    )
    return write_report_page(
        folder / REPORT,
        "User study",
        Html(str(macros.header())),  # type: ignore[attr-defined]
        [
            (title, anchor, Html(str(getattr(macros, macro)())))
            for title, anchor, macro in _SECTIONS
            if anchor != "simulation" or analysis.spearman
        ],
        "Made by smooth-operator study analyze. Numbers: results.json and the CSV tables; "
        "plots as files: figures/.",
    )
