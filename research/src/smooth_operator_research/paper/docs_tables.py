r"""Writes the tables of research/docs/paper.md from the results of `smooth-operator paper`.

Each table is between a line `<!-- table: NAME -->` and a line `<!-- end -->`; the text between
these lines is replaced. Without `--docs` the tables are printed.

    smooth-operator paper --output build/paper
    smooth-operator paper RECORDING ... --output build/paper-real
    python -m smooth_operator_research.paper.docs_tables build/paper build/paper-real \
        --docs research/docs/paper.md
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias

import tyro

from smooth_operator_research.paper import interval_coverage
from smooth_operator_research.paper.experiment import EXPERIMENTS, RESULTS, Table
from smooth_operator_research.run_report import markdown

ORDER: Final = ("solver", "velocity", "hessian", "compute", "fk", "table", "noise", "rate")
"""Experiments in the order of the page."""

Results: TypeAlias = Mapping[str, Any]
"""``results.json`` of each experiment."""

BLOCK: Final = re.compile(r"<!-- table: ([\w-]+) -->\n(.*?)<!-- end -->", re.DOTALL)


def read_results(folder: Path) -> dict[str, Any]:
    """Reads the experiments in a folder."""
    paths = {name: folder / name / RESULTS for name in EXPERIMENTS}
    return {name: json.loads(p.read_text("utf-8")) for name, p in paths.items() if p.exists()}


def _table(
    results: Results, experiment: str, title: str, columns: Sequence[str] = (), heading: str = "{}"
) -> Table:
    """Table of an experiment, or some of its columns, with other headings after the first."""
    own = next(t for t in results[experiment]["tables"] if t["title"].startswith(title))
    at = [own["headers"].index(name) for name in columns or own["headers"]]
    first, *others = (own["headers"][i] for i in at)
    headers = [first, *(heading.format(name) for name in others)]
    return Table(own["title"], headers, [[row[i] for i in at] for row in own["rows"]])


def _joined(first: Table, *others: Table) -> Table:
    """Joins tables by their rows; a dash marks a row that another table lacks."""
    rows = [list(row) for row in first.rows]
    for other in others:
        cells = {row[0]: row[1:] for row in other.rows}
        for row in rows:
            row.extend(cells.get(row[0], ["–"] * (len(other.headers) - 1)))
    headers = [*first.headers, *(name for other in others for name in other.headers[1:])]
    return Table(first.title, headers, rows)


def _by_condition(
    results: Results,
    experiment: str,
    title: str,
    figure: str,
    choose: Callable[[list[str]], Sequence[str]],
) -> Table:
    """Table of one figure: a row for each method, a column for each condition."""
    own = _table(results, experiment, title)
    at = own.headers.index(figure)
    return _joined(
        *(
            Table(
                own.title,
                [own.headers[0], f"{figure}, {condition}"],
                [[row[0], row[at]] for row in own.rows if row[1] == condition],
            )
            for condition in choose(list(dict.fromkeys(row[1] for row in own.rows)))
        )
    )


def _number(text: str) -> float:
    """Number at the start of a condition; 0 without one."""
    number = re.match(r"[\d.]+", text)
    return float(number[0]) if number else 0.0


def _noise(results: Results) -> Table:
    def near(conditions: list[str]) -> str:  # 1 mm
        return min(conditions[1:], key=lambda text: abs(_number(text) - 1.0))

    return _joined(
        _by_condition(results, "noise", "Under noise", "flatness [mm²]", lambda c: (c[0], near(c))),
        _by_condition(results, "noise", "Under noise", "motion", lambda c: (near(c),)),
        _by_condition(
            results,
            "noise",
            "With frames lost",
            "largest step [rad]",
            lambda c: (max(c, key=_number),),
        ),
    )


def _rate(results: Results) -> Table:
    title = "Methods by frame rate"
    return _joined(
        _by_condition(
            results,
            "rate",
            title,
            "fingertips [m/s²]",
            lambda c: (min(c, key=_number), max(c, key=_number)),
        ),
        _by_condition(results, "rate", title, "lag [ms]", lambda c: (min(c, key=_number),)),
    )


def _quality(results: Results) -> Table:
    """The paper's table, without the published values (the claims have them) and latency."""
    own = _table(results, "table", "The paper's table")
    rows = [row for row in own.rows if not row[0].startswith((" ", "latency"))]
    return Table(own.title, own.headers, rows)


def _velocity(built_in: Results, real: Results) -> Table:
    title, columns = "Effect of the velocity term", ("solver", "jitter without [mrad]")
    own = _table(built_in, "velocity", title, (*columns, "divided by"))
    recorded = _table(real, "velocity", title, (columns[0], "divided by"), "real: {}")
    return _joined(own, recorded)


def _solvers(built_in: Results, real: Results) -> Table:
    title, columns = "Relative to sampling", ("solver", "jitter")
    return _joined(
        _table(built_in, "solver", title, columns, "{} against sampling"),
        _table(real, "solver", title, columns, "real: the same"),
    )


def _claims(built_in: Results, real: Results) -> Table:
    """Table of the claims on both sets of recordings."""

    def cell(verdict: Mapping[str, str]) -> str:
        ours = verdict["ours"]
        if " > " in ours:  # an order, whose figures are in the table of the experiment
            ours = " > ".join(part.split()[0] for part in ours.split(" > "))
        return f"{ours}: **{verdict['held']}**"

    rows = []
    for name in ORDER:
        others = real.get(name, {}).get("verdicts", [])
        for i, verdict in enumerate(built_in.get(name, {}).get("verdicts", [])):
            if name == "fk" or verdict["claim"].startswith("latency"):
                continue  # times of a machine, which no recording makes others
            if verdict["paper"] in ("–", "no claim"):
                continue  # ours; the report has it
            there = cell(others[i]) if i < len(others) else "–"
            rows.append([f"`{name}`: {verdict['claim']}", verdict["paper"], cell(verdict), there])
    return Table("Claims", ["claim", "paper", "built-in operators", "real recordings"], rows)


_RANKS: Final = ("solver", "ranks 1–5, flat [mrad]", "ranks 12–16, stiff [mrad]")
_CONTOURS: Final = ("N × L", "against the widest", "against the deepest")
_SOUND: Final = ("method", "cosine similarity (→ 1)", "motion preservation (→ 1)")

TABLES: Final[dict[str, Callable[[Results, Results], Table]]] = {
    "claims": _claims,
    "solver": _solvers,
    "velocity": _velocity,
    "hessian": lambda a, _: _table(a, "hessian", "Jitter by stiffness, without", _RANKS),
    "compute": lambda a, _: _table(a, "compute", "Along contours", _CONTOURS),
    "fk": lambda a, _: _table(a, "fk", "Time a pose"),
    "table": lambda a, _: _quality(a),
    "table-real": lambda _, b: _quality(b),
    "table-sound": lambda a, _: _table(a, "table", "All methods, by the sound", _SOUND),
    "noise": lambda a, _: _noise(a),
    "rate": lambda a, _: _rate(a),
    "coverage": lambda a, b: interval_coverage.coverage_table(interval_coverage.Settings()),
}
"""Name of a table in the page -> function that makes it from the results on built-in operators and
on recordings of real trackers."""


def block(name: str, table: Table) -> str:
    """A table between its marks, without its note, which the page contains as text."""
    return f"<!-- table: {name} -->\n{markdown(table.headers, table.rows)}\n<!-- end -->"


def replaced(text: str, name: str, block: str) -> str:
    """Replaces one of the tables of a page."""
    return BLOCK.sub(lambda match: block if match[1] == name else match[0], text)


def main(
    built_in: Annotated[Path, tyro.conf.Positional],
    real: Annotated[Path, tyro.conf.Positional],
    docs: Path | None = None,
) -> None:
    """Prints the tables, or replaces them in the page.

    Args:
        built_in: folder of `paper` on the built-in operators.
        real: folder of `paper` on recordings of real trackers.
        docs: page whose tables are replaced; without it, the tables are printed.
    """
    results = read_results(built_in), read_results(real)
    text = "" if docs is None else docs.read_text(encoding="utf-8")
    for name in [match[1] for match in BLOCK.finditer(text)] if text else TABLES:
        content = block(name, TABLES[name](*results))
        if docs is None:
            print(content, end="\n\n")
        text = replaced(text, name, content)
    if docs is not None:
        docs.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
