"""Figures of the report: outcomes, learning, operators, checks of the models."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.special import ndtri

from smooth_operator.errors import StudyError
from smooth_operator.reporting.drawing import GRID
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.frame import Frame, time_frame, tlx_frame, within
from smooth_operator.study.analysis.mixed import fit_mixed
from smooth_operator.study.analysis.operators import operator_means
from smooth_operator.study.analysis.report.tables import p_said, scope_name, signed, span
from smooth_operator.study.analysis.results import MODES, POOLED, Outcome
from smooth_operator.study.analysis.time_to_success import (
    COMPETING,
    SUCCESS,
    TimeToSuccess,
    incidence,
)
from smooth_operator.study.data.rows import ITEMS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
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
    rates = []
    for operator in np.unique(trials.operator[rows]):
        own = rows & (trials.operator == operator)
        chosen = [own & (trials.retargeter == name) for name in analysis.retargeters]
        rates.append(np.array([trials.success[c].mean() if c.any() else np.nan for c in chosen]))
    return rates


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
            finite = np.array(values, float)
            top = max(top, float(finite.max()))
            axes.plot(
                np.append(angles, angles[0]), np.append(finite, finite[0]), color=colors[name],
                label=name if scope == scopes[0] else None, linewidth=1.6,
            )  # fmt: skip
            axes.fill(angles, finite, color=colors[name], alpha=0.07)
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
    correlated = {pair: e for pair, e in analysis.spearman.items() if "rho" in e}
    if not correlated:
        return None
    from matplotlib.figure import Figure

    metrics = _distinct(pair.split("~")[0] for pair in correlated)
    outcomes = _distinct(pair.split("~")[1] for pair in correlated)
    values = np.full((len(metrics), len(outcomes)), np.nan)
    figure = Figure(
        figsize=(2.0 + 1.7 * len(outcomes), 1.2 + 0.6 * len(metrics)), layout="constrained"
    )
    axes = figure.subplots()
    for pair, entry in correlated.items():
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


LABELS: Final[dict[Outcome, str]] = {
    "success": "success rate [%]",
    "time": "completion time [s]",
    "tlx": "workload (NASA-TLX)",
}


_BINS: Final = 10


_FEWEST: Final = 3
"""Operators from which a violin is drawn; fewer are dots only."""


def learning_figure(analysis: Analysis, colors: Mapping[str, str]) -> Figure:
    """Time and success over the count of trials: means of bins, and the fitted slope."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 5.4), layout="constrained")
    grid = figure.subplots(2, 2)
    trials = analysis.data.trials
    kinds = (("trial_global", trials.trial_global), ("trial_in_block", trials.trial_in_block))
    timed = trials.success & np.isfinite(trials.time)
    for column, (index, counts) in enumerate(kinds):
        for row, (outcome, values, rows) in enumerate(
            (
                ("time", trials.time, timed),
                ("success", 100.0 * trials.success, np.ones(len(trials), bool)),
            )
        ):
            axes = grid[row, column]
            for name in analysis.retargeters:
                chosen = rows & (trials.retargeter == name)
                _binned(
                    axes,
                    counts[chosen],
                    values[chosen],
                    colors[name],
                    name if row + column == 0 else None,
                )
            _slope(axes, analysis.learning[POOLED][index][outcome], counts[rows], values[rows])
            axes.set_xlabel(
                {"trial_global": "trial of the task", "trial_in_block": "trial of the block"}[index]
            )
            axes.set_ylabel("completion time [s]" if outcome == "time" else LABELS["success"])
    figure.legend(loc="outside upper center", ncols=len(analysis.retargeters))
    return figure


def _binned(axes: Axes, x: np.ndarray, y: np.ndarray, color: str, label: str | None) -> None:
    if len(x) < 2:
        return
    edges = np.unique(np.quantile(x, np.linspace(0, 1, min(_BINS, len(np.unique(x))) + 1)))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    bins = np.unique(place)
    axes.plot(
        [x[place == b].mean() for b in bins], [y[place == b].mean() for b in bins], "o-",
        color=color, label=label, markersize=3, linewidth=1.1,
    )  # fmt: skip


def _slope(axes: Axes, entry: Mapping[str, float], x: np.ndarray, y: np.ndarray) -> None:
    slope = entry.get("slope", 100 * entry.get("ame_prob_per_unit", float("nan")))
    if not len(x) or not np.isfinite(slope):
        return
    ends = np.array([x.min(), x.max()], float)
    p = entry.get("p_t", entry.get("p_satterthwaite", float("nan")))
    axes.plot(ends, y.mean() + slope * (ends - x.mean()), "--", color="#444c55", linewidth=1.4)
    axes.set_title(f"{signed(slope, 3)} a trial, {p_said(p)}", fontsize=9)


def violin_figure(analysis: Analysis, colors: Mapping[str, str], outcome: Outcome) -> Figure | None:
    """Distribution of the operators' means by task and retargeter; a dot is an operator."""
    means = [one for one in operator_means(analysis.data) if one.outcome == outcome]
    if not means:
        return None
    from matplotlib.figure import Figure

    tasks = analysis.scopes[1:]
    scale = 100.0 if outcome == "success" else 1.0
    figure = Figure(figsize=(1.5 + 2.5 * len(tasks), 3.0), layout="constrained")
    rng = np.random.default_rng(0)  # of the jitter of the dots only
    for axes, task in zip(
        np.atleast_1d(figure.subplots(1, len(tasks), sharey=True)), tasks, strict=True
    ):
        for j, name in enumerate(analysis.retargeters):
            values = scale * np.array(
                [one.mean for one in means if one.task == task and one.retargeter == name]
            )
            if not len(values):
                continue
            if len(values) >= _FEWEST and np.ptp(values) > 0:
                shape = axes.violinplot(values, [j], widths=0.8, showextrema=False)
                for body in shape["bodies"]:
                    body.set_facecolor(colors[name])
                    body.set_alpha(0.3)
            side = j + rng.uniform(-0.1, 0.1, len(values))
            axes.plot(side, values, ".", color=colors[name], markersize=4)
            middle = float(np.median(values))
            axes.plot([j - 0.25, j + 0.25], [middle, middle], color=colors[name], linewidth=2)
        axes.set_xticks(range(len(analysis.retargeters)), analysis.retargeters, rotation=25)
        axes.set_title(scope_name(task))
        axes.grid(visible=False, axis="x")
    figure.axes[0].set_ylabel(LABELS[outcome])
    return figure


_UNITS: Mapping[Outcome, str] = {"time": "completion time [s]", "tlx": "workload"}


def residual_figure(analysis: Analysis, colors: Mapping[str, str]) -> Figure | None:
    """Residuals over fitted values, and their quantiles over those of a normal distribution.

    Of the models of mode small-sample, all tasks together; None if all are refused.
    """
    rows = [
        (outcome, frame)
        for outcome, frame in _frames(analysis).items()
        if analysis.results[MODES[0]][outcome][POOLED].refused is None
    ]
    fitted = [(outcome, frame, _residuals(frame)) for outcome, frame in rows]
    panels = [
        (outcome, frame, remainders)
        for outcome, frame, remainders in fitted
        if remainders is not None
    ]
    if not panels:
        return None
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 2.9 * len(panels)), layout="constrained")
    grid = figure.subplots(len(panels), 2, squeeze=False)
    for (left, right), (outcome, frame, residuals) in zip(grid, panels, strict=True):
        expected = frame.outcome - residuals
        for j, name in enumerate(frame.retargeters):
            own = frame.retargeter == j
            left.plot(
                expected[own], residuals[own], ".", color=colors[name], markersize=3.5, alpha=0.6,
                label=name if outcome == panels[0][0] else None,
            )  # fmt: skip
        left.axhline(0, color=GRID, linewidth=0.8)
        left.set_xlabel(f"fitted {_UNITS[outcome]}")
        left.set_ylabel("residual")
        _quantiles(right, residuals)
    figure.legend(loc="outside upper center", ncols=len(analysis.retargeters))
    return figure


def _frames(analysis: Analysis) -> dict[Outcome, Frame]:
    frames: dict[Outcome, Frame] = {
        "time": time_frame(analysis.data.trials, POOLED, analysis.baseline)
    }
    if analysis.data.questionnaires is not None:
        frames["tlx"] = tlx_frame(analysis.data.questionnaires, POOLED, analysis.baseline)
    return frames


def _residuals(frame: Frame) -> np.ndarray | None:
    try:
        return fit_mixed(frame.design()[0], frame.outcome, frame.levels).residuals
    except StudyError:
        return None


def _quantiles(axes: Axes, residuals: np.ndarray) -> None:
    ordered = np.sort(residuals) / residuals.std(ddof=1)
    normal = ndtri((np.arange(len(ordered)) + 0.5) / len(ordered))
    ends = [normal[0], normal[-1]]
    axes.plot(ends, ends, color=GRID, linewidth=0.8)
    axes.plot(normal, ordered, ".", color="#444c55", markersize=3)
    axes.set_xlabel("normal quantile")
    axes.set_ylabel("residual / SD")


def incidence_figure(analysis: Analysis, colors: Mapping[str, str]) -> Figure | None:
    """Share of all trials that have succeeded by a time, by task; failures never do."""
    reading = analysis.readings.time_to_success[POOLED]
    if not isinstance(reading, TimeToSuccess):
        return None
    from matplotlib.figure import Figure

    tasks, trials = analysis.scopes[1:], analysis.data.trials
    figure = Figure(figsize=(1.0 + 2.6 * len(tasks), 3.1), layout="constrained")
    row = figure.subplots(1, len(tasks), sharey=True, squeeze=False)[0]
    usable = ~(trials.success & np.isnan(trials.time))
    for axes, task in zip(row, tasks, strict=True):
        limit = reading.limits[task]
        for name in analysis.retargeters:
            rows = usable & (trials.task == task) & (trials.retargeter == name)
            if not rows.any():
                continue
            times = np.where(trials.success[rows], trials.time[rows], limit)
            events = np.where(trials.success[rows], SUCCESS, COMPETING)
            curve = incidence(times, events, np.ones((1, int(rows.sum()))))
            inside = curve.times <= limit
            axes.step(
                [0.0, *curve.times[inside], limit],
                100 * np.array([0.0, *curve.reached[0, inside], curve.at(limit)[0]]),
                where="post", color=colors[name], linewidth=1.5,
                label=name if task == tasks[0] else None,
            )  # fmt: skip
        axes.set_title(scope_name(task))
        axes.set_xlabel("time [s]")
        axes.set_ylim(0, 100)
        axes.set_xlim(0, limit)
    row[0].set_ylabel("succeeded [%]")
    figure.legend(loc="outside upper center", ncols=len(analysis.retargeters))
    return figure
