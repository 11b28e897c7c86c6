"""Figures of the models: success, times, workload, and simulation against study."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from smooth_operator.reporting.drawing import GRID
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.outcome_frames import within
from smooth_operator.study.analysis.report.number_text import signed, span
from smooth_operator.study.analysis.report.report_tables import scope_name
from smooth_operator.study.analysis.results import MODES
from smooth_operator.study.data.rows import ITEMS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_OUTCOMES: Final = {
    "success": "success",
    "time_s": "time",
    "raw_tlx": "workload",
    "weighted_tlx": "workload",
}
_ACROSS: Final = 4
"""Panels next to each other."""


def success_figure(analysis: Analysis, colors: Mapping[str, str]) -> Figure:
    """Estimated success rates with 95 % intervals; thin lines are the operators' observed rates."""
    from matplotlib.figure import Figure  # not pyplot: no global state, no display

    scopes, names = analysis.scopes, analysis.retargeters
    columns = min(len(scopes), _ACROSS)
    rows = -(-len(scopes) // columns)
    figure = Figure(
        figsize=((0.8 + 0.42 * len(names)) * columns + 0.6, 2.9 * rows), layout="constrained"
    )
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for axes in grid.flat[len(scopes) :]:
        axes.remove()
    for axes, scope in zip(grid.flat, scopes, strict=False):
        for rates in _operator_rates(analysis, scope):
            axes.plot(
                range(len(names)), 100 * rates, "-", color=GRID, alpha=0.45, linewidth=0.7,
                marker=".", markersize=2.5, zorder=1,
            )  # fmt: skip
        result = analysis.results[MODES[0]]["success"][scope]
        for j, name in enumerate(names):
            if name in result.emm:
                mean = result.emm[name]
                low, high = max(mean.lower, 0.0), min(mean.upper, 1.0)
                reach = [[100 * (mean.estimate - low)], [100 * (high - mean.estimate)]]
                axes.errorbar(
                    j, 100 * mean.estimate, reach, fmt="o", color=colors[name], markersize=6,
                    elinewidth=2.2, zorder=3,
                )  # fmt: skip
            elif name in result.observed:  # refused: the raw rate, hollow and without an interval
                rate = 100 * result.observed[name]["mean"]
                axes.plot(
                    j, rate, "o", markerfacecolor="none", markeredgecolor=colors[name],
                    markersize=7, zorder=3,
                )  # fmt: skip
        axes.set_xticks(range(len(names)), names, rotation=35, ha="right")
        axes.set_xlim(-0.5, len(names) - 0.5)
        axes.set_ylim(-3, 103)
        axes.set_title(scope_name(scope))
        axes.grid(visible=False, axis="x")
        axes.set_axisbelow(True)
    for row in grid:
        row[0].set_ylabel("success rate [%]")
    return figure


def _operator_rates(analysis: Analysis, scope: str) -> list[np.ndarray]:
    """Observed rate of each operator with each retargeter; NaN where there is none."""
    trials = analysis.data.trials
    rows = within(trials, scope)
    found = []
    for operator in np.unique(trials.operator[rows]):
        own = rows & (trials.operator == operator)
        chosen = [own & (trials.retargeter == name) for name in analysis.retargeters]
        found.append(np.array([trials.success[c].mean() if c.any() else np.nan for c in chosen]))
    return found


def time_figure(analysis: Analysis, colors: Mapping[str, str]) -> Figure:
    """Distributions of completion times of successful trials: boxes and every trial."""
    from matplotlib.figure import Figure

    tasks = analysis.scopes[1:]
    figure = Figure(figsize=(1.5 + 2.5 * len(tasks), 3.4), layout="constrained")
    trials = analysis.data.trials
    rng = np.random.default_rng(0)  # of the jitter of the dots only
    for axes, task in zip(
        np.atleast_1d(figure.subplots(1, len(tasks), sharey=True)), tasks, strict=True
    ):
        for j, name in enumerate(analysis.retargeters):
            rows = trials.success & np.isfinite(trials.time)
            values = trials.time[rows & (trials.task == task) & (trials.retargeter == name)]
            if not len(values):
                continue
            side = j + rng.uniform(-0.22, 0.22, len(values))
            axes.plot(side, values, ".", color=colors[name], alpha=0.35, markersize=3)
            axes.boxplot(
                values, positions=[j], widths=0.55, showfliers=False,
                **{
                    part: {"color": colors[name], "linewidth": 1.3}
                    for part in ("boxprops", "whiskerprops", "capprops", "medianprops")
                },
            )  # fmt: skip
        axes.set_xticks(range(len(analysis.retargeters)), analysis.retargeters, rotation=25)
        axes.set_title(scope_name(task))
        axes.grid(visible=False, axis="x")
    figure.axes[0].set_ylabel("completion time [s]")
    figure.axes[0].set_ylim(bottom=0)
    return figure


def item_figure(analysis: Analysis, colors: Mapping[str, str]) -> Figure | None:
    """The six scales of the NASA-TLX as dots with 95 % intervals, by scope."""
    if analysis.data.questionnaires is None:
        return None
    from matplotlib.figure import Figure

    scopes, names = analysis.scopes, analysis.retargeters
    columns = min(len(scopes), _ACROSS)
    rows = -(-len(scopes) // columns)
    figure = Figure(
        figsize=(2.1 * columns + 1.2, 0.4 + (0.9 + 0.14 * len(names) * len(ITEMS)) * rows),
        layout="constrained",
    )
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid.flat[len(scopes) :]:
        axes.remove()
    step = 0.7 / max(len(names), 2)
    for axes, scope in zip(grid.flat, scopes, strict=False):
        for j, name in enumerate(names):
            for k, item in enumerate(ITEMS):
                value = _item(analysis, scope, item, name)
                if value is None:
                    continue
                at = k + (j - (len(names) - 1) / 2) * step
                mean = analysis.tlx_items[scope][item].emm.get(name)
                if mean is not None:
                    axes.plot([mean.lower, mean.upper], [at, at], color=colors[name], linewidth=1.2)
                label = name if scope == scopes[0] and k == 0 else None
                axes.plot(value, at, "o", color=colors[name], markersize=3.5, label=label)
        axes.set_title(scope_name(scope))
        axes.set_yticks(range(len(ITEMS)), ITEMS)
        axes.set_xlim(0, 100)
        axes.grid(visible=False, axis="y")
        axes.set_axisbelow(True)
    grid[0, 0].invert_yaxis()
    figure.supxlabel("answer, 0 to 100 (less is better)", fontsize=9)
    figure.legend(loc="outside upper center", ncols=len(names))
    return figure


def radar_figure(analysis: Analysis, colors: Mapping[str, str]) -> Figure | None:
    """The six scales of the NASA-TLX by scope; a smaller area is less workload."""
    if analysis.data.questionnaires is None:
        return None
    from matplotlib.figure import Figure

    scopes = analysis.scopes
    columns = min(2, len(scopes))
    rows = -(-len(scopes) // columns)
    figure = Figure(figsize=(4.2 * columns, 0.4 + 3.4 * rows), layout="constrained")
    angles = np.linspace(0, 2 * np.pi, len(ITEMS), endpoint=False)
    grid = figure.subplots(rows, columns, subplot_kw={"projection": "polar"}, squeeze=False)
    top = 10.0
    for axes in grid.flat[len(scopes) :]:
        axes.remove()
    for axes, scope in zip(grid.flat, scopes, strict=False):
        for name in analysis.retargeters:
            values = [_item(analysis, scope, item, name) for item in ITEMS]
            if any(value is None for value in values):
                continue
            known = np.array(values, float)
            top = max(top, float(known.max()))
            axes.plot(
                np.append(angles, angles[0]), np.append(known, known[0]), color=colors[name],
                label=name if scope == scopes[0] else None, linewidth=1.6,
            )  # fmt: skip
            axes.fill(angles, known, color=colors[name], alpha=0.07)
        axes.set_xticks(angles, ITEMS)
        axes.tick_params(labelsize=7.5)
        axes.set_title(scope_name(scope))
    for axes in figure.axes:
        axes.set_ylim(0, min(100.0, 1.08 * top))
        axes.spines["polar"].set_visible(False)
    figure.legend(loc="outside upper center", ncols=len(analysis.retargeters))
    return figure


def _item(analysis: Analysis, scope: str, item: str, name: str) -> float | None:
    result = analysis.tlx_items[scope][item]
    if name in result.emm:
        return result.emm[name].estimate
    return float(result.observed[name]["mean"]) if name in result.observed else None


def correlation_figure(analysis: Analysis) -> Figure | None:
    """Rank correlations of simulation metrics (rows) with outcomes (columns)."""
    known = {pair: e for pair, e in analysis.spearman.items() if "rho" in e}
    if not known:
        return None
    from matplotlib.figure import Figure

    metrics = _distinct(pair.split("~")[0] for pair in known)
    outcomes = _distinct(pair.split("~")[1] for pair in known)
    values = np.full((len(metrics), len(outcomes)), np.nan)
    figure = Figure(
        figsize=(2.0 + 1.7 * len(outcomes), 1.2 + 0.6 * len(metrics)), layout="constrained"
    )
    axes = figure.subplots()
    for pair, entry in known.items():
        metric, outcome = pair.split("~")
        row, column = metrics.index(metric), outcomes.index(outcome)
        values[row, column] = entry["rho"]
        low, high = (entry["ci_boot_operators"][end] for end in ("lcl", "ucl"))
        axes.text(
            column, row, f"{signed(entry['rho'])}\n{span(low, high, sign=True)}", ha="center",
            va="center", fontsize=8, color="#ffffff" if abs(entry["rho"]) > 0.6 else "#111111",
        )  # fmt: skip
    image = axes.imshow(values, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    axes.set_xticks(range(len(outcomes)), [_OUTCOMES.get(name, name) for name in outcomes])
    axes.set_yticks(range(len(metrics)), metrics)
    axes.grid(visible=False)
    figure.colorbar(image, ax=axes, label="Spearman's ρ", shrink=0.9)
    return figure


def _distinct(words: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(words))
