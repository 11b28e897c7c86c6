"""``smooth-operator bench``: compares methods on recordings, and prints tables of the results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from smooth_operator.atomic_files import claimed, write_json
from smooth_operator.calibration.operator_file import read_operator
from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for, stopped
from smooth_operator.errors import SmoothOperatorError, counted
from smooth_operator.formats.checks import reading_notes
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.stand_ins import stand_in_note
from smooth_operator.metrics import Metric
from smooth_operator.request import parse_fingers
from smooth_operator.retargeting.start import start_jax
from smooth_operator_benchmark import (
    Settings,
    compare,
    make_rows,
    plan_cells,
    read_results,
    run_suite,
)
from smooth_operator_benchmark.cells import Cell, only_side
from smooth_operator_benchmark.options import Bench
from smooth_operator_benchmark.ranking import (
    COLUMNS,
    Comparison,
    Line,
    best,
    by_hand,
    by_panel,
    columns,
    failures,
    footnotes,
    lines_of,
    overall,
    sample_text,
    shown_value,
)
from smooth_operator_benchmark.ranking import verdict as verdict_of
from smooth_operator_benchmark.suite import REPORT, RESULTS, Row

_MOST_PANELS: Final = 8
_MOST_NAMED: Final = 4
_WIDTH_OF_NAME, _WIDTH_OF_COLUMN, _FEWEST = 20, 11, 5
"""Approximate width of a method's name and of a column, and the number of columns that fit every
terminal.
"""
_ORDER: Final = (
    "finger_extension_error",
    "pinch_touch_share",
    "pinch_deep_share",
    "motion_preservation",
    "self_collision.share",
    "latency_ms.p50",
    "finger_direction_error_deg",
    "jumps_per_1000",
    "cosine_similarity",
    "thumb_direction_error_deg",
    "flatness",
    "scale_ratio",
    "workspace_utilisation",
)
"""Columns in the order in which a narrow terminal shows them; the report has all columns."""
_STYLES: Final = {"better": "green", "worse": "red", "same": ""}
_SIGNS: Final = {"better": " ▲", "worse": " ▼", "same": ""}


def print_results(rows: Sequence[Row]) -> None:
    """Prints the main metrics of each method, per recording and overall, and recommends methods."""
    console = output_console()
    shown = _columns(console)
    panels = by_panel(rows)
    if len(panels) <= _MOST_PANELS:
        for (recording, hand, side), own in panels.items():
            if all(row["status"] != "ok" for row in own):
                continue  # printed once, below the tables
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
        more = counted(hidden, "more column") if hidden else ""
        more = more and f"; the report and wider terminals also show {more}"
        console.print(f"* best{more}", style="dim")
    for footnote in footnotes(rows):
        console.print(Text(footnote), soft_wrap=True)
    for where, methods, reason in failures(rows):
        console.print(Text(f"failed: {where}, {methods}: {reason}"), soft_wrap=True)


def print_comparison(comparison: Comparison) -> None:
    """Prints how the main metrics of each cell differ from those of an earlier benchmark."""
    console = output_console()
    shown = _columns(console)
    table = _empty(f"this benchmark minus {comparison.name}", "cell", shown)
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
        f"over all metrics: {total['better']} better ▲, {total['worse']} worse ▼, {total['same']} "
        "the same (within 0.5 %, or 10 % for latencies)"
    )
    notes = sorted({note for cell in comparison.cells for note in cell.notes})
    if notes:
        console.print(Text(f"note: {'; '.join(notes)}"), soft_wrap=True)
    for title, keys in (("only here", comparison.only_here), ("only there", comparison.only_there)):
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


SOME_FAILED = 1
"""Exit status of a completed run in which some cells failed."""


def bench(options: Bench) -> None:
    """Checks the request, measures, writes the results and prints the tables."""
    progress = Progressing(options.quiet)
    start_jax()  # before planning, which may do so
    # Check everything that a user can get wrong before the long work starts.
    settings = Settings(
        output=options.output,
        recordings=options.recordings or ("synthetic",),
        hands=comma_words(options.hands),
        methods=comma_words(options.methods),
        frames=options.frames,
        rate=options.rate,
        layout=options.layout,
        side=options.side or only_side(comma_words(options.hands)),
        seed=options.seed,
        definition=options.definition,
        metrics=comma_words(options.metrics),
        latency_frames=0 if options.sheet else options.latency_frames,
        workers=options.workers,
        cluster=options.cluster,
        fingers=None if options.fingers is None else parse_fingers(options.fingers),
        operator=None if options.operator is None else read_operator(options.operator),
    )
    others = None if options.compare is None else read_results(options.compare)
    cells = plan_cells(settings)
    _say_what_is_odd(cells, progress)
    with folder_for(options.output), claimed(options.output):
        try:
            finished = run_suite(settings, cells, progress)
        except KeyboardInterrupt:
            raise stopped(options.output) from None
        rows = make_rows(finished, settings)
        comparison = None
        if others is not None:
            comparison = compare(rows, others, str(options.compare))
        write_json(options.output / RESULTS, rows, indent=1)
        written = [RESULTS]
        if options.sheet:
            from smooth_operator_benchmark.contact_sheet import write_sheets
            from smooth_operator_benchmark.model_shape import ModelShape

            with progress.waiting("drawing the hands"):
                written += [
                    path.name for path in write_sheets(finished, options.output, ModelShape)
                ]
        elif not options.no_report:
            from smooth_operator_benchmark.model_shape import ModelShape
            from smooth_operator_benchmark.page import write_report

            with progress.waiting("drawing the report"):
                write_report(finished, rows, settings, comparison, ModelShape)
            written.append(REPORT)
    if not options.quiet:
        print_results(rows)
        if comparison is not None:
            print_comparison(comparison)
        progress.note(f"wrote {options.output}: {' and '.join(written)}")
    failed = sum(row["status"] != "ok" for row in rows)
    if failed:
        where = "" if options.quiet else ", see above"
        progress.note(f"{failed} of {len(rows)} rows failed{where}", matters=True)
        raise SystemExit(SOME_FAILED)


def comma_words(text: str) -> tuple[str, ...]:
    """Splits a string at its commas."""
    return tuple(word for word in (part.strip() for part in text.split(",")) if word)


def _say_what_is_odd(cells: Sequence[Cell], progress: Progressing) -> None:
    for source in dict.fromkeys(cell.source for cell in cells):
        if source.error is not None:
            progress.note(f"skipped: {source.error}", matters=True)
        elif source.recording is not None:
            for note in reading_notes(source.recording, source.name):
                progress.note(note, matters=True)

    notes = set()
    for cell in cells:
        if cell.source.recording is None:
            continue
        try:
            hand = load_hand(cell.hand, cell.side, fingers=cell.fingers)
        except SmoothOperatorError:
            continue  # The cell's own line says so.
        notes |= {*cell.config.notes(hand), *filter(None, [stand_in_note(hand)])}
    for note in sorted(notes):
        progress.note(note, matters=True)
