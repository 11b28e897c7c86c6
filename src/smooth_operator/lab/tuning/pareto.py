"""Trade-offs between metrics: settings as points, and their Pareto front."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.atomic_files import atomic_write
from smooth_operator.lab.tuning.score import figure
from smooth_operator.reporting.drawing import INK, plain_logs, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Axis:
    """A figure as a coordinate; less is better.

    Attributes:
        metric: its name, see ``figure``.
        label: label of the axis.
        from_one: True if the distance from 1 counts.
    """

    metric: str
    label: str
    from_one: bool = True

    def of(self, metrics: Mapping[str, Any]) -> float:
        """The coordinate of some figures, above 0; NaN where there is none."""
        value = figure(metrics, self.metric)
        if value is None:
            return float("nan")
        value = 1.0 - value if self.from_one else value
        return value if value > 0 else float("nan")


FLATNESS: Final = Axis("flatness", "flatness [m²]", from_one=False)
AGAINST: Final = (
    Axis("cosine_similarity", "1 − thumb cosine"),
    Axis("motion_preservation", "1 − motion preservation"),
    Axis("velocity_correlation", "1 − velocity correlation"),
)
"""What stands against flatness in a search."""

MARKS: Final = {"best score": ("*", 150, "#c2455f"), "start": ("s", 45, "#0072b2")}
"""Shape, size and colour of the trials that are marked."""


def front(points: Float[np.ndarray, "N 2"]) -> Bool[np.ndarray, " N"]:
    """Mask of the Pareto front: points to which no other is equal or better in both coordinates."""
    order = np.lexsort((points[:, 1], points[:, 0]))
    chosen = np.zeros(len(points), bool)
    lowest = np.inf
    for i in order:
        if points[i, 1] < lowest:
            chosen[i], lowest = True, points[i, 1]
    return chosen


def save_pareto(
    path: Path,
    tried: Sequence[Sequence[Mapping[str, Any]]],
    start: Sequence[Mapping[str, Any]],
    best: Sequence[Mapping[str, Any]],
    names: Sequence[str],
) -> None:
    """Draws a row for each recording, a column for each figure against flatness.

    Further to the lower left is better in each panel.

    Args:
        path: PNG to write.
        tried: figures of each trial, one mapping for each recording.
        start: figures of the configuration that the search began at.
        best: figures of the trial with the lowest score.
        names: names of the recordings.

    Raises:
        OutputError: it can't be written.
    """
    from matplotlib.figure import Figure  # not pyplot: no display, no global list of figures

    with styled():
        size = (4.2 * len(AGAINST), 3.4 * len(names) + 0.3)
        drawing = Figure(figsize=size, layout="constrained", dpi=110)
        axes = drawing.subplots(len(names), len(AGAINST), squeeze=False)
        handles: dict[str, Any] = {}
        for i, name in enumerate(names):
            marked = dict(zip(MARKS, (best[i], start[i]), strict=True))
            for k, against in enumerate(AGAINST):
                ax = axes[i, k]
                ax.set_title(name if k == 0 else "", loc="left", fontsize=9)
                _draw(ax, against, [metrics[i] for metrics in tried], marked)
                for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
                    handles.setdefault(label, handle)
        drawing.legend(
            handles.values(), handles.keys(), loc="outside lower center", ncols=len(handles)
        )
        with atomic_write(path) as file:
            drawing.savefig(file, format="png")


def _draw(
    ax: Axes,
    against: Axis,
    tried: Sequence[Mapping[str, Any]],
    marked: Mapping[str, Mapping[str, Any]],
) -> None:
    """One panel: all trials, their front, the start and the best."""
    points = np.array([(FLATNESS.of(m), against.of(m)) for m in tried]).reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        ax.text(0.5, 0.5, f"no {against.label} here", ha="center", transform=ax.transAxes)
        ax.set_axis_off()
        return
    edge = points[front(points)]
    edge = edge[np.argsort(edge[:, 0])]
    ax.scatter(points[:, 0], points[:, 1], s=14, color="0.6", linewidths=0, label="trials")
    ax.plot(*edge.T, "o-", color=INK, markersize=3.5, linewidth=1.2, label="their front")
    for name, metrics in marked.items():
        x, y = FLATNESS.of(metrics), against.of(metrics)
        if np.isfinite([x, y]).all():
            marker, area, color = MARKS[name]
            ax.scatter(
                [x], [y], marker=marker, s=area, color=color, linewidths=0, zorder=3, label=name
            )
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.margins(0.12)
    ax.set_xlabel(FLATNESS.label)
    ax.set_ylabel(against.label)
    plain_logs(ax)
