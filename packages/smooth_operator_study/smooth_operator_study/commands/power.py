"""``smooth-operator study power``: simulates studies and makes tables and a plot."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from rich.console import Console

from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for
from smooth_operator.simulation.tasks.task import PAPER_TASKS
from smooth_operator.terminal import printable
from smooth_operator_study.analysis.results import MODES
from smooth_operator_study.commands.new import PAPER_CONDITIONS, PAPER_OPERATORS, numbers_of
from smooth_operator_study.commands.options import Power
from smooth_operator_study.design.plan_file import read_plan
from smooth_operator_study.design.protocol import Protocol
from smooth_operator_study.power.power_run import (
    TITLES,
    TRUTHS,
    PowerSettings,
    Rate,
    Tallies,
    errs,
    power_json,
    rate_of,
    run_power,
    write_power,
)
from smooth_operator_study.power.simulated_study import Spread, assumptions_for

_SHARES: Final = (1 / 3, 2 / 3, 1.0, 4 / 3, 2.0)


def simulate_power(options: Power) -> None:
    """Simulates, prints tables and writes the results."""
    settings = _settings(options)
    study = options.study or Path()
    folder = options.output or (study if study.is_dir() else study.parent) / "power"
    progress = Progressing(quiet=options.json)
    with folder_for(folder):
        with progress.bar("simulating studies") as show:

            def report(done: int, total: int) -> None:
                show(f"simulating studies ({done} of {total})", done / total)

            tallies = run_power(
                settings, folder, workers=options.workers, report=report, note=progress.note
            )
        files = write_power(settings, tallies, folder)
    if options.json:
        print(json.dumps(power_json(settings, tallies)))
        return
    for scope in settings.scopes:
        _print(settings, tallies, scope)
    print(printable(f"written: {', '.join(str(path) for path in files)}"))


def _settings(options: Power) -> PowerSettings:
    if options.study is None:
        protocol = Protocol(
            "the design of the paper", PAPER_CONDITIONS, PAPER_TASKS, "dexpilot", PAPER_OPERATORS
        )
    else:
        protocol = read_plan(options.study).protocol
    form = "NAME=NUMBER, such as sbr=0.5"
    truth = assumptions_for(
        protocol.condition_names,
        success=numbers_of(options.success, "--success", form),
        time_s=numbers_of(options.time, "--time", form),
        workload=numbers_of(options.workload, "--workload", form),
        operators=Spread(*options.operators_differ),
        interaction=Spread(*options.preferences_differ),
        trials=Spread(0.0, *options.trials_differ),
    )
    planned = sorted({max(3, round(share * protocol.operators)) for share in _SHARES})
    return PowerSettings(
        protocol,
        truth,
        tuple(options.operators or planned),
        options.studies,
        options.per_task,
        options.seed,
    )


def _print(settings: PowerSettings, tallies: Tallies, scope: str) -> None:
    console = output_console()
    baseline = settings.protocol.baseline
    others = [name for name in settings.protocol.condition_names if name != baseline]
    table = plain_table(
        f"{settings.protocol.name}, {scope}: power against {baseline} (Dunnett) and "
        f"family-wise error, {settings.studies} studies each, ± Monte-Carlo standard error [%]"
    )
    for header in ("operators", "outcome", "mode", *others, "all", "error without differences"):
        table.add_column(header, justify="left" if header in ("outcome", "mode") else "right")
    flagged = False
    for operators in settings.operators:
        for outcome in settings.outcomes:
            for mode in MODES:
                what = [f"dunnett:{name}" for name in (*others, "all")]
                cells = [
                    rate_of(tallies[operators, "effects"], outcome, scope, mode, each)
                    for each in what
                ]
                error = rate_of(tallies[operators, "null"], outcome, scope, mode, "family:dunnett")
                flag = " !" if errs(error) else ""
                flagged |= bool(flag)
                table.add_row(
                    str(operators),
                    TITLES[outcome],
                    mode,
                    *map(_percent, cells),
                    _percent(error) + flag,
                )
    console.print(table)
    if flagged:
        console.print(
            "! finds a difference in more than 7 % of the studies without one: its power "
            "can't be trusted",
            soft_wrap=True,
        )
    if settings.protocol.margins:
        _print_equivalence(console, settings, tallies, scope, others)
    refused = sum(
        tally[f"{outcome}/{scope}/{mode}/refused"]
        for tally in tallies.values()
        for outcome in settings.outcomes
        for mode in MODES
    )
    if refused:
        console.print(
            f"{refused} analyses failed (too few successes or operators); they count as "
            "studies that find no difference",
            soft_wrap=True,
        )


def _print_equivalence(
    console: Console, settings: PowerSettings, tallies: Tallies, scope: str, others: Sequence[str]
) -> None:
    margins = settings.protocol.margins
    with_margin = [outcome for outcome in TITLES if outcome in margins]
    limits = ", ".join(f"{TITLES[outcome]} {margins[outcome]:g}" for outcome in with_margin)
    table = plain_table(
        f"shown to be equivalent to {settings.protocol.baseline} within the margin "
        f"({limits}), as assumed / if none differs, mode small-sample [%]"
    )
    for header in ("operators", "outcome", *others):
        table.add_column(header, justify="left" if header == "outcome" else "right")
    for operators in settings.operators:
        for outcome in with_margin:
            cells = []
            for name in others:
                where = (outcome, scope, MODES[0], f"equivalent:{name}")
                rates = [rate_of(tallies[operators, truth], *where) for truth in TRUTHS]
                cells.append(" / ".join(f"{100 * one.rate:.0f}" for one in rates))
            table.add_row(str(operators), TITLES[outcome], *cells)
    console.print(table)


def _percent(rate: Rate) -> str:
    return f"{100 * rate.rate:.1f} ± {100 * rate.se:.1f}"
