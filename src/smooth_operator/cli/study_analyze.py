"""``smooth-operator study analyze``: reads, analyses, writes, prints both modes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for
from smooth_operator.cli.study_analyze_options import Analyze
from smooth_operator.errors import ConfigError, StudyError
from smooth_operator.study.analysis import Analysis, analyze_study
from smooth_operator.study.analysis.output import write_analysis
from smooth_operator.study.analysis.results import OUTCOMES, Mode, Outcome
from smooth_operator.study.data import read_study
from smooth_operator.study.data.reading import NAMES
from smooth_operator.study.data.workload_scores import with_workload

SOME_REFUSED: Final = 1
"""Exit status where everything was done, but some parts have a reason in place of figures."""

_STORE: Final = "study.db"
_SQLITE: Final = b"SQLite format 3\0"
_UNITS: Final[dict[Outcome, tuple[float, str]]] = {
    "success": (100.0, "success rate [%]"),
    "time": (1.0, "completion time [s]"),
    "tlx": (1.0, "{} TLX"),
}


def analyze_command(options: Analyze) -> None:
    """Analyses and prints.

    Raises:
        StudyError: the data can't be used; nothing is written then.
        OutputError: the folder can't be written to.
        SystemExit: with ``SOME_REFUSED``.
    """
    progress = Progressing(options.quiet)
    if not options.study:
        raise ConfigError("no data: give a folder, tables (.csv) or a JSON file")
    stored, files = _split(options.study)
    data = read_study(
        _with_metrics(files), texts=[(word, _exported(word, options.name)) for word in stored]
    )
    data = with_workload(data, options.workload)
    for note in data.notes:
        progress.note(f"note: {note}")
    with folder_for(options.output), progress.status() as tell:
        analysis = analyze_study(data, options.baseline, seed=options.seed, report=tell)
        tell("writing")
        written = write_analysis(analysis, options.output, report=not options.no_report)
    if options.json:
        print(json.dumps(analysis.to_json(), indent=1, allow_nan=False))
    elif not options.quiet:
        _print(analysis)
    progress.note(f"wrote {options.output}: {', '.join(written)}")
    if any(
        result.refused
        for outcomes in analysis.results.values()
        for scopes in outcomes.values()
        for result in scopes.values()
    ):
        raise SystemExit(SOME_REFUSED)


def _split(words: Sequence[str]) -> tuple[list[str], list[Path]]:
    """What is a store, and what are files."""
    stored, files = [], []
    for word in words:
        path = Path(word)
        held = path.is_dir() and (path / _STORE).is_file()
        if "://" in word or held or path.suffix == ".db" or _is_sqlite(path):
            stored.append(word)
        else:
            files.append(path)
    return stored, files


def _is_sqlite(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_SQLITE)) == _SQLITE


def _exported(target: str, name: str | None) -> str:
    """The data of a store, as ``study export`` writes them.

    Raises:
        StudyError: there is no such store.
    """
    from smooth_operator.study.store.export import study_json
    from smooth_operator.study.store.opening import open_study

    if "://" not in target and not Path(target).exists():  # opening would make one
        raise StudyError(f"no such file: {target!r}; give the folder of a study that was run")
    with open_study(target, name=name) as store:
        return json.dumps(study_json(store))


def _with_metrics(paths: Sequence[Path]) -> list[Path]:
    """The files, and the metrics in the folder of the trials under their usual name."""
    found = list(paths)
    if any(path.name == NAMES[2] for path in paths):
        return found
    for path in paths:
        beside = path.with_name(NAMES[2])
        if path.name == NAMES[0] and beside.is_file():
            found.append(beside)
    return found


def _print(analysis: Analysis) -> None:
    console = output_console()
    for outcome in OUTCOMES:
        for scope in analysis.scopes:
            _print_scope(console, analysis, outcome, scope)
    if analysis.spearman:
        table = _table(
            "Spearman's ρ: simulation against study", ("metric~outcome", "ρ", "95 %", "")
        )
        for pair, entry in analysis.spearman.items():
            if "refused" in entry:
                table.add_row(pair, "–", "", Text(entry["refused"]))
                continue
            low, high = (entry["ci_boot_operators"][end] for end in ("lcl", "ucl"))
            table.add_row(
                pair, f"{entry['rho']:+.3f}", f"{low:+.3f} to {high:+.3f}", entry["effect_words"]
            )
        console.print(table)


def _print_scope(console: Console, analysis: Analysis, outcome: Outcome, scope: str) -> None:
    scale, unit = _UNITS[outcome]
    small, paper = (analysis.results[mode][outcome][scope] for mode in _both())
    title = (
        f"{unit.format(analysis.workload)}, {scope}: {small.n} rows, {small.operators} operators"
    )
    if small.refused and paper.refused:
        console.print(Text(f"{title}: refused: {small.refused}\n", "yellow"), soft_wrap=True)
        return
    headers = ("retargeter", "mean", f"- {analysis.baseline}", "p Dunnett", "paper", "effect")
    table = _table(title, headers)
    names = (small.emm or paper.emm).keys()
    for name in names:
        mean = (small.emm or paper.emm)[name]
        test, other = small.dunnett.get(name), paper.dunnett.get(name)
        shown = test or other
        table.add_row(
            name,
            f"{scale * mean.estimate:.1f} ± {scale * mean.se:.1f}",
            f"{scale * shown.difference:+.2f}" if shown else "",
            _p(test.p_dunnett) if test else ("" if small.refused is None else "refused"),
            _p(other.p_dunnett) if other else "",
            shown.effect_words if shown else "",
        )
    console.print(table)
    pairs = _table("all pairs, p Holm", ("pair", "difference", "small-sample", "paper"))
    for key in small.pairs or paper.pairs:
        pair, other_pair = small.pairs.get(key), paper.pairs.get(key)
        known = pair or other_pair
        assert known is not None
        pairs.add_row(
            f"{known.a} - {known.b}",
            f"{scale * known.difference:+.2f}",
            _p(pair.p_holm) if pair else "refused",
            _p(other_pair.p_holm) if other_pair else "",
        )
    console.print(pairs)
    for text in dict.fromkeys((*small.warnings, *paper.warnings)):
        console.print(Text(f"  ! {text}", "yellow"), soft_wrap=True)
    console.print()


def _both() -> tuple[Mode, Mode]:
    return ("small-sample", "paper")


def _table(title: str, headers: Sequence[str]) -> Table:
    # as Text: "[s]" is a unit, and rich would take it for markup
    table = plain_table(Text(title))
    for i, header in enumerate(headers):
        table.add_column(header, no_wrap=True, justify="left" if i == 0 else "right")
    return table


def _p(p: float) -> str:
    return "<0.001" if p < 0.001 else f"{p:.3f}"
