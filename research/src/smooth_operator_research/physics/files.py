"""The files of ``bench --physics``: rows as CSV for a spreadsheet, everything as JSON."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import atomic_write, write_json
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.formats.environment import environment
from smooth_operator.planning import PROGRAM
from smooth_operator_research.physics.measure import PhysicsSettings
from smooth_operator_research.physics.suite import COMMAND, MeasureOutcome

RESULTS: Final = "results.json"
SUMMARY: Final = "summary.csv"
DIFFERENCES: Final = "differences.csv"


def write_files(settings: PhysicsSettings, outcomes: Sequence[MeasureOutcome]) -> list[Path]:
    """Writes ``MEASURE.csv`` (a row a case), ``summary.csv`` (a row for each measure, hand, method,
    condition and figure, with its interval), ``differences.csv`` (the same of each pair of methods,
    unit by unit) and ``results.json`` (all of it).

    Returns:
        The files.

    Raises:
        OutputError: one can't be written.
    """
    paths = []
    for outcome in outcomes:
        paths.append(settings.output / f"{outcome.measure.name}.csv")
        _write_csv(paths[-1], outcome.results.rows)
    summary = [line for outcome in outcomes for line in summary_rows(outcome)]
    paths.append(settings.output / SUMMARY)
    _write_csv(paths[-1], summary)
    differences = [line for outcome in outcomes for line in difference_rows(outcome)]
    paths.append(settings.output / DIFFERENCES)
    _write_csv(paths[-1], differences)
    content = {
        "program": PROGRAM,
        "command": COMMAND,
        "settings": settings,
        **environment(),
        "measures": [
            {
                "name": outcome.measure.name,
                "definition": outcome.measure.definition,
                "unit": outcome.measure.unit,
                "figures": [_facts(figure) for figure in outcome.measure.figures],
                "summary": summary_rows(outcome),
                "rows": outcome.results.rows,
            }
            for outcome in outcomes
        ],
    }
    paths.append(settings.output / RESULTS)
    write_json(paths[-1], content, indent=1)
    return paths


def summary_rows(outcome: MeasureOutcome) -> list[dict[str, Any]]:
    """Each figure of each method on each hand in each condition, with its 95 % interval."""
    return [
        {
            "measure": outcome.measure.name,
            "hand": panel[0],
            "side": panel[1],
            "condition": panel[2],
            "method": line.method,
            "figure": figure.name,
            "unit": figure.unit,
            **dataclasses.asdict(line.summaries[figure.name]),
        }
        for panel in outcome.results.panels
        for line in outcome.results.lines(panel)
        for figure in outcome.measure.figures
    ]


def difference_rows(outcome: MeasureOutcome) -> list[dict[str, Any]]:
    """Each figure of each method less that of each method after it, unit by unit."""
    results = outcome.results
    return [
        {
            "measure": outcome.measure.name,
            "hand": panel[0],
            "side": panel[1],
            "condition": panel[2],
            "method": method,
            "less": against,
            "figure": figure,
            **dataclasses.asdict(summary),
        }
        for panel in results.panels
        for k, against in enumerate(results.methods)
        for method, own in results.differences(panel, against).items()
        if results.methods.index(method) < k
        for figure, summary in own.items()
    ]


def _facts(figure: Any) -> dict[str, Any]:
    return {name: getattr(figure, name) for name in ("name", "unit", "goal", "meaning", "share")}


def _write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with atomic_write(path) as file:
        file.write(csv_text(columns, rows).encode())
