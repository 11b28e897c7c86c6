"""Methods side by side: the tables of research/docs/benchmarks.md.

    smooth-operator bench RECORDING ... --methods all,sbr:paper,dexpilot:published --output FOLDER
    python research/benchmarks/side_by_side.py FOLDER
    python research/benchmarks/side_by_side.py FOLDER --columns "cos thumb" motion

The first prints a table for each recording from the results of ``smooth-operator bench``; with
columns, one table whose cells have all recordings, in the order of the results.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from smooth_operator.lab.benchmark import read_results
from smooth_operator.lab.benchmark.results import Row, row_method
from smooth_operator_research.run_report import markdown

COLUMNS: Final[dict[str, Callable[[dict[str, Any]], str]]] = {
    "cos thumb": lambda m: _places(m["cosine_similarity"], 4),
    "cos all": lambda m: _places(m["cosine_similarity_all"], 4),
    "scale": lambda m: _places(m["scale_ratio"], 3),
    "motion": lambda m: _places(m["motion_preservation"], 3),
    "flatness [m²]": lambda m: f"{m['flatness']:.2e}",
    "workspace": lambda m: f"{100 * m['workspace_utilisation']:.1f}%",
    "pinch [mm]": lambda m: _places(m["pinch_error_mm"], 1),
    "vel. corr.": lambda m: _places(m["velocity_correlation"], 3),
    "lag [ms]": lambda m: _places(m["lag_ms"], 0),
    "collision": lambda m: f"{100 * m['self_collision']['share']:.0f}%",
    "frozen": lambda m: f"{100 * m['frozen_share']:.0f}%",
}
"""Heading -> text from the metrics of a row."""


def _places(value: float | None, places: int) -> str:
    return "–" if value is None else f"{value:.{places}f}"


def print_tables(folder: Path) -> None:
    """A table for each recording, in the order of the results."""
    tables: dict[tuple[str, str], list[Row]] = {}
    for row in read_results(folder):
        frames = (row.get("source") or {}).get("frames")
        tables.setdefault((row["recording"], str(frames)), []).append(row)
    for (recording, frames), rows in tables.items():
        measured = [row for row in rows if row["metrics"] is not None]
        lines = [
            [f"`{row_method(row)}`", *(text(row["metrics"]) for text in COLUMNS.values())]
            for row in measured
        ]
        rate = measured[0]["metrics"]["rate_hz"] if measured else None
        print(f"\n**{recording}, frames {frames}** ({_places(rate, 0)} Hz)\n")
        print(markdown(["method", *COLUMNS], lines))
        for row in rows:
            if row["metrics"] is None:
                print(f"\n{row_method(row)}: {row['reason']}")


def print_columns(folder: Path, columns: Sequence[str]) -> None:
    """One table: a row for each method, the figures of the recordings with slashes between them."""
    metrics: dict[tuple[str, str], dict[str, Any] | None] = {}
    for row in read_results(folder):
        frames = (row.get("source") or {}).get("frames")
        metrics[row_method(row), f"{row['recording']}, frames {frames}"] = row["metrics"]
    methods, recordings = (list(dict.fromkeys(key[i] for key in metrics)) for i in (0, 1))
    print(f"\n{' / '.join(recordings)}\n")
    lines = [
        [f"`{method}`", *(_joined(metrics, method, recordings, name) for name in columns)]
        for method in methods
    ]
    print(markdown(["method", *columns], lines))


def _joined(
    metrics: Mapping[tuple[str, str], dict[str, Any] | None],
    method: str,
    recordings: Sequence[str],
    column: str,
) -> str:
    rows = [metrics.get((method, recording)) for recording in recordings]
    return " / ".join("–" if one is None else COLUMNS[column](one) for one in rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Reads the command line and prints."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("results", type=Path, help="folder of `smooth-operator bench`")
    parser.add_argument(
        "--columns",
        nargs="+",
        choices=COLUMNS,
        metavar="COLUMN",
        help=f"one table of these for all recordings: {', '.join(COLUMNS)}",
    )
    options = parser.parse_args(arguments)
    if options.columns:
        print_columns(options.results, options.columns)
    else:
        print_tables(options.results)


if __name__ == "__main__":
    main()
