r"""Writes the tables of research/docs/paper.md from the results of `smooth-operator paper`.

Each table stands between a line `<!-- table: NAME -->` and a line `<!-- end -->`; what stands
between them is replaced. Without `--docs` the tables are printed. ``interval_coverage`` makes the
table of coverage.

    smooth-operator paper --output build/paper
    smooth-operator paper RECORDING ... --output build/paper-real
    python -m smooth_operator_research.paper.docs_tables build/paper build/paper-real \
        --docs research/docs/paper.md
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from smooth_operator_research.paper import interval_coverage
from smooth_operator_research.paper.experiment import RESULTS, Table
from smooth_operator_research.paper.experiment_report import markdown
from smooth_operator_research.paper.registry import EXPERIMENTS

ORDER: Final = ("solver", "velocity", "hessian", "compute", "fk", "table", "noise", "rate")
"""Experiments as the page has them."""

Results = Mapping[str, Any]
"""``results.json`` of each experiment."""

Make = Callable[[Results, Results], Table]
"""Makes a table from the results on the built-in operators and on real recordings."""

Groups = Sequence[tuple[str, Callable[[Sequence[str]], Sequence[str]]]]
"""Figures, and what chooses the conditions that each is given for."""

BLOCK: Final = re.compile(r"<!-- table: ([\w-]+) -->\n(.*?)<!-- end -->", re.DOTALL)


@dataclass(frozen=True)
class Settings:
    """The tables of research/docs/paper.md."""

    built_in: Annotated[Path, tyro.conf.Positional]
    """Folder of `paper` on the built-in operators."""

    real: Annotated[Path, tyro.conf.Positional]
    """Folder of `paper` on recordings of real trackers."""

    docs: Path | None = None
    """Page whose tables are replaced; they are printed if left out."""

    only: tuple[str, ...] = ()
    """Only these tables."""


def read_results(folder: Path) -> dict[str, Any]:
    """The experiments that are in a folder."""
    paths = {name: folder / name / RESULTS for name in EXPERIMENTS}
    return {
        name: json.loads(path.read_text(encoding="utf-8"))
        for name, path in paths.items()
        if path.exists()
    }


def _table(results: Results, experiment: str, title: str, columns: Sequence[str] = ()) -> Table:
    """One of an experiment's tables, or some columns of it."""
    for table in results[experiment]["tables"]:
        if table["title"].startswith(title):
            indices = [table["headers"].index(name) for name in columns or table["headers"]]
            return Table(
                table["title"],
                [table["headers"][i] for i in indices],
                [[row[i] for i in indices] for row in table["rows"]],
            )
    raise KeyError(f"{experiment} has no table {title!r}")


def _joined(first: Table, *others: Table) -> Table:
    """Tables with the same rows as one; a dash where another table lacks a row."""
    rows = [list(row) for row in first.rows]
    for other in others:
        cells = {row[0]: row[1:] for row in other.rows}
        for row in rows:
            row.extend(cells.get(row[0], ["–"] * (len(other.headers) - 1)))
    headers = [*first.headers, *(name for other in others for name in other.headers[1:])]
    return Table(first.title, headers, rows)


def _headed(table: Table, heading: str) -> Table:
    """With a heading, ``{}`` in it is the former one, for each column but the first."""
    headers = [table.headers[0], *(heading.format(name) for name in table.headers[1:])]
    return Table(table.title, headers, table.rows)


def _wide(results: Results, experiment: str, title: str, groups: Groups) -> Table:
    """A row for each method, a column for each figure under each condition.

    Args:
        results: of a folder.
        experiment: whose table has a row for each method and condition.
        title: of the table.
        groups: figures, and the conditions that each is given for.
    """
    tables: list[Table] = []
    for figure, choose in groups:
        own = _table(results, experiment, title)
        where = own.headers.index(figure)
        for condition in choose(list(dict.fromkeys(row[1] for row in own.rows))):
            rows = [[row[0], row[where]] for row in own.rows if row[1] == condition]
            tables.append(Table(own.title, [own.headers[0], f"{figure}, {condition}"], rows))
    return _joined(*tables)


def _number(text: str) -> float:
    """The figure at the start of a condition; 0 where it has none."""
    number = re.match(r"[\d.]+", text)
    return float(number[0]) if number else 0.0


def _nearest_mm(conditions: Sequence[str]) -> Sequence[str]:
    """No noise, and the noise nearest to 1 mm."""
    return conditions[0], min(conditions[1:], key=lambda text: abs(_number(text) - 1.0))


def _least(conditions: Sequence[str]) -> Sequence[str]:
    """The smallest figure."""
    return (min(conditions, key=_number),)


def _most(conditions: Sequence[str]) -> Sequence[str]:
    """The largest figure."""
    return (max(conditions, key=_number),)


def _extremes(conditions: Sequence[str]) -> Sequence[str]:
    """The smallest and the largest figure."""
    return *_least(conditions), *_most(conditions)


def _quality(results: Results) -> Table:
    """The paper's table without its own figures, which the claims have, and without latency."""
    own = _table(results, "table", "The paper's table")
    rows = [row for row in own.rows if not row[0].startswith((" ", "latency"))]
    return Table(own.title, own.headers, rows)


def _velocity(built_in: Results, real: Results) -> Table:
    title, divided = "What the velocity term does", ("solver", "divided by")
    own = _table(built_in, "velocity", title, ("solver", "jitter without [mrad]", divided[1]))
    return _joined(own, _headed(_table(real, "velocity", title, divided), "real: {}"))


def _noise(results: Results) -> Table:
    noise = [("flatness [mm²]", _nearest_mm), ("motion", lambda found: _nearest_mm(found)[1:])]
    return _joined(
        _wide(results, "noise", "Under noise", noise),
        _wide(results, "noise", "With frames lost", [("largest step [rad]", _most)]),
    )


def _solvers(built_in: Results, real: Results) -> Table:
    own, recorded = (
        _table(results, "solver", "Relative to sampling", ("solver", "jitter"))
        for results in (built_in, real)
    )
    return _joined(_headed(own, "{} against sampling"), _headed(recorded, "real: the same"))


def _claims(built_in: Results, real: Results) -> Table:
    """Claim by claim, on both sets of recordings."""

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
_RATE: Final = (("fingertips [m/s²]", _extremes), ("lag [ms]", _least))

TABLES: Final[dict[str, Make]] = {
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
    "rate": lambda a, _: _wide(a, "rate", "Methods by frame rate", _RATE),
    "coverage": lambda a, b: interval_coverage.coverage_table(interval_coverage.Settings()),
}
"""Name of a table in the page -> what makes it."""


def block(name: str, table: Table) -> str:
    """A table between its marks; its note is left out, for the page says it."""
    bare = Table(table.title, table.headers, table.rows)
    return f"<!-- table: {name} -->\n{markdown(bare)}\n<!-- end -->"


def replaced(text: str, name: str, block: str) -> str:
    """A page with one of its tables replaced."""
    return BLOCK.sub(lambda match: block if match[1] == name else match[0], text)


def main(settings: Settings) -> None:
    """Prints the tables, or replaces them in the page."""
    built_in, real = (read_results(folder) for folder in (settings.built_in, settings.real))
    text = "" if settings.docs is None else settings.docs.read_text(encoding="utf-8")
    names = settings.only or ([match[1] for match in BLOCK.finditer(text)] if text else TABLES)
    for name in names:
        content = block(name, TABLES[name](built_in, real))
        if settings.docs is None:
            print(content, end="\n\n")
        text = replaced(text, name, content)
    if settings.docs is not None:
        settings.docs.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))
