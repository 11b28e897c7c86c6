"""Markdown tables of ``smooth-operator bench --physics``: a row for each hand, a column a method.

    python benchmarks/physics_tables.py FOLDER reachable tip_error_mm tip_p95_mm

For each condition and figure one table, from ``summary.csv``: the mean and half the width of its
95 % interval, or the share with both ends of its interval. The best of each row is bold.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional

from smooth_operator.reporting.run_report import markdown


def main(
    folder: Annotated[Path, Positional],
    measure: Annotated[str, Positional],
    figures: Annotated[tuple[str, ...], Positional],
) -> None:
    """Prints the tables.

    Args:
        folder: of the results.
        measure: name of the measure.
        figures: names of figures.
    """
    with (folder / "summary.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["measure"] == measure]
    content = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    (about,) = (one for one in content["measures"] if one["name"] == measure)
    facts = {figure["name"]: figure for figure in about["figures"]}
    for condition in dict.fromkeys(row["condition"] for row in rows):
        for figure in figures:
            own = [r for r in rows if (r["condition"], r["figure"]) == (condition, figure)]
            methods = list(dict.fromkeys(row["method"] for row in own))
            unit = f" [{facts[figure]['unit']}]" if facts[figure]["unit"] else ""
            where = f", {condition}" if condition else ""
            print(f"\n{facts[figure]['meaning'].rstrip('.')}{unit}{where}:\n")
            lines = []
            for hand in dict.fromkeys(row["hand"] for row in own):
                cells = {row["method"]: row for row in own if row["hand"] == hand}
                best = best_of(cells, facts[figure]["goal"])
                texts = [text_of(cells.get(method), facts[figure]) for method in methods]
                shown = [
                    f"**{text}**" if method == best else text
                    for method, text in zip(methods, texts, strict=True)
                ]
                lines.append([f"`{hand}`", *shown])
            print(markdown(["hand", *(f"`{method}`" for method in methods)], lines))


def best_of(cells: Mapping[str, Mapping[str, str]], goal: str) -> str | None:
    """The method with the best value."""
    known = {method: float(row["value"]) for method, row in cells.items() if row["value"]}
    if not goal or len(set(known.values())) < 2:
        return None
    if goal == "up":
        return max(known, key=known.__getitem__)
    return min(known, key=lambda method: abs(known[method]))


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


def number(text: object) -> str:
    value = f"{float(str(text)):.2g}"
    return (f"{float(value):.0f}" if "e+" in value else value).replace("-", "−")


if __name__ == "__main__":
    tyro.cli(main)
