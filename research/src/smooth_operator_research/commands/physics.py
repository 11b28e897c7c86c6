"""``smooth-operator physics``: measures what the hand achieves in physics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from rich.table import Table
from rich.text import Text

from smooth_operator.atomic_files import claimed
from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for, stopped
from smooth_operator.retargeting.start import start_jax
from smooth_operator_benchmark.cells import only_side
from smooth_operator_benchmark.command import SOME_FAILED, comma_words
from smooth_operator_benchmark.suite import REPORT
from smooth_operator_research.commands.options import Physics
from smooth_operator_research.physics.measure import PhysicsSettings
from smooth_operator_research.physics.page import write_files, write_report
from smooth_operator_research.physics.results import Figure, Line, MeasureResults, table_rows
from smooth_operator_research.physics.suite import (
    MeasureOutcome,
    failed_rows,
    plan_cases,
    run_cases,
)

_SAME: Final = (
    "output",
    "recordings",
    "frames",
    "rate",
    "layout",
    "units",
    "quick",
    "seed",
    "workers",
    "cluster",
)
"""Options that are passed to the settings of the same name."""

_WIDTH_OF_INTERVALS: Final = 120
"""Smallest width of a terminal with room for the intervals [characters]."""


def physics(options: Physics) -> None:
    """Runs the measures, writes and prints the results."""
    progress = Progressing(options.quiet)
    start_jax()  # before planning, which may do so
    hands = comma_words(options.hands)
    settings = PhysicsSettings(
        measures=tuple(dict.fromkeys(options.measures)),
        hands=hands,
        methods=comma_words(options.methods),
        trackers=comma_words(options.trackers),
        side=options.side or only_side(hands) or "right",
        **{name: getattr(options, name) for name in _SAME},
    )
    planned = plan_cases(settings)
    with folder_for(options.output), claimed(options.output):
        try:
            outcomes = run_cases(
                settings,
                planned,
                progress,
            )
        except KeyboardInterrupt:
            raise stopped(options.output) from None
        written = [path.name for path in write_files(settings, outcomes)]
        if not options.no_report:
            with progress.waiting("drawing the report"):
                write_report(settings, outcomes)
            written.append(REPORT)
    if not options.quiet:
        print_outcomes(outcomes)
        progress.note(f"wrote {options.output}: {', '.join(written)}")
    failed = sum(1 for _ in failed_rows(outcomes))
    if failed:
        count = sum(len(outcome.results.rows) for outcome in outcomes)
        progress.note(f"{failed} of {count} cases failed", matters=True)
        raise SystemExit(SOME_FAILED)


def print_outcomes(outcomes: Sequence[MeasureOutcome]) -> None:
    """Prints a table for each measure, hand and condition, and marks the best value of each
    column."""
    console = output_console()
    wide = console.width >= _WIDTH_OF_INTERVALS
    for outcome in outcomes:
        measure, results = outcome.measure, outcome.results
        console.print(Text(f"{measure.title}: {measure.definition}"))
        figures = [figure for figure in measure.figures if figure.main]
        for panel in results.panels:
            hand, side, condition = panel
            title = f"{hand} {side}" + (f", {condition}" if condition else "")
            console.print(_table(title, results.lines(panel), figures, intervals=wide))
        console.print(_foot(results, measure.unit, intervals=wide), style="dim")
        for reason, count in _reasons(results).items():
            console.print(Text(f"failed ({count} cases): {reason}"), soft_wrap=True)


def _table(
    title: str, lines: Sequence[Line], figures: Sequence[Figure], *, intervals: bool
) -> Table:
    table = plain_table(Text(title))
    table.add_column("method", no_wrap=True)
    for figure in figures:
        below = " ".join(filter(None, (figure.unit, figure.sign)))
        table.add_column(f"{figure.heading}\n{below}", justify="right", no_wrap=True)
    for name, *cells in table_rows(lines, figures, intervals=intervals):
        table.add_row(Text(name), *(Text(c, "bold green" if "*" in c else "") for c in cells))
    return table


def _foot(results: MeasureResults, unit: str, *, intervals: bool) -> str:
    count = len({row["unit"] for row in results.rows})
    more = "" if intervals else "; the files, the report and a wider terminal show 95 % intervals"
    return f"* best; {count} {unit}{'s' if count != 1 else ''}{more}"


def _reasons(results: MeasureResults) -> dict[str, int]:
    reasons: dict[str, int] = {}
    for row in results.rows:
        if row["status"] != "ok":
            reasons[str(row["reason"])] = reasons.get(str(row["reason"]), 0) + 1
    return reasons
