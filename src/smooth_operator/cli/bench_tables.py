"""Tables that ``smooth-operator bench`` prints: methods, the best marked, and differences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from smooth_operator.cli.console import output_console, plain_table
from smooth_operator.lab.benchmark.comparison import Comparison
from smooth_operator.lab.benchmark.ranking import (
    COLUMNS,
    Line,
    best,
    by_hand,
    by_panel,
    collision_footnotes,
    columns,
    failures,
    lines_of,
    overall,
    sample_text,
    shown_value,
)
from smooth_operator.lab.benchmark.ranking import verdict as verdict_of
from smooth_operator.lab.benchmark.results import Row
from smooth_operator.metrics import Metric

_MOST_PANELS: Final = 8
_MOST_NAMED: Final = 4
_WIDTH_OF_NAME, _WIDTH_OF_COLUMN, _FEWEST = 20, 11, 5
"""About the width of a method's name and of a column [characters]; columns of any terminal."""
_ORDER: Final = (
    "finger_extension_error", "pinch_gap_excess_mm", "motion_preservation", "self_collision.share",
    "latency_ms.p50", "finger_direction_error_deg", "jumps_per_1000", "cosine_similarity",
    "thumb_direction_error_deg", "flatness", "scale_ratio", "workspace_utilisation",
)  # fmt: skip
"""Columns that a narrow terminal shows first; the report has all."""
_STYLES: Final = {"better": "green", "worse": "red", "same": ""}
_SIGNS: Final = {"better": " ▲", "worse": " ▼", "same": ""}


def print_results(rows: Sequence[Row]) -> None:
    """The main metrics of each method, per recording and overall, and which method for what."""
    console = output_console()
    shown = _columns(console)
    panels = by_panel(rows)
    if len(panels) <= _MOST_PANELS:
        for (recording, hand, side), own in panels.items():
            if all(row["status"] != "ok" for row in own):
                continue  # said below, once
            console.print(_table(f"{recording} on {hand} {side}", lines_of(own), shown))
    for hand, own in by_hand(rows).items():
        count = len({row["recording"] for row in own if row["status"] == "ok"})
        lines = overall(own)
        if count > 1:
            console.print(_table(f"{hand}, mean over {sample_text(own)}", lines, shown))
        verdict = verdict_of(lines)
        if verdict:
            console.print(Text(f"{hand}: {verdict}"))
    if any(row["status"] == "ok" for row in rows):
        hidden = len(columns()) - len(shown)
        more = f"; {hidden} columns more in the report, or in a wider terminal" if hidden else ""
        console.print(f"* best{more}", style="dim")
    for footnote in collision_footnotes(rows):
        console.print(Text(footnote), soft_wrap=True)
    for where, methods, reason in failures(rows):
        console.print(Text(f"failed: {where}, {methods}: {reason}"), soft_wrap=True)


def print_comparison(comparison: Comparison) -> None:
    """Differences of the main metrics, cell by cell."""
    console = output_console()
    shown = _columns(console)
    table = _empty(f"this minus {comparison.name}", "cell", shown)
    for cell in comparison.cells:
        recording, hand, side, method, preset = cell.key
        values = []
        for metric in shown:
            change = cell.change(metric)
            if change is None:
                values.append(Text("–"))
            elif change.difference == 0:
                values.append(Text("="))
            else:
                text = f"{change.difference:+.2g}{_SIGNS[change.verdict]}"
                values.append(Text(text, _STYLES[change.verdict]))
        table.add_row(Text(f"{recording}\n{hand} {side} {method} {preset}"), *values)
    if comparison.cells:
        console.print(table)
    total = {verdict: comparison.count(verdict) for verdict in ("better", "worse", "same")}
    console.print(
        f"of all metrics: {total['better']} better ▲, {total['worse']} worse ▼, {total['same']} "
        "the same (within 0.5 %, latencies 10 %)"
    )
    notes = sorted({note for cell in comparison.cells for note in cell.notes})
    if notes:
        console.print(Text(f"mind: {'; '.join(notes)}"), soft_wrap=True)
    for title, keys in (
        ("only here", comparison.only_here),
        ("only there", comparison.only_there),
    ):
        named = "; ".join(" ".join(key) for key in keys[:_MOST_NAMED])
        more = f" and {len(keys) - _MOST_NAMED} more" if len(keys) > _MOST_NAMED else ""
        if keys:
            console.print(Text(f"{title}: {named}{more}"), soft_wrap=True)


def _table(title: str, lines: Sequence[Line], shown: Sequence[Metric]) -> Table:
    table = _empty(title, "method", shown)
    tops = [best(lines, metric) for metric in shown]
    for i, line in enumerate(lines):
        name = (
            line.method if line.count in (0, line.of) else f"{line.method} ({line.count}/{line.of})"
        )
        if line.failed is not None:
            table.add_row(
                Text(name), *(Text("failed" if k == 0 else "", "red") for k in range(len(shown)))
            )
            continue
        cells = []
        for metric, top in zip(shown, tops, strict=True):
            value = shown_value(metric, line.values[metric.name])
            cells.append(Text(f"{value}*", "bold green") if i in top else Text(f"{value} "))
        table.add_row(Text(name), *cells)
    return table


def _empty(title: str, first: str, shown: Sequence[Metric]) -> Table:
    table = plain_table(Text(title))
    table.add_column(first, no_wrap=first == "method", overflow="fold")
    for metric in shown:
        table.add_column(_header(metric), justify="right", no_wrap=True)
    return table


def _header(metric: Metric) -> str:
    return f"{metric.short}\n{' '.join(filter(None, (metric.unit, metric.sign)))}"


def _columns(console: Console) -> list[Metric]:
    room = max(_FEWEST, (console.width - _WIDTH_OF_NAME) // _WIDTH_OF_COLUMN)
    return [m for m in columns() if m not in COLUMNS or m.name in _ORDER[:room]]
