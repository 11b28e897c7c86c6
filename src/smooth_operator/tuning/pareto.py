"""What was traded for what: every trial as a point, and the front of those that none beats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.benchmark.drawing import INK
from smooth_operator.recording import atomic_write
from smooth_operator.tuning.log import Trial
from smooth_operator.tuning.score import figure

AGAINST: Final = {
    "cosine_similarity": "1 − thumb cosine",
    "motion_preservation": "1 − motion preservation",
    "velocity_correlation": "1 − velocity correlation",
}
"""What stands against flatness, each as its distance from 1."""


def front(points: Float[np.ndarray, "N 2"]) -> Bool[np.ndarray, " N"]:
    """Which points no other beats in one coordinate without losing in the other; less is better."""
    order = np.lexsort((points[:, 1], points[:, 0]))
    kept = np.zeros(len(points), bool)
    lowest = np.inf
    for i in order:
        if points[i, 1] < lowest:
            kept[i], lowest = True, points[i, 1]
    return kept


def save_pareto(
    path: Path,
    trials: Sequence[Trial],
    start: Sequence[Mapping[str, Any]],
    best: Trial,
    names: Sequence[str],
) -> None:
    """Draws a row for each recording, a column for each figure against flatness.

    Args:
        path: PNG to write.
        trials: all of them.
        start: figures of the configuration that the search began at.
        best: the trial with the lowest score.
        names: of the recordings.

    Raises:
        OutputError: it can't be written.
    """
    from matplotlib.figure import Figure  # not pyplot: no display, no global list of figures

    rows, columns = len(names), len(AGAINST)
    drawing = Figure(figsize=(4.2 * columns, 3.2 * rows), layout="constrained")
    axes = drawing.subplots(rows, columns, squeeze=False)
    measured = [trial.metrics for trial in trials if trial.metrics is not None]
    for i, recording in enumerate(names):
        for k, (metric, label) in enumerate(AGAINST.items()):
            ax = axes[i, k]
            points = np.array([_point(metrics[i], metric) for metrics in measured])
            points = points[np.isfinite(points).all(axis=1) & (points > 0).all(axis=1)]
            if len(points):
                edge = points[front(points)]
                edge = edge[np.argsort(edge[:, 0])]
                ax.scatter(*points.T, s=12, color="0.6", linewidths=0, label="trials")
                ax.plot(*edge.T, color=INK, linewidth=1.2, label="front")
            for metrics, marker, name in (
                (start[i], "s", "start"),
                ((best.metrics or start)[i], "*", "best score"),
            ):
                x, y = _point(metrics, metric)
                if x > 0 and y > 0:
                    size = 45 if marker == "s" else 130
                    ax.scatter([x], [y], marker=marker, s=size, zorder=3, label=name)
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_xlabel("flatness [m²]")
            ax.set_ylabel(label)
            if k == 0:
                ax.set_title(recording, loc="left", fontsize=9)
            if i == k == 0:
                ax.legend(fontsize=8)
    with atomic_write(path) as file:
        drawing.savefig(file, format="png", dpi=110)


def _point(metrics: Mapping[str, Any], metric: str) -> tuple[float, float]:
    flat, value = figure(metrics, "flatness"), figure(metrics, metric)
    nan = float("nan")
    return (nan if flat is None else flat, nan if value is None else 1.0 - value)
