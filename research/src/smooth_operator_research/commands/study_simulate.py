"""``smooth-operator study simulate``: virtual operators carry out a plan."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for
from smooth_operator.terminal import printable
from smooth_operator_research.commands.options import Simulate
from smooth_operator_research.study_simulation.run import (
    NOTICE,
    SimulationSettings,
    plan_for,
    simulate_study,
)
from smooth_operator_study.design.plan_file import read_plan
from smooth_operator_study.design.protocol import Protocol


def simulate_command(options: Simulate) -> None:
    """Simulates, writes the results and prints a table."""
    plan = plan_for(read_plan(options.study), options.operators)
    settings = SimulationSettings(
        plan, hand=options.hand, body=options.body, tracker=options.tracker, seed=options.seed
    )
    home = options.study if options.study.is_dir() else options.study.parent
    folder = options.output or home / "simulated"
    progress = Progressing(quiet=options.json)
    with folder_for(folder):
        progress.note(NOTICE)
        with progress.bar("simulating trials") as show:

            def report(done: int, total: int) -> None:
                show(f"simulating trials ({done} of {total})", done / total)

            rows = simulate_study(
                settings, folder, workers=options.workers, report=report, note=progress.note
            )
    cells = _cells(plan.protocol, rows)
    if options.json:
        print(json.dumps({"simulated": True, "notice": NOTICE, "cells": cells}))
        return
    table = plain_table(f"{plan.protocol.name}: {len(plan.codes)} simulated operators")
    for header in ("task", "retargeter", "successes", "trials", "time of successes [s]"):
        table.add_column(header, justify="left" if header in ("task", "retargeter") else "right")
    for cell in cells:
        time = "–" if cell["time_s"] is None else f"{cell['time_s']:.1f}"
        table.add_row(
            cell["task"], cell["retargeter"], str(cell["successes"]), str(cell["trials"]), time
        )
    console = output_console()
    console.print(table)
    console.print(NOTICE, soft_wrap=True)
    print(
        printable(
            f"written: {folder}; next: smooth-operator study analyze {folder} "
            f"--baseline {plan.protocol.baseline} --output FOLDER"
        )
    )


def _cells(protocol: Protocol, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Success rates and mean times of each task and condition."""
    cells = []
    for task in protocol.tasks:
        for condition in protocol.condition_names:
            cell = [r for r in rows if (r["task"], r["retargeter"]) == (task.name, condition)]
            times = [row["time_s"] for row in cell if row["score"] >= 0.5]
            cells.append(
                {
                    "task": task.name,
                    "retargeter": condition,
                    "successes": len(times),
                    "trials": len(cell),
                    "time_s": sum(times) / len(times) if times else None,
                }
            )
    return cells
