"""Figures of operators and of time: learning curves, violins."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.operators import operator_means
from smooth_operator.study.analysis.report.number_text import p_said, signed
from smooth_operator.study.analysis.report.report_tables import scope_name
from smooth_operator.study.analysis.results import POOLED, Outcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
