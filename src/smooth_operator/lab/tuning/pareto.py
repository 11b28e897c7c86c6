"""Trade-offs between metrics: settings as points, and their Pareto front."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.atomic_files import atomic_write
from smooth_operator.lab.tuning.score import figure
from smooth_operator.reporting.drawing import INK, colors_of, name_points, plain_logs, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Axis:
    """A figure as a coordinate; less is better.

    Attributes:
        metric: its name, see ``figure``.
        label: label of the axis.
        from_one: True if the distance from 1 counts.
        log: equal steps are equal ratios.
        scale: factor of the values.
    """

    metric: str
    label: str
    from_one: bool = False
    log: bool = True
    scale: float = 1.0

    def of(self, metrics: Mapping[str, Any]) -> float:
        """The coordinate of some figures; NaN where there is none."""
        value = figure(metrics, self.metric)
        if value is None:
            return float("nan")
        value = self.scale * (1.0 - value if self.from_one else value)
        return float("nan") if self.log and value <= 0 else value


FLATNESS: Final = Axis("flatness", "flatness [m²]")
THUMB: Final = Axis("cosine_similarity", "1 − thumb cosine", from_one=True)
ALL_VECTORS: Final = Axis("cosine_similarity_all", "1 − all-15 cosine", from_one=True)
MOTION: Final = Axis("motion_preservation", "1 − motion preservation", from_one=True)
VELOCITY: Final = Axis("velocity_correlation", "1 − velocity correlation", from_one=True)
COLLISION: Final = Axis(
    "self_collision.share", "frames deeper than 2 mm [%]", log=False, scale=100.0
)
PINCH: Final = Axis("pinch_error_mm", "pinch gap [mm]", log=False)

AGAINST: Final = (THUMB, MOTION, VELOCITY)
"""What stands against flatness in a search."""


@dataclass(frozen=True, eq=False)
class TradeOff:
    """One figure against another on one recording.

    Attributes:
        title: title of the plot.
        x, y: the two.
        tried: figures of every setting that was tried.
        marked: name -> figures of settings to be found at a glance, in the order of
            ``MARKS``.
        others: name -> figures of other methods.
        called: names of the settings.
    """

    title: str
    x: Axis
    y: Axis
    tried: Sequence[Mapping[str, Any]]
    marked: Mapping[str, Mapping[str, Any]]
    others: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    called: str = "trials"


MARKS: Final = (("*", 150, "#c2455f"), ("s", 45, "#0072b2"))
"""Shape, size and colour of what is marked."""


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

    Args:
        path: PNG to write.
        tried: figures of each trial, one mapping for each recording.
        start: figures of the configuration that the search began at.
        best: figures of the trial with the lowest score.
        names: names of the recordings.

    Raises:
        OutputError: it can't be written.
    """
    save_trade_offs(
        path,
        [
            [
                TradeOff(
                    recording if k == 0 else "",
                    FLATNESS,
                    axis,
                    [metrics[i] for metrics in tried],
                    {"best score": best[i], "start": start[i]},
                )
                for k, axis in enumerate(AGAINST)
            ]
            for i, recording in enumerate(names)
        ],
    )


def save_trade_offs(path: Path, rows: Sequence[Sequence[TradeOff]]) -> None:
    """Draws rows of panels; further to the lower left is better in each.

    Args:
        path: PNG to write.
        rows: all of one length.

    Raises:
        OutputError: it can't be written.
    """
    from matplotlib.figure import Figure  # not pyplot: no display, no global list of figures

    with styled():
        size = (4.2 * len(rows[0]), 3.4 * len(rows) + 0.3)
        drawing = Figure(figsize=size, layout="constrained", dpi=110)
        axes = drawing.subplots(len(rows), len(rows[0]), squeeze=False)
        panels = [(axes[i, k], panel) for i, row in enumerate(rows) for k, panel in enumerate(row)]
        others = dict.fromkeys(name for _, panel in panels for name in panel.others)
        colors = colors_of(others)
        handles: dict[str, Any] = {}
        for ax, panel in panels:
            _draw(ax, panel, colors)
            for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
                handles.setdefault(label, handle)
        drawing.legend(
            handles.values(), handles.keys(), loc="outside lower center", ncols=len(handles)
        )
        drawing.draw_without_rendering()  # names are placed when all else is
        drawing.set_layout_engine("none")
        for ax, panel in panels:
            places = {name: _place(metrics, panel) for name, metrics in panel.others.items()}
            points = [_place(m, panel) for m in (*panel.tried, *panel.marked.values())]
            name_points(
                ax,
                {name: at for name, at in places.items() if np.isfinite(at).all()},
                [at for at in points if np.isfinite(at).all()],
                size=7.5,
            )
        with atomic_write(path) as file:
            drawing.savefig(file, format="png")


def _place(metrics: Mapping[str, Any], panel: TradeOff) -> tuple[float, float]:
    return (panel.x.of(metrics), panel.y.of(metrics))


def _draw(ax: Axes, panel: TradeOff, colors: Mapping[str, str]) -> None:
    """Everything but the names of the other methods."""
    tried = np.array([_place(metrics, panel) for metrics in panel.tried]).reshape(-1, 2)
    tried = tried[np.isfinite(tried).all(axis=1)]
    if len(tried):
        edge = tried[front(tried)]
        edge = edge[np.argsort(edge[:, 0])]
        x, y = tried.T
        ax.scatter(x, y, s=14, color="0.6", linewidths=0, label=panel.called)
        ax.plot(*edge.T, "o-", color=INK, markersize=3.5, linewidth=1.2, label="their front")
    shown: list[tuple[Mapping[str, Any], str, int, str, str | None]]
    shown = [(metrics, "s", 30, colors[name], None) for name, metrics in panel.others.items()]
    for (name, metrics), mark in zip(panel.marked.items(), MARKS, strict=False):
        shown.append((metrics, *mark, name))
    for metrics, marker, size, color, label in shown:
        x, y = _place(metrics, panel)
        if np.isfinite([x, y]).all():
            ax.scatter(
                [x], [y], marker=marker, s=size, color=color, linewidths=0, zorder=3, label=label
            )
    if not ax.collections:
        ax.set_title(panel.title, loc="left", fontsize=9)
        ax.text(0.5, 0.5, f"no {panel.x.label} here", ha="center", transform=ax.transAxes)
        ax.set_axis_off()
        return
    for axis, scale in ((panel.x, ax.set_xscale), (panel.y, ax.set_yscale)):
        if axis.log:
            scale("log")
    ax.margins(0.12)
    ax.set_xlabel(panel.x.label)
    ax.set_ylabel(panel.y.label)
    ax.set_title(panel.title, loc="left", fontsize=9)
    plain_logs(ax)
