"""Figures of the report: outcomes, learning, operators, checks of the models."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure  # not pyplot: no global state, no display
from scipy.special import ndtri

from smooth_operator.errors import StudyError
from smooth_operator.reporting.drawing import GRID
from smooth_operator_study.analysis.analyze import Analysis
from smooth_operator_study.analysis.frame import outcome_frames
from smooth_operator_study.analysis.mixed import fit_mixed
from smooth_operator_study.analysis.report.tables import p_equation, scope_name, signed, span
from smooth_operator_study.analysis.results import MODES, POOLED, Outcome
from smooth_operator_study.data.rows import times
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES

Colors = Mapping[str, str]
"""Retargeter -> colour."""
_OUTCOMES: Final = {"success": "success", "time_s": "time", "raw_tlx": "workload"}
_LABELS: Final[dict[Outcome, str]] = {
    "success": "success rate [%]",
    "time": "completion time [s]",
    "tlx": "workload (NASA-TLX)",
}
_FITTED: Final[dict[Outcome, str]] = {"time": "completion time [s]", "tlx": "workload"}
_INDICES: Final = {"trial_global": "trial of the task", "trial_in_block": "trial of the block"}
_ACROSS: Final = 4
"""Largest number of panels in a row."""
_BINS: Final = 10
_NARROWEST: Final = 7.0
"""Smallest width of a figure [inch]; a narrower single panel would look lost on the page."""


def _panels(
    scopes: Sequence[str],
    across: int,
    size: tuple[float, float],
    more: tuple[float, float] = (0.0, 0.0),
    **options: Any,
) -> tuple[Figure, list[Axes]]:
    """Makes a figure with axes for each scope, in rows of ``across``; sizes in inches."""
    columns = min(len(scopes), across)
    rows = -(-len(scopes) // columns)
    width = max(size[0] * columns + more[0], _NARROWEST)
    figure = Figure(figsize=(width, size[1] * rows + more[1]), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, **options)
    for axes in grid.flat[len(scopes) :]:
        axes.remove()
    panels = list(grid.flat[: len(scopes)])
    for axes, scope in zip(panels, scopes, strict=True):
        axes.set_title(scope_name(scope))
    return figure, panels


def _legend(figure: Figure, names: Sequence[str]) -> Figure:
    figure.legend(loc="outside upper center", ncols=len(names))
    return figure


def _name_ticks(axes: Axes, names: Sequence[str], **options: Any) -> None:
    """Labels the axes with the names of retargeters, and removes vertical grid lines."""
    axes.set_xticks(range(len(names)), names, **({"rotation": 25} | options))
    axes.grid(visible=False, axis="x")


def success_figure(analysis: Analysis, colors: Colors) -> Figure:
    """Draws success rates with 95 % intervals; thin lines are the operators' observed rates."""
    scopes, names, trials = analysis.scopes, analysis.retargeters, analysis.data.trials
    size, more = (0.8 + 0.42 * len(names), 2.9), (0.6, 0.0)
    figure, panels = _panels(scopes, _ACROSS, size, more, sharey=True)
    for axes, scope in zip(panels, scopes, strict=True):
        rows = trials if scope == POOLED else trials[trials.task == scope]
        rates = rows.pivot_table(values="success", index="operator", columns="retargeter")
        for own in rates.reindex(columns=names).to_numpy(float):
            axes.plot(
                range(len(names)),
                100 * own,
                "-",
                color=GRID,
                alpha=0.45,
                linewidth=0.7,
                marker=".",
                markersize=2.5,
                zorder=1,
            )
        result = analysis.results[MODES[0]]["success"][scope]
        for j, name in enumerate(names):
            if name in result.emm:
                mean = result.emm[name]
                low, high = max(mean.lower, 0.0), min(mean.upper, 1.0)
                reach = [[100 * (mean.estimate - low)], [100 * (high - mean.estimate)]]
                axes.errorbar(
                    j,
                    100 * mean.estimate,
                    reach,
                    fmt="o",
                    color=colors[name],
                    markersize=6,
                    elinewidth=2.2,
                    zorder=3,
                )
            elif name in result.observed:  # refused: the observed rate, hollow, without an interval
                rate, color = 100 * result.observed[name]["mean"], colors[name]
                axes.plot(j, rate, "o", color=color, fillstyle="none", markersize=7, zorder=3)
        _name_ticks(axes, names, rotation=35, ha="right")
        axes.set_xlim(-0.5, len(names) - 0.5)
        axes.set_ylim(-3, 103)
        axes.set_axisbelow(True)
    for axes in panels[::_ACROSS]:
        axes.set_ylabel(_LABELS["success"])
    return figure


def time_figure(analysis: Analysis, colors: Colors) -> Figure:
    """Draws completion times of successful trials: boxes and every trial."""
    tasks, trials = analysis.scopes[1:], times(analysis.data.trials)
    figure, panels = _panels(tasks, len(tasks), (2.5, 3.4), (1.5, 0.0), sharey=True)
    rng = np.random.default_rng(0)  # of the jitter of the dots only
    for axes, task in zip(panels, tasks, strict=True):
        for j, name in enumerate(analysis.retargeters):
            values = trials.time[(trials.task == task) & (trials.retargeter == name)]
            if not len(values):
                continue
            side = j + rng.uniform(-0.22, 0.22, len(values))
            axes.plot(side, values, ".", color=colors[name], alpha=0.35, markersize=3)
            line = {"color": colors[name], "linewidth": 1.3}
            axes.boxplot(
                values,
                positions=[j],
                widths=0.55,
                showfliers=False,
                boxprops=line,
                whiskerprops=line,
                capprops=line,
                medianprops=line,
            )
        _name_ticks(axes, analysis.retargeters)
    panels[0].set_ylabel(_LABELS["time"])
    panels[0].set_ylim(bottom=0)
    return figure


def item_figure(analysis: Analysis, colors: Colors) -> Figure:
    """Draws the six scales of the NASA-TLX as dots with 95 % intervals, by scope."""
    scopes, names = analysis.scopes, analysis.retargeters
    size = (2.1, 0.9 + 0.14 * len(names) * len(SCALE_NAMES))
    figure, panels = _panels(scopes, _ACROSS, size, (1.2, 0.4), sharex=True, sharey=True)
    step = 0.7 / max(len(names), 2)
    for axes, scope in zip(panels, scopes, strict=True):
        for j, name in enumerate(names):
            for k, item in enumerate(SCALE_NAMES):
                value = _item(analysis, scope, item, name)
                if value is None:
                    continue
                at = k + (j - (len(names) - 1) / 2) * step
                mean = analysis.tlx_items[scope][item].emm.get(name)
                if mean is not None:
                    axes.plot([mean.lower, mean.upper], [at, at], color=colors[name], linewidth=1.2)
                label = name if scope == scopes[0] and k == 0 else None
                axes.plot(value, at, "o", color=colors[name], markersize=3.5, label=label)
        axes.set_yticks(range(len(SCALE_NAMES)), SCALE_NAMES)
        axes.set_xlim(0, 100)
        axes.grid(visible=False, axis="y")
        axes.set_axisbelow(True)
    panels[0].invert_yaxis()
    figure.supxlabel("answer, 0 to 100 (lower is better)", fontsize=9)
    return _legend(figure, names)


def _item(analysis: Analysis, scope: str, item: str, name: str) -> float | None:
    result = analysis.tlx_items[scope][item]
    if name in result.emm:
        return result.emm[name].estimate
    return float(result.observed[name]["mean"]) if name in result.observed else None


def correlation_figure(analysis: Analysis, colors: Colors) -> Figure | None:
    """Draws rank correlations of simulation metrics (rows) with outcomes (columns)."""
    correlated = {tuple(key.split("~")): e for key, e in analysis.spearman.items() if "rho" in e}
    if not correlated:
        return None
    metrics, outcomes = (list(dict.fromkeys(names)) for names in zip(*correlated, strict=True))
    values = np.full((len(metrics), len(outcomes)), np.nan)
    figure = Figure(
        figsize=(2.0 + 1.7 * len(outcomes), 1.2 + 0.6 * len(metrics)), layout="constrained"
    )
    axes = figure.subplots()
    for (metric, outcome), entry in correlated.items():
        row, column = metrics.index(metric), outcomes.index(outcome)
        values[row, column] = entry["rho"]
        low, high = (entry["ci_boot_operators"][end] for end in ("lcl", "ucl"))
        axes.text(
            column,
            row,
            f"{signed(entry['rho'])}\n{span(low, high, sign=True)}",
            ha="center",
            va="center",
            fontsize=8,
            color="#ffffff" if abs(entry["rho"]) > 0.6 else "#111111",
        )
    image = axes.imshow(values, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    axes.set_xticks(range(len(outcomes)), [_OUTCOMES[name] for name in outcomes])
    axes.set_yticks(range(len(metrics)), metrics)
    axes.grid(visible=False)
    figure.colorbar(image, ax=axes, label="Spearman's ρ", shrink=0.9)
    return figure


def learning_figure(analysis: Analysis, colors: Colors) -> Figure:
    """Draws time and success over the count of trials: means of bins, and the fitted slope."""
    figure = Figure(figsize=(8.4, 5.4), layout="constrained")
    grid = figure.subplots(2, 2)
    rows = analysis.data.outcomes()
    scales: dict[Outcome, float] = {"time": 1, "success": 100}
    for column, (index, title) in enumerate(_INDICES.items()):
        for row, (outcome, scale) in enumerate(scales.items()):
            axes = grid[row, column]
            counts, values = rows[outcome][index], scale * rows[outcome].value
            for name in analysis.retargeters:
                own = rows[outcome].retargeter == name
                label = name if row + column == 0 else None
                _binned(axes, counts[own].to_numpy(), values[own].to_numpy(), colors[name], label)
            _slope(axes, analysis.learning[POOLED][index][outcome], counts, values)
            axes.set_xlabel(title)
            axes.set_ylabel(_LABELS[outcome])
    return _legend(figure, analysis.retargeters)


def _binned(axes: Axes, x: np.ndarray, y: np.ndarray, color: str, label: str | None) -> None:
    if len(x) < 2:
        return
    edges = np.unique(np.quantile(x, np.linspace(0, 1, min(_BINS, len(np.unique(x))) + 1)))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    bins = np.unique(place)
    axes.plot(
        [x[place == b].mean() for b in bins],
        [y[place == b].mean() for b in bins],
        "o-",
        color=color,
        label=label,
        markersize=3,
        linewidth=1.1,
    )


def _slope(axes: Axes, entry: Mapping[str, float], x: np.ndarray, y: np.ndarray) -> None:
    slope = entry.get("slope", 100 * entry.get("ame_prob_per_unit", float("nan")))
    if not len(x) or not np.isfinite(slope):
        return
    ends = np.array([x.min(), x.max()], float)
    p = entry.get("p_t", entry.get("p_satterthwaite", float("nan")))
    axes.plot(ends, y.mean() + slope * (ends - x.mean()), "--", color="#444c55", linewidth=1.4)
    axes.set_title(f"{signed(slope, 3)} a trial, {p_equation(p)}", fontsize=9)


def residual_figure(analysis: Analysis, colors: Colors) -> Figure | None:
    """Draws residuals over fitted values, and their quantiles over those of a normal distribution.

    For the models of mode small-sample, all tasks together; None if all are refused.
    """
    panels = []
    for outcome, frame in outcome_frames(analysis.data, POOLED, analysis.baseline).items():
        if outcome in _FITTED and analysis.results[MODES[0]][outcome][POOLED].refused is None:
            try:
                fit = fit_mixed(frame.design()[0], frame.outcome, frame.levels)
            except StudyError:
                continue
            panels.append((_FITTED[outcome], frame, fit.residuals))
    if not panels:
        return None
    figure = Figure(figsize=(8.4, 2.9 * len(panels)), layout="constrained")
    grid = figure.subplots(len(panels), 2, squeeze=False)
    for (left, right), (title, frame, residuals) in zip(grid, panels, strict=True):
        expected = frame.outcome - residuals
        for j, name in enumerate(frame.retargeters):
            own = frame.retargeter == j
            left.plot(
                expected[own],
                residuals[own],
                ".",
                color=colors[name],
                markersize=3.5,
                alpha=0.6,
                label=name if title == panels[0][0] else None,
            )
        left.axhline(0, color=GRID, linewidth=0.8)
        left.set_xlabel(f"fitted {title}")
        left.set_ylabel("residual")
        ordered = np.sort(residuals) / residuals.std(ddof=1)
        normal = ndtri((np.arange(len(ordered)) + 0.5) / len(ordered))
        right.plot(normal[[0, -1]], normal[[0, -1]], color=GRID, linewidth=0.8)
        right.plot(normal, ordered, ".", color="#444c55", markersize=3)
        right.set_xlabel("normal quantile")
        right.set_ylabel("residual / SD")
    return _legend(figure, analysis.retargeters)


FIGURES: Final[Mapping[str, Callable[[Analysis, Colors], Figure | None]]] = {
    "success": success_figure,
    "time": time_figure,
    "tlx-items": item_figure,
    "learning": learning_figure,
    "correlations": correlation_figure,
    "residuals": residual_figure,
}
"""Stem of a file -> function that draws the figure, or returns None without data."""
