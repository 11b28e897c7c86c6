"""``smooth-operator study analyze``: analyses a study, writes the results, prints both modes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for
from smooth_operator.cli.study_options import Analyze
from smooth_operator.errors import ConfigError, StudyError
from smooth_operator.study.analysis import Analysis, analyze_study
from smooth_operator.study.analysis.operators import flow_text, leave_out
from smooth_operator.study.analysis.output import write_analysis
from smooth_operator.study.analysis.results import OUTCOMES, Mode, Outcome, ScopeResult
from smooth_operator.study.data import read_study
from smooth_operator.study.data.reading import NAMES

SOME_REFUSED: Final = 1
"""Exit status if some parts of the analysis were refused with a reason."""
_STORE: Final = "study.db"
_SQLITE: Final = b"SQLite format 3\0"
_UNITS: Final[dict[Outcome, tuple[float, str]]] = {
    "success": (100.0, "success rate [%]"),
    "time": (1.0, "completion time [s]"),
    "tlx": (1.0, "raw TLX"),
}


def analyze_command(options: Analyze) -> None:
    """Analyses a study, writes the results and prints the tables.

    Raises:
        StudyError: the data can't be used; nothing is written then.
        OutputError: the folder can't be written to.
        SystemExit: a part was refused; the status is ``SOME_REFUSED``.
    """
    progress = Progressing(options.quiet)
    if not options.study:
        raise ConfigError("no data: give a folder, tables (.csv) or a JSON file")
    stored, files = _split(options.study)
    exports = {word: _exported(word) for word in stored}
    data = read_study(_with_metrics(files, stored), exports=exports)
    data = leave_out(data, _exclusions(options.exclude))
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
    for note in analysis.data.notes[len(data.notes) :]:
        progress.note(f"note: {note}")
    progress.note(f"wrote {options.output}: {', '.join(written)}")
    if any(
        result.refused
        for outcomes in analysis.results.values()
        for scopes in outcomes.values()
        for result in scopes.values()
    ):
        progress.note("exit status 1: some parts were not tested; the tables give the reasons")
        raise SystemExit(SOME_REFUSED)


def _exclusions(words: Sequence[str]) -> dict[str, str]:
    """Reads the reason of each excluded operator."""
    reasons: dict[str, str] = {}
    for word in words:
        operator, sign, reason = word.partition("=")
        if not sign or not operator.strip() or not reason.strip():
            raise ConfigError(
                f'--exclude {word}: expected OPERATOR=REASON, as in P03="an author"; the reason '
                "is reported"
            )
        if reasons.setdefault(operator.strip(), reason.strip()) != reason.strip():
            raise ConfigError(f"--exclude names {operator.strip()} twice, with two reasons")
    return reasons


def _split(words: Sequence[str]) -> tuple[list[str], list[Path]]:
    """Splits the arguments into stores and other files."""
    stored, files = [], []
    for word in words:
        path = Path(word)
        held = path.is_dir() and (path / _STORE).is_file()
        if held or path.suffix == ".db" or _is_sqlite(path):
            stored.append(word)
        else:
            files.append(path)
    return stored, files


def _is_sqlite(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_SQLITE)) == _SQLITE


def _exported(target: str) -> dict[str, Any]:
    """Returns the data of a store, as ``study export`` writes it.

    Raises:
        StudyError: there is no such store.
    """
    from smooth_operator.study.store.export import study_json
    from smooth_operator.study.store.study_store import open_study

    if not Path(target).exists():  # opening would make one
        raise StudyError(f"no such file: {target!r}; give the folder of a study that was run")
    with open_study(target) as store:
        return study_json(store)


def _with_metrics(paths: Sequence[Path], stored: Sequence[str] = ()) -> list[Path]:
    """Adds the table of metrics in the folder of the trials to the files."""
    folders = [Path(word) for word in stored]
    trials = [(f if f.is_dir() else f.parent) / NAMES[0] for f in folders]
    files = list(paths)
    if any(path.name == NAMES[2] for path in paths):
        return files
    for path in (*paths, *trials):
        metrics = path.with_name(NAMES[2])
        if path.name == NAMES[0] and metrics.is_file():
            files.append(metrics)
    return files


def _print(analysis: Analysis) -> None:
    console = output_console()
    _print_plan(console, analysis)
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


def _print_plan(console: Console, analysis: Analysis) -> None:
    """Prints baseline, primary endpoint and flow of participants."""
    data = analysis.data
    departs = data.plan is None or analysis.baseline != data.plan.baseline
    sentences = [f"baseline: {analysis.baseline}{'' if departs else ', as planned'}"]
    if analysis.primary is not None:
        sentences.append(f"primary endpoint: {'/'.join(analysis.primary)}; the rest is exploratory")
    elif data.plan is not None:
        sentences.append("the plan names no primary endpoint: all of this is exploratory")
    for text in (". ".join(sentences), flow_text(data.flow)):
        if text:
            console.print(Text(text), soft_wrap=True)
    console.print()


def _print_scope(console: Console, analysis: Analysis, outcome: Outcome, scope: str) -> None:
    scale, unit = _UNITS[outcome]
    small, paper = (analysis.results[mode][outcome][scope] for mode in _both())
    role = analysis.role(outcome, scope)
    title = f"{unit}, {scope}: {small.n} rows, {small.operators} operators" + (
        f" ({role})" if role else ""
    )
    if small.refused:
        _print_observed(console, title, small, scale)
        return
    headers = ("retargeter", "mean", f"- {analysis.baseline}", "p Dunnett", "paper", "effect")
    table = _table(title, headers)
    for name, mean in small.emm.items():
        test, other = small.dunnett.get(name), paper.dunnett.get(name)
        table.add_row(
            name,
            f"{scale * mean.estimate:.1f} ± {scale * mean.se:.1f}",
            f"{scale * test.difference:+.2f}" if test else "",
            _p(test.p_dunnett) if test else "",
            _p(other.p_dunnett) if other else "",
            test.effect_words if test else "",
        )
    for name, exact in small.separated.items():
        against = exact.against.get(analysis.baseline)
        p = "" if against is None or against.p_dunnett is None else _p(against.p_dunnett)
        side = "≥" if exact.rate else "≤"
        table.add_row(
            name,
            f"{scale * exact.rate:.1f} ({side} {scale * exact.bound:.1f})",
            f"{scale * against.difference:+.2f}" if against else "",
            p,
            p,
            "exact",
        )
    console.print(table)
    pairs = _table("all pairs, p Holm", ("pair", "difference", "small-sample", "paper"))
    for key, pair in small.pairs.items():
        other_pair = paper.pairs.get(key)
        pairs.add_row(
            f"{pair.a} - {pair.b}",
            f"{scale * pair.difference:+.2f}",
            _p(pair.p_holm),
            _p(other_pair.p_holm) if other_pair else "",
        )
    console.print(pairs)
    for text in dict.fromkeys((*small.warnings, *paper.warnings)):
        console.print(Text(f"  ! {text}", "yellow"), soft_wrap=True)
    console.print()


def _print_observed(console: Console, title: str, result: ScopeResult, scale: float) -> None:
    """Prints the observed data of a refused model; the figures of mode paper would mislead."""
    console.print(Text(f"{title}: not tested: {result.refused}", "yellow"), soft_wrap=True)
    if result.observed:
        table = _table("as observed, without a model", ("retargeter", "rows", "mean", "median"))
        for name, facts in result.observed.items():
            mean, median = (f"{scale * facts[key]:.1f}" for key in ("mean", "median"))
            table.add_row(name, str(facts["n"]), mean, median)
        console.print(table)
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
