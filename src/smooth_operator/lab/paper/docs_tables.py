r"""Writes the tables of docs/reference/paper.md from the results of `smooth-operator paper`.

Each table stands between a line `<!-- table: NAME -->` and a line `<!-- end -->`; what stands
between them is replaced. Without `--docs` the tables are printed. ``interval_coverage`` makes the
table of coverage.

    smooth-operator paper --output build/paper
    smooth-operator paper RECORDING ... --output build/paper-real
    python -m smooth_operator.lab.paper.docs_tables build/paper build/paper-real \
        --docs docs/reference/paper.md
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from smooth_operator.lab.paper import interval_coverage
from smooth_operator.lab.paper.experiment import Table
from smooth_operator.lab.paper.experiment_folder import RESULTS
from smooth_operator.lab.paper.experiment_report import markdown
from smooth_operator.lab.paper.registry import EXPERIMENTS

ORDER: Final = ("solver", "velocity", "hessian", "compute", "fk", "table", "noise", "rate")
"""Experiments as the page has them."""

Results = Mapping[str, Any]
"""``results.json`` of each experiment."""

BLOCK: Final = re.compile(r"<!-- table: ([\w-]+) -->\n(.*?)<!-- end -->", re.DOTALL)


@dataclass(frozen=True)
class Settings:
    """The tables of docs/reference/paper.md."""

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
    for found in results[experiment]["tables"]:
        if found["title"].startswith(title):
            kept = [found["headers"].index(name) for name in columns or found["headers"]]
            return Table(
                found["title"],
                [found["headers"][i] for i in kept],
                [[row[i] for i in kept] for row in found["rows"]],
            )
    raise KeyError(f"{experiment} has no table {title!r}")


def _quality(results: Results, title: str) -> Table:
    """The paper's table but for latency, which is of the machine and not of the recordings."""
    own = _table(results, "table", title)
    kept = [i for i, header in enumerate(own.headers) if not header.startswith("latency")]
    rows = [[row[i] for i in kept] for row in own.rows]
    late = [i for i, row in enumerate(rows) if row[0].startswith("latency")]
    rows = [row for i, row in enumerate(rows) if i not in late and i - 1 not in late]
    return Table(own.title, [own.headers[i] for i in kept], rows)


def _solvers(results: Results, title: str) -> Table:
    own = _table(results, "solver", title, ("solver", "tracking loss", "jitter [mrad]"))
    other = _table(results, "solver", "Relative to sampling", ("solver", "jitter"))
    relative = {row[0]: row[1] for row in other.rows}
    rows = [[*row, relative.get(row[0], "–")] for row in own.rows]
    return Table(own.title, [*own.headers, "jitter against sampling"], rows)


def _claims(built_in: Results, real: Results) -> Table:
    """Claim by claim, on both sets of recordings."""

    def cell(verdict: Mapping[str, str]) -> str:
        return f"{verdict['ours']}: **{verdict['held']}**"

    rows = []
    for name in ORDER:
        others = real.get(name, {}).get("verdicts", [])
        for i, verdict in enumerate(built_in.get(name, {}).get("verdicts", [])):
            if name == "fk" or verdict["claim"].startswith("latency"):
                continue  # times of a machine, which no recording makes others
            there = cell(others[i]) if i < len(others) else "–"
            rows.append([f"`{name}`: {verdict['claim']}", verdict["paper"], cell(verdict), there])
    return Table("Claims", ["claim", "paper", "built-in operators", "real recordings"], rows)


Make = Callable[[Results, Results], Table]

_CONTOURS: Final = ("N × L", "best between the ends", "against the widest", "against the deepest")
_NOISE: Final = ("method", "tracker", "jitter [mrad]", "flatness [mm²]", "motion")
_RATE: Final = ("method", "rate", "fingertips [m/s²]", "joints [rad/s²]", "lag [ms]", "motion")

TABLES: Final[dict[str, Make]] = {
    "claims": _claims,
    "solver": lambda a, _: _solvers(a, "Solvers on DexPilot's loss"),
    "solver-real": lambda _, b: _solvers(b, "Solvers on DexPilot's loss"),
    "velocity": lambda a, _: _table(a, "velocity", "What the velocity term does"),
    "velocity-real": lambda _, b: _table(b, "velocity", "What the velocity term does"),
    "hessian": lambda a, _: _table(a, "hessian", "Jitter by stiffness, without"),
    "hessian-real": lambda _, b: _table(b, "hessian", "Jitter by stiffness, without"),
    "compute": lambda a, _: _table(a, "compute", "Along contours", _CONTOURS),
    "compute-real": lambda _, b: _table(b, "compute", "Along contours", _CONTOURS),
    "fk": lambda a, _: _table(a, "fk", "Time a pose"),
    "table": lambda a, _: _quality(a, "The paper's table"),
    "table-real": lambda _, b: _quality(b, "The paper's table"),
    "table-sound": lambda a, _: _quality(a, "All methods, by the sound"),
    "noise": lambda a, _: _table(a, "noise", "Under noise", _NOISE),
    "losses": lambda a, _: _table(
        a, "noise", "With frames lost", (*_NOISE[:3], "largest step [rad]")
    ),
    "rate": lambda a, _: _table(a, "rate", "Methods by frame rate", _RATE),
    "coverage": lambda a, b: interval_coverage.coverage_table(interval_coverage.Settings()),
}
"""Name of a table in the page -> what makes it."""


def block(name: str, table: Table) -> str:
    """A table between its marks; its note is left out, for the page says it."""
    bare = Table(table.title, table.headers, table.rows)
    return f"<!-- table: {name} -->\n{markdown(bare)}\n<!-- end -->"


def replaced(text: str, name: str, made: str) -> str:
    """A page with one of its tables replaced."""
    return BLOCK.sub(lambda found: made if found[1] == name else found[0], text)


def main(settings: Settings) -> None:
    """Prints the tables, or replaces them in the page."""
    built_in, real = (read_results(folder) for folder in (settings.built_in, settings.real))
    text = "" if settings.docs is None else settings.docs.read_text(encoding="utf-8")
    names = settings.only or ([match[1] for match in BLOCK.finditer(text)] if text else TABLES)
    for name in names:
        made = block(name, TABLES[name](built_in, real))
        if settings.docs is None:
            print(made, end="\n\n")
        text = replaced(text, name, made)
    if settings.docs is not None:
        settings.docs.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))
