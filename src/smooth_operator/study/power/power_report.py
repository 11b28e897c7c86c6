"""Results of a power simulation: JSON, and a plot of power over operators."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import OutputError
from smooth_operator.study.analysis.results import MODES, POOLED, Mode, Outcome
from smooth_operator.study.power.power_run import PowerSettings, Truth
from smooth_operator.study.power.verdicts import ALPHA, Rate, Tally, rate, rates

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORMAT: Final = 1
RESULT: Final = "power.json"
PLOT: Final = "power.png"
TITLES: Final[dict[Outcome, str]] = {"success": "success", "time": "time", "tlx": "workload"}
ENOUGH: Final = 0.8
"""Usual target for the power."""
MOST_ERROR: Final = 0.07
"""Family-wise error from which a test is unreliable: 5 % and the error of the simulation."""
Tallies = Mapping[tuple[int, Truth], Tally]
_LINES: Final[dict[Mode, str]] = {"small-sample": "-", "paper": "--"}


def power_json(settings: PowerSettings, tallies: Tallies) -> dict[str, Any]:
    """Returns the content of ``power.json``.

    ``cells`` has an entry for each number of operators, truth, outcome, scope and mode. ``power``
    has the rates at which the true difference of a condition from the baseline (``dunnett``), that
    of a pair (``holm``) and ``all`` of them were significant, and at which a condition was shown to
    be ``equivalent`` to the baseline within the plan's margin. ``family_error`` is the rate of
    studies with a significant difference that does not exist; ``errs`` is true above 7 %.
    """
    cells = []
    for (operators, truth), tally in tallies.items():
        for key, counts in rates(tally).items():
            outcome, scope, mode = key.split("/", 2)
            power: dict[str, dict[str, Any]] = {"dunnett": {}, "holm": {}, "equivalent": {}}
            for what, value in counts.items():
                family, _, name = what.partition(":")
                if family in power:
                    power[family][name] = asdict(value)
            cells.append(
                {
                    "operators": operators,
                    "truth": truth,
                    "outcome": outcome,
                    "scope": scope,
                    "mode": mode,
                    "studies": tally.studies,
                    "power": power,
                    "family_error": {
                        "dunnett": asdict(counts["family:dunnett"]),
                        "holm": asdict(counts["family:holm"]),
                    },
                    "errs": truth == "null" and errs(counts["family:dunnett"]),
                    "refused": asdict(counts["refused"]),
                }
            )
    return {"format": FORMAT, "alpha": ALPHA, "settings": settings.to_json(), "cells": cells}


def errs(error: Rate) -> bool:
    """True if a family-wise error is above ``MOST_ERROR``."""
    return error.rate > MOST_ERROR


def write_power(settings: PowerSettings, tallies: Tallies, folder: Path) -> list[Path]:
    """Writes ``power.json`` and ``power.png`` into a folder.

    Raises:
        OutputError: a file can't be written.
    """
    text = json.dumps(power_json(settings, tallies), indent=1) + "\n"
    with atomic_write(folder / RESULT) as file:
        file.write(text.encode("utf-8"))
    draw_power(settings, tallies, folder / PLOT)
    return [folder / RESULT, folder / PLOT]


def rate_of(tally: Tally, outcome: str, scope: str, mode: str, what: str) -> Rate:
    """Returns the rate of a count, which may be zero."""
    counts = tally.counts.get(f"{outcome}/{scope}/{mode}")
    return rate(0 if counts is None else counts[what], tally.studies)


def draw_power(
    settings: PowerSettings, tallies: Tallies, path: Path, *, scope: str = POOLED
) -> None:
    """Draws power over the number of operators for each outcome, and below the family-wise error.

    Raises:
        OutputError: the file can't be written.
    """
    from matplotlib.figure import Figure  # not pyplot: no global state, no display

    truth = settings.truth
    values = {"success": truth.success, "time": truth.time_s, "tlx": truth.workload}
    outcomes = [o for o in TITLES if o != "tlx" or settings.protocol.questionnaires]
    figure = Figure(figsize=(4.2 * len(outcomes), 7.0), layout="constrained")
    axes = figure.subplots(2, len(outcomes), sharex=True, sharey="row", squeeze=False)
    baseline = settings.protocol.baseline
    others = [name for name in settings.protocol.condition_names if name != baseline]
    for column, outcome in enumerate(outcomes):
        top, bottom = axes[0, column], axes[1, column]
        for number, name in enumerate(others):
            difference = values[outcome][name] - values[outcome][baseline]
            if difference == 0:
                continue
            for mode in MODES:
                shown = f"{name} ({_shown(outcome, difference)})" if mode == MODES[0] else None
                _line(top, settings, tallies, (outcome, scope, mode), "effects",
                      f"dunnett:{name}", f"C{number}", shown)  # fmt: skip
        for mode in MODES:
            _line(bottom, settings, tallies, (outcome, scope, mode), "null", "family:dunnett",
                  "black", mode)  # fmt: skip
        top.set_title(f"{TITLES[outcome]}, against {baseline}")
        top.axhline(ENOUGH, color="0.7", linewidth=0.8, zorder=0)
        bottom.axhline(ALPHA, color="0.7", linewidth=0.8, zorder=0)
        bottom.axhspan(MOST_ERROR, 1.0, color="C3", alpha=0.08, linewidth=0, zorder=0)
        bottom.set_xlabel("operators")
        top.legend(fontsize=8, loc="lower right")
    axes[0, 0].set_ylim(-0.02, 1.02)
    axes[0, 0].set_ylabel("power (solid small-sample, dashed paper)")
    worst = [
        rate_of(tallies[n, "null"], outcome, scope, mode, "family:dunnett").upper
        for n in settings.operators
        for outcome in outcomes
        for mode in MODES
    ]
    axes[1, 0].set_ylim(0.0, 1.1 * max([*worst, 1.4 * MOST_ERROR]))
    axes[1, 0].set_ylabel("family-wise error if nothing differs\n(shaded: over 7 %)")
    axes[1, 0].legend(fontsize=8)
    figure.suptitle(
        f"{settings.protocol.name}: {settings.studies} simulated studies each, bars 95 %",
        fontsize=10,
    )
    try:
        figure.savefig(path, dpi=120)
    except OSError as error:
        raise output_error(path, error) from error
    except ValueError as error:
        raise OutputError(f"can't write {str(path)!r}: {error}") from error


def _line(
    axes: Axes,
    settings: PowerSettings,
    tallies: Tallies,
    where: tuple[Outcome, str, Mode],
    truth: Truth,
    what: str,
    colour: str,
    label: str | None,
) -> None:
    outcome, scope, mode = where
    numbers = sorted(settings.operators)
    rows = [rate_of(tallies[n, truth], outcome, scope, mode, what) for n in numbers]
    middle = [row.rate for row in rows]
    bars = [
        [row.rate - row.lower for row in rows],
        [row.upper - row.rate for row in rows],
    ]
    axes.errorbar(
        numbers, middle, yerr=bars, color=colour, linestyle=_LINES[mode], marker="o",
        markersize=3, linewidth=1.2, elinewidth=0.8, label=label,
    )  # fmt: skip


def _shown(outcome: Outcome, difference: float) -> str:
    if outcome == "success":
        return f"{100 * difference:+.1f} %"
    return f"{difference:+.1f} {'s' if outcome == 'time' else 'points'}"
