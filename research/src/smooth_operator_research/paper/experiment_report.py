"""Writes the files of experiments: ``results.json``, the figures and ``report.html``."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import write_json
from smooth_operator.io.documents import read_json
from smooth_operator.reporting.drawing import write_figure
from smooth_operator.reporting.report_page import (
    Html,
    element,
    escape,
    join,
    paragraph,
    write_report_page,
)
from smooth_operator_research.html_tables import details, name_cell, table, text_table
from smooth_operator_research.paper.experiment import (
    EXPERIMENTS,
    RESULTS,
    Experiment,
    ExperimentFolder,
    Outcome,
)
from smooth_operator_research.paper.verdicts import RULES

REPORT: Final = "report.html"

_MARKS: Final = {
    "held": "✓",
    "held in part": "≈",
    "mixed": "±",
    "not shown": "?",
    "did not hold": "✗",
}
_CLASSES: Final = {"held": "best", "did not hold": "worse"}
_STYLE: Final = """
figure img { display: block; width: 100%; height: auto; }
figure { background: #fff; color: #20262d; }
td.verdict { white-space: nowrap; }
"""


def write_outcome(
    store: ExperimentFolder, name: str, experiment: Experiment, outcome: Outcome, warning: str = ""
) -> Path:
    """Writes the outcome of an experiment.

    Returns:
        the path of ``results.json``, which is written last: if it exists, the figures do too.
    """
    folder = store.experiment_folder(name)
    for drawing in outcome.drawings:
        write_figure(drawing.figure, folder / drawing.name)
    content = {
        "experiment": name,
        "title": experiment.title,
        "claim": experiment.claim,
        "warning": warning,
        "setup": outcome.setup,
        "verdicts": outcome.verdicts,
        "tables": outcome.tables,
        "drawings": [{"name": d.name, "caption": d.caption} for d in outcome.drawings],
        "figures": outcome.figures,
        "environment": store.environment,
    }
    path = folder / RESULTS
    write_json(path, content, indent=1)
    return path


def write_report(store: ExperimentFolder) -> Path:
    """Writes one self-contained page of all experiments whose results are in the folder."""
    contents = {name: _read(store.folder / name / RESULTS) for name in EXPERIMENTS}
    results = {name: content for name, content in contents.items() if content}
    sections = [("Verdicts", "verdicts", _overview(results))]
    sections += [
        (content["title"], name, _section(content, store.folder / name))
        for name, content in results.items()
    ]
    return write_report_page(
        store.folder / REPORT,
        "The paper's experiments, re-run",
        element("h1", "The paper's experiments, re-run"),
        sections,
        "Made by smooth-operator. Numbers: NAME/results.json; figures as files.",
        styles=(_STYLE,),
    )


def _read(path: Path) -> dict[str, Any]:
    try:
        content = read_json(path)
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _overview(results: Mapping[str, Mapping[str, Any]]) -> Html:
    rows = [
        (
            name_cell(verdict["claim"], note=name),
            escape(verdict["paper"]),
            escape(verdict["ours"]),
            _verdict_cell("" if content.get("warning") else verdict["held"]),
        )
        for name, content in results.items()
        for verdict in content["verdicts"]
    ]
    headers = [escape(text) for text in ("claim", "paper", "here", "verdict")]
    warned = {
        name: content["warning"] for name, content in results.items() if content.get("warning")
    }
    warnings = [
        paragraph(f"{', '.join(own for own in warned if warned[own] == text)}: {text}", "warning")
        for text in dict.fromkeys(warned.values())
    ]
    return join([*warnings, table(headers, rows, class_="words"), paragraph(RULES, "soft")])


def _verdict_cell(held: str) -> Html:
    kind = f"verdict {_CLASSES.get(held, '')}".strip()
    return element("td", Html(f"{_MARKS.get(held, '')} {escape(held)}"), class_=kind)


def _section(content: Mapping[str, Any], folder: Path) -> Html:
    environment = content["environment"]
    parts = [paragraph(content["setup"], "soft")]
    for v in content["verdicts"]:
        held = "" if content.get("warning") else v["held"]
        verdict = f"Verdict: {escape(held)}. " if held else ""
        parts.append(
            Html(
                f"<p><b>{_MARKS.get(held, '')} {escape(v['claim'])}.</b> The paper: "
                f"{escape(v['paper'])}. Here: {escape(v['ours'])}. {verdict}"
                f"{escape(v.get('note', ''))}</p>"
            )
        )
    parts += [_picture(folder / f"{d['name']}.svg", d["caption"]) for d in content["drawings"]]
    for one in content["tables"]:
        shown = text_table(one["headers"], one["rows"])
        note = paragraph(one["note"], "soft") if one["note"] else Html("")
        inside = join([shown, note])
        if len(one["rows"]) > _LONG:
            parts.append(details(one["title"], inside))
        else:
            parts.append(Html(f"<h3>{escape(one['title'])}</h3>{inside}"))
    versions = ", ".join(f"{key} {value}" for key, value in environment["versions"].items())
    parts.append(
        paragraph(
            f"{environment['cpu']}, {environment['cpu_cores']} cores, {environment['device']}; "
            f"{versions}; {environment['created']}",
            "soft",
        )
    )
    return join(parts)


_LONG: Final = 12


def _picture(path: Path, caption: str) -> Html:
    """Figure as an embedded image, so that its names can't clash with another figure's."""
    try:
        content = base64.b64encode(path.read_bytes()).decode()
    except OSError:
        return paragraph(f"{path.name} is missing: run the experiment again.", "warning")
    image = f'<img src="data:image/svg+xml;base64,{content}" alt="{escape(caption)}">'
    return element("figure", Html(f"{image}{element('figcaption', escape(caption))}"))


def verdict_lines(outcomes: Sequence[tuple[str, Outcome]]) -> list[tuple[str, str, str, str, str]]:
    """Experiment, claim, paper's figure, our figure and verdict of each claim, for a text table."""
    return [
        (name, v.claim, v.paper, v.ours, f"{_MARKS[v.held]} {v.held}")
        for name, outcome in outcomes
        for v in outcome.verdicts
    ]
