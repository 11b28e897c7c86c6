"""Figures of the models: success, times, workload, and simulation against study."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from smooth_operator.reporting.drawing import GRID
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.results import MODES, POOLED
from smooth_operator.study.data.rows import ITEMS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_OUTCOMES: Final = {
    "success": "success",
    "time_s": "time",
    "raw_tlx": "workload",
    "weighted_tlx": "workload",
}
_BAR: Final = 0.8


def scope_name(scope: str) -> str:
    """A scope as a reader knows it."""
    return "all tasks" if scope == POOLED else f"task {scope}"


def success_figure(analysis: Analysis, colors: Mapping[str, str]) -> Figure:
    """Bars of estimated success rates with 95 % intervals, by scope and retargeter."""
    from matplotlib.figure import Figure  # not pyplot: no global state, no display

    figure = Figure(figsize=(2.2 + 1.6 * len(analysis.scopes), 3.4), layout="constrained")
    axes = figure.subplots()
    width = _BAR / len(analysis.retargeters)
    for j, name in enumerate(analysis.retargeters):
        for i, scope in enumerate(analysis.scopes):
            result = analysis.results[MODES[0]]["success"][scope]
            at = i + (j - (len(analysis.retargeters) - 1) / 2) * width
            label = name if i == 0 else None
            if name in result.emm:
                mean = result.emm[name]
                axes.bar(at, 100 * mean.estimate, 0.92 * width, color=colors[name], label=label)
                low, high = max(mean.lower, 0.0), min(mean.upper, 1.0)
                error = [[100 * (mean.estimate - low)], [100 * (high - mean.estimate)]]
                axes.errorbar(at, 100 * mean.estimate, error, fmt="none", ecolor=GRID, capsize=2.5)
            elif name in result.observed:  # refused: the raw rate, hollow and without an interval
                rate = 100 * result.observed[name]["mean"]
                axes.bar(
                    at, rate, 0.92 * width, color="none", edgecolor=colors[name], hatch="//",
                    label=label,
                )  # fmt: skip
    axes.set_xticks(range(len(analysis.scopes)), [scope_name(s) for s in analysis.scopes])
    axes.set_ylabel("success rate [%]")
    axes.set_ylim(0, 100)
    axes.grid(visible=False, axis="x")
    figure.legend(loc="outside upper center", ncols=len(analysis.retargeters))
    return figure


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
            column, row, f"{entry['rho']:+.2f}\n{low:+.2f} to {high:+.2f}", ha="center",
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
