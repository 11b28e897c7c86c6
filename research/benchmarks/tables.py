"""Markdown tables of research/docs/benchmarks.md, from the results of ``smooth-operator bench``.

    python research/benchmarks/tables.py bench FOLDER
    python research/benchmarks/tables.py bench FOLDER --columns "cos thumb" motion
    python research/benchmarks/tables.py physics FOLDER reachable tip_error_mm tip_p95_mm
    python research/benchmarks/tables.py physics FOLDER reachable "tip_error_mm@noise 0.5 mm"

``bench`` prints a table for each recording; with columns, one table whose cells have all
recordings, in the order of the results. ``physics`` prints a table for each condition and figure
from ``summary.csv``, a row for each hand, a column a method: the mean and half the width of its
95 % interval, or the share with both ends of its interval. The best of each row is bold. Figures
with a slash between them share the cells of one table: the first has its interval, and each is of
the first condition unless it names another.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import tyro
from tyro.conf import Positional

from smooth_operator.lab.benchmark import read_results
from smooth_operator.lab.benchmark.suite import Row, row_method
from smooth_operator_research.run_report import markdown

Part = tuple[str, str]
"""A figure and a condition."""

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


def bench(folder: Annotated[Path, Positional], columns: tuple[str, ...] = ()) -> None:
    """Prints methods side by side.

    Args:
        folder: folder of `smooth-operator bench`.
        columns: one table of these headings for all recordings.
    """
    if unknown := [name for name in columns if name not in COLUMNS]:
        raise SystemExit(f"no column {', '.join(unknown)}; there are {', '.join(COLUMNS)}")
    if columns:
        print_columns(folder, columns)
    else:
        print_tables(folder)


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


def physics(
    folder: Annotated[Path, Positional],
    measure: Annotated[str, Positional],
    figures: Annotated[tuple[str, ...], Positional],
    methods: tuple[str, ...] = (),
) -> None:
    """Prints what hands achieve.

    Args:
        folder: folder of `smooth-operator bench --physics`.
        measure: name of the measure.
        figures: names of figures, or ``FIGURE[@CONDITION]/FIGURE[@CONDITION]...`` for one table.
        methods: columns, all unless given.
    """
    with (folder / "summary.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["measure"] == measure]
    rows = [row for row in rows if not methods or row["method"] in methods]
    content = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    (about,) = (one for one in content["measures"] if one["name"] == measure)
    facts = {figure["name"]: figure for figure in about["figures"]}
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    tables: list[list[Part]] = [
        [(figure, condition)] for condition in conditions for figure in figures if "/" not in figure
    ]
    for joined in (figure.split("/") for figure in figures if "/" in figure):
        named = [part.partition("@") for part in joined]
        tables.append([(name, condition or conditions[0]) for name, _, condition in named])
    for parts in tables:
        print_table(rows, parts, facts)


def print_table(
    rows: Sequence[Mapping[str, str]], parts: Sequence[Part], facts: Mapping[str, Any]
) -> None:
    """One table: the first part with its interval, the others behind slashes."""
    by_cell = {
        (row["hand"], row["method"], row["figure"], row["condition"]): row
        for row in rows
        if (row["figure"], row["condition"]) in parts
    }
    hands, methods = (list(dict.fromkeys(key[i] for key in by_cell)) for i in (0, 1))
    print(f"\n{' / '.join(heading(part, facts[part[0]]) for part in parts)}:\n")
    lines = []
    for hand in hands:
        cells = {
            method: [by_cell.get((hand, method, *part)) for part in parts] for method in methods
        }
        first = {method: values[0] for method, values in cells.items() if values[0] is not None}
        best = best_of(first, facts[parts[0][0]]["goal"])
        texts = [
            " / ".join([text_of(one, facts[parts[0][0]]), *map(value_of, others)])
            for one, *others in cells.values()
        ]
        shown = [
            f"**{text}**" if method == best else text
            for method, text in zip(methods, texts, strict=True)
        ]
        lines.append([f"`{hand}`", *shown])
    print(markdown(["hand", *(f"`{method}`" for method in methods)], lines))


def heading(part: Part, figure: Mapping[str, Any]) -> str:
    """Meaning, unit and condition of a figure."""
    unit = f" [{figure['unit']}]" if figure["unit"] else ""
    return f"{figure['meaning'].rstrip('.')}{unit}{f', {part[1]}' if part[1] else ''}"


def best_of(cells: Mapping[str, Mapping[str, str]], goal: str) -> str | None:
    """The method with the best value."""
    numbers = {method: float(row["value"]) for method, row in cells.items() if row["value"]}
    if not goal or len(set(numbers.values())) < 2:
        return None
    if goal == "up":
        return max(numbers, key=numbers.__getitem__)
    return min(numbers, key=lambda method: abs(numbers[method]))


def text_of(row: Mapping[str, str] | None, figure: Mapping[str, object]) -> str:
    """A cell."""
    if row is None or not row["value"]:
        return "–"
    if not row["low"]:
        return number(row["value"])
    if figure["share"]:
        return f"{number(row['value'])} [{number(row['low'])}, {number(row['high'])}]"
    half = (float(row["high"]) - float(row["low"])) / 2
    return f"{number(row['value'])} ± {number(half)}"


def value_of(row: Mapping[str, str] | None) -> str:
    """A value without its interval."""
    return number(row["value"]) if row and row["value"] else "–"


def number(text: object) -> str:
    value = f"{float(str(text)):.2g}"
    return (f"{float(value):.0f}" if "e+" in value else value).replace("-", "−")


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"bench": bench, "physics": physics}, description=__doc__)
