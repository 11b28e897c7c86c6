"""Files of ``bench --physics``: CSV, JSON, and ``report.html`` with tables, plots and clips."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from smooth_operator.atomic_files import atomic_write, write_json
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.formats.environment import environment
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.planning import PROGRAM
from smooth_operator.reporting.drawing import colors_of, styled
from smooth_operator.reporting.report_page import (
    SORTING,
    Html,
    Plots,
    element,
    escape,
    join,
    paragraph,
    write_report_page,
)
from smooth_operator.reporting.run_plots import Panel, Run, robot_landmarks
from smooth_operator.types import as_side
from smooth_operator_benchmark.figures import make_clip
from smooth_operator_benchmark.suite import PLOTS, REPORT
from smooth_operator_research.html_tables import (
    facts_table,
    header,
    name_cell,
    player,
    table,
    text_table,
)
from smooth_operator_research.physics.measure import Clip, Drawing, PhysicsSettings
from smooth_operator_research.physics.results import Figure, Line, MeasureResults, table_rows
from smooth_operator_research.physics.suite import COMMAND, MeasureOutcome, failed_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROW: Final = 0.24  # of a method [inch]
_FACTS: Final = ("name", "unit", "goal", "meaning", "share")


def interval_drawings(
    name: str, results: MeasureResults, figures: Sequence[Figure], colors: Mapping[str, str]
) -> list[Drawing]:
    """Makes a plot for each condition, with a panel for each figure and a row for each hand and
    method.

    Args:
        name: name of the measure, with which the file names begin.
        results: all rows.
        colors: method -> colour.
    """
    conditions = list(dict.fromkeys(condition for _, _, condition in results.panels))
    drawings = []
    for condition in conditions:
        panels = [panel for panel in results.panels if panel[2] == condition]
        words = f" ({condition})" if condition else ""
        caption = (
            f"{', '.join(figure.heading for figure in figures)}{words}: dots are means or shares, "
            "bars their 95 % intervals, small dots the independent units."
        )
        stem = "-".join(filter(None, (name, condition.replace(" ", "-"))))
        drawings.append(Drawing(stem, caption, _plot(panels, results, figures, colors)))
    return drawings


def _plot(
    panels: Sequence[tuple[str, str, str]],
    results: MeasureResults,
    figures: Sequence[Figure],
    colors: Mapping[str, str],
) -> Any:
    from matplotlib.figure import Figure as Plot

    rows = sum(len(results.lines(panel)) + 1 for panel in panels)
    size = (2.6 * len(figures) + 1.6, _ROW * rows + 1.0)
    plot = Plot(figsize=size, layout="constrained")
    axes = plot.subplots(1, len(figures), sharey=True, squeeze=False)[0]
    names: list[tuple[float, str]] = []
    at = 0.0
    for panel in panels:
        hand, side, _ = panel
        names.append((at, f"{hand} {side}"))
        at += 1
        for line in results.lines(panel):
            names.append((at, line.method))
            for ax, figure in zip(axes, figures, strict=True):
                _mark(ax, at, line.summaries[figure.name], colors[line.method])
                if not figure.share:
                    own = [
                        r[figure.name]
                        for r in results.of(panel, line.method)
                        if r.get(figure.name) is not None
                    ]
                    ax.plot(
                        own,
                        [at] * len(own),
                        ".",
                        color=colors[line.method],
                        alpha=0.35,
                        markersize=3,
                    )
            at += 1
    for ax, figure in zip(axes, figures, strict=True):
        ax.set_title(" ".join(filter(None, (figure.heading, figure.sign))))
        ax.set_xlabel(figure.unit or ("share" if figure.share else ""))
        ax.set_xlim(left=min(0.0, ax.get_xlim()[0]))
    axes[0].set_yticks([y for y, _ in names], [text for _, text in names])
    axes[0].set_ylim(at - 0.5, -0.7)
    return plot


def _mark(ax: Axes, at: float, summary: Any, color: str) -> None:
    if summary.value is None:
        return
    if summary.low is not None and summary.high is not None:
        ax.plot([summary.low, summary.high], [at, at], color=color, linewidth=2, alpha=0.6)
    ax.plot(summary.value, at, "o", color=color, markersize=5)


def write_report(settings: PhysicsSettings, outcomes: Sequence[MeasureOutcome]) -> Path:
    """Writes the page and its plots into the folder of the results.

    Returns:
        The page. It needs no other file, and nothing from the network.
    """
    plots = Plots(settings.output / PLOTS)
    colors = colors_of(method for outcome in outcomes for method in outcome.results.methods)
    hands = sum(len(shown) + 1 for outcome in outcomes for shown in outcome.clips.values())
    sections = [
        (o.measure.title, o.measure.name, _section(o, plots, colors, hands)) for o in outcomes
    ]
    failed = list(failed_rows(outcomes))
    if failed:
        columns = ("measure", "hand", "method", "condition", "unit", "reason")
        body = text_table(columns, [[row[name] or "" for name in columns] for row in failed])
        sections.append(("Failures", "failures", body))
    settings_table = {
        "measures": ", ".join(outcome.measure.name for outcome in outcomes),
        "hands": ", ".join(settings.hands),
        "methods": ", ".join(settings.methods),
        "seed": settings.seed,
        "quick": settings.quick,
    }
    environs = join([facts_table(settings_table), facts_table(environment())])
    sections.append(("Environment", "environment", environs))
    count = sum(len(outcome.results.rows) for outcome in outcomes)
    summary = f"{count} cases" + (f", {len(failed)} of them failed" if failed else "")
    here = files("smooth_operator_benchmark.page")
    return write_report_page(
        settings.output / REPORT,
        "What the hand achieves",
        join([element("h1", "What the hand achieves"), paragraph(summary, "soft")]),
        sections,
        f"Made by smooth-operator {COMMAND}. Figures: results.json, summary.csv and a CSV for each "
        "measure; plots as files: plots/.",
        styles=(here / "player.css",),
        scripts=(here / "player.js", SORTING),
        without_scripts=".player { display: none; }",
    )


def _section(outcome: MeasureOutcome, plots: Plots, colors: Mapping[str, str], hands: int) -> Html:
    measure, results = outcome.measure, outcome.results
    count = len({row["unit"] for row in results.rows})
    summary = (
        f"Figures are means or shares over {count} independent {measure.unit}"
        f"{'s' if count != 1 else ''}, with 95 % intervals: Student's t for means, Wilson's for "
        f"shares; * is the best. Differences of methods: differences.csv. The definition in full: "
        f"research/{measure.page}."
    )
    parts = [paragraph(measure.definition), paragraph(summary, "soft")]
    for panel in results.panels:
        hand, side, condition = panel
        title = f"{hand} {side}" + (f", {condition}" if condition else "")
        inside = [_table(outcome, results.lines(panel), colors)]
        clips = outcome.clips.get(panel, {})
        if clips:
            inside.append(player(make_clip(_panel(panel, clips), colors, hands)))
        parts.append(Html(f"<h3>{escape(title)}</h3>{join(inside)}"))
    with styled():
        drawings = measure.draw(results, colors)
    parts += [plots.element(d.plot, d.name, d.caption) for d in drawings]
    return join(parts)


def _table(outcome: MeasureOutcome, lines: Sequence[Line], colors: Mapping[str, str]) -> Html:
    """Table with a row for each method; the best value of each column has a star."""
    figures = outcome.measure.figures
    rows = [
        [name_cell(name, colors[name], "; ".join(line.failed)), *map(escape, cells)]
        for line, (name, *cells) in zip(lines, table_rows(lines, figures), strict=True)
    ]
    return table([Html("method"), *(header(figure) for figure in figures)], rows, "sortable")


def _panel(key: tuple[str, str, str], clips: Mapping[str, Clip]) -> Panel:
    """Clips of several methods on one clock; a clip that ends earlier stays at its last frame."""
    name, side, condition = key
    hand = load_hand(name, as_side(side))
    stamps = max((clip.stamps for clip in clips.values()), key=lambda own: float(own[-1]))
    runs = tuple(_run(method, clip, hand, stamps) for method, clip in clips.items())
    edges = next((tuple(clip.edges) for clip in clips.values() if clip.edges), ())
    return Panel((condition, name, side), hand, stamps - stamps[0], runs, edges)


def _run(method: str, clip: Clip, hand: Hand, stamps: np.ndarray) -> Run:
    at = np.searchsorted(clip.stamps, stamps).clip(0, len(clip.stamps) - 1)
    joints = clip.joints[at]
    objects = None if clip.objects is None else clip.objects[at]
    return Run(method, clip.human[at], robot_landmarks(hand, joints), joints, objects)


RESULTS: Final = "results.json"
SUMMARY: Final = "summary.csv"
DIFFERENCES: Final = "differences.csv"


def write_files(settings: PhysicsSettings, outcomes: Sequence[MeasureOutcome]) -> list[Path]:
    """Writes ``MEASURE.csv`` (one row per case), ``summary.csv`` (a row for each measure, hand,
    method, condition and figure, with its interval), ``differences.csv`` (the same for each pair
    of methods, unit by unit) and ``results.json`` (everything).

    Returns:
        The files.
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
                "figures": [
                    {name: getattr(figure, name) for name in _FACTS}
                    for figure in outcome.measure.figures
                ],
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
            **_where(outcome, panel),
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
    """Differences of each figure between each method and each method after it, unit by unit."""
    results = outcome.results
    return [
        {
            **_where(outcome, panel),
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


def _where(outcome: MeasureOutcome, panel: Sequence[str]) -> dict[str, str]:
    names = ("measure", "hand", "side", "condition")
    return dict(zip(names, (outcome.measure.name, *panel), strict=True))


def _write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with atomic_write(path) as file:
        file.write(csv_text(columns, rows).encode())
