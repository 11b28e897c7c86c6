"""``smooth-operator study analyze``: analyses a study, writes the results, prints a conclusion."""

from __future__ import annotations

import json
from collections.abc import Sequence

from rich.text import Text

from smooth_operator.cli.console import Progressing, output_console
from smooth_operator.cli.outputs import folder_for
from smooth_operator.errors import ConfigError
from smooth_operator_study.analysis import Analysis, analyze_study
from smooth_operator_study.analysis.operators import flow_text, leave_out
from smooth_operator_study.analysis.output import write_analysis
from smooth_operator_study.analysis.report.tables import conclusion
from smooth_operator_study.analysis.results import MODES
from smooth_operator_study.commands.options import Analyze
from smooth_operator_study.data import read_study


def analyze_command(options: Analyze) -> None:
    """Analyses a study, writes the results and prints the conclusion."""
    progress = Progressing(options.quiet)
    if not options.study:
        raise ConfigError("no data: name a folder, tables (.csv) or a JSON file")
    data = read_study(options.study)
    data = leave_out(data, _exclusions(options.exclude))
    for note in data.notes:
        progress.note(f"note: {note}")
    with folder_for(options.output), progress.waiting("analysing (takes about a minute)"):
        analysis = analyze_study(data, options.baseline, seed=options.seed)
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
        progress.note(
            "exit status 1: some parts could not be tested; the reasons are printed above "
            "and stored in the results"
        )
        raise SystemExit(1)


def _exclusions(words: Sequence[str]) -> dict[str, str]:
    """Reads the reasons for excluding operators."""
    reasons: dict[str, str] = {}
    for word in words:
        operator, sign, reason = word.partition("=")
        if not sign or not operator.strip() or not reason.strip():
            raise ConfigError(
                f'--exclude {word}: expected OPERATOR=REASON, such as P03="an author"; the reason '
                "is reported"
            )
        if reasons.setdefault(operator.strip(), reason.strip()) != reason.strip():
            raise ConfigError(f"--exclude names {operator.strip()} twice, with two reasons")
    return reasons


def _print(analysis: Analysis) -> None:
    """Prints the conclusion, the flow of participants, and the limitations of each model."""
    console = output_console()
    data = analysis.data
    departs = data.plan is None or analysis.baseline != data.plan.baseline
    sentences = [f"baseline: {analysis.baseline}{'' if departs else ', as planned'}"]
    if analysis.primary is not None:
        sentences.append(
            f"primary endpoint: {'/'.join(analysis.primary)}; all other results are exploratory"
        )
    elif data.plan is not None:
        sentences.append("the plan names no primary endpoint: all results are exploratory")
    for text in (". ".join(sentences), flow_text(data.flow), *conclusion(analysis)):
        if text:
            console.print(Text(text), soft_wrap=True)
    warnings: dict[str, list[str]] = {}
    for outcome, scopes in analysis.results[MODES[0]].items():
        for scope, result in scopes.items():
            for text in result.warnings:
                warnings.setdefault(text, []).append(f"{outcome}/{scope}")
    for text, where in warnings.items():
        console.print(Text(f"  ! {', '.join(where)}: {text}", "yellow"), soft_wrap=True)
