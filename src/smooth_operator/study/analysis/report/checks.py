"""Figures that check the models: residuals and their quantiles; and time with failures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from smooth_operator.errors import StudyError
from smooth_operator.reporting.drawing import GRID
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.frame import Frame
from smooth_operator.study.analysis.mixed import fit_mixed
from smooth_operator.study.analysis.outcome_frames import time_frame, tlx_frame
from smooth_operator.study.analysis.report.report_tables import scope_name
from smooth_operator.study.analysis.results import MODES, POOLED, Outcome
from smooth_operator.study.analysis.time_to_success import (
    COMPETING,
    SUCCESS,
    TimeToSuccess,
    incidence,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    known = [(outcome, frame, found) for outcome, frame, found in fitted if found is not None]
    if not known:
        return None
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 2.9 * len(known)), layout="constrained")
    grid = figure.subplots(len(known), 2, squeeze=False)
    for (left, right), (outcome, frame, residuals) in zip(grid, known, strict=True):
        expected = frame.outcome - residuals
        for j, name in enumerate(frame.retargeters):
            own = frame.retargeter == j
            left.plot(
                expected[own], residuals[own], ".", color=colors[name], markersize=3.5, alpha=0.6,
                label=name if outcome == known[0][0] else None,
            )  # fmt: skip
        left.axhline(0, color=GRID, linewidth=0.8)
        left.set_xlabel(f"fitted {_UNITS[outcome]}")
        left.set_ylabel("residual")
        _quantiles(right, residuals)
    figure.legend(loc="outside upper center", ncols=len(analysis.retargeters))
    return figure


def _frames(analysis: Analysis) -> dict[Outcome, Frame]:
    found: dict[Outcome, Frame] = {
        "time": time_frame(analysis.data.trials, POOLED, analysis.baseline)
    }
    if analysis.data.questionnaires is not None:
        found["tlx"] = tlx_frame(analysis.data.questionnaires, POOLED, analysis.baseline)
    return found


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
    kept = ~(trials.success & np.isnan(trials.time))
    for axes, task in zip(row, tasks, strict=True):
        limit = reading.limits[task]
        for name in analysis.retargeters:
            rows = kept & (trials.task == task) & (trials.retargeter == name)
            if not rows.any():
                continue
            times = np.where(trials.success[rows], trials.time[rows], limit)
            events = np.where(trials.success[rows], SUCCESS, COMPETING)
            found = incidence(times, events, np.ones((1, int(rows.sum()))))
            inside = found.times <= limit
            axes.step(
                [0.0, *found.times[inside], limit],
                100 * np.array([0.0, *found.reached[0, inside], found.at(limit)[0]]),
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
