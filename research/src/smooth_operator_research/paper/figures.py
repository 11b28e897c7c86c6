"""Figures of the solver experiments: loss, jitter and time, solver by solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from smooth_operator.reporting.drawing import INK
from smooth_operator_research.paper.comparison import Comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FAMILY_COLORS: Final = {
    "sampling": "#0072b2",
    "slsqp": "#d55e00",
    "rmsprop": "#009e73",
    "newton": "#cc79a7",
}
"""Of Okabe and Ito's palette, which colour-blind readers can distinguish."""

FAMILY_MARKERS: Final = {"sampling": "o", "slsqp": "s", "rmsprop": "^", "newton": "D"}
"""Shapes, so that nothing depends on colour alone."""

_PANELS: Final = (
    ("loss", 1.0, "tracking loss [–]"),
    ("jitter", 1e3, "joint jitter [mrad]"),
    ("frame_ms", 1.0, "time a frame [ms]"),
)


def comparison_figure(several: Sequence[Comparison]) -> Figure:
    """Dots with intervals: a row for each solver, a panel for each figure; logarithmic.

    Args:
        several: one, or the one without and the one with a velocity term.
    """
    from matplotlib.figure import Figure

    labels = list(dict.fromkeys(label for found in several for label in found.runs))
    height = 1.25 + 0.36 * len(labels)
    figure = Figure(figsize=(9.6, height))
    axes = figure.subplots(1, len(_PANELS), sharey=True)
    figure.subplots_adjust(
        left=0.145, right=0.985, top=1 - 0.2 / height, bottom=0.85 / height, wspace=0.09
    )
    for ax, (metric, factor, title) in zip(axes, _PANELS, strict=True):
        for k, found in enumerate(several):
            offset = 0.0 if len(several) == 1 else (-0.17, 0.17)[k]
            for row, label in enumerate(labels):
                if label not in found.runs:
                    continue
                _dot(ax, found, label, metric, factor, row + offset, k == len(several) - 1)
        ax.set_xscale("log")
        plain_log(ax.xaxis)
        ax.set_xlabel(title)
        ax.set_ylim(len(labels) - 0.5, -0.5)
        ax.set_yticks(range(len(labels)), labels)
        ax.tick_params(axis="y", length=0)
        ax.grid(visible=False, axis="y")
        for row in range(1, len(labels), 2):
            ax.axhspan(row - 0.5, row + 0.5, color=INK, alpha=0.045, linewidth=0)
    if len(several) > 1:
        from matplotlib.lines import Line2D

        empty: dict[str, Any] = {"color": INK, "linestyle": "", "marker": "o"}
        entries = [("without velocity term", "white"),
                (f"with w_v = {several[-1].velocity_weight:g}", INK)]  # fmt: skip
        figure.legend(
            handles=[
                Line2D([], [], markerfacecolor=face, label=text, **empty)
                for text, face in entries
            ],
            loc="lower left", bbox_to_anchor=(0.01, 0.0), ncols=1, fontsize=8,
        )  # fmt: skip
    return figure


def _dot(
    ax: Axes, found: Comparison, label: str, metric: str, factor: float, y: float, filled: bool
) -> None:
    family = found.solver_grid.solvers[label].family
    color = FAMILY_COLORS[family]
    mean = found.mean(label, metric)
    each = factor * found.samples(label, metric).means
    ax.plot(each, [y] * len(each), "|", color=color, markersize=6, alpha=0.55, zorder=2)
    if mean.low is not None and mean.high is not None and metric != "frame_ms":
        ax.plot(
            [factor * mean.low, factor * mean.high], [y, y], color=color, linewidth=1.4, zorder=3
        )
    ax.plot(
        factor * mean.value, y, FAMILY_MARKERS[family], color=color, markersize=6.5, zorder=4,
        markerfacecolor=color if filled else "white", markeredgewidth=1.3,
    )  # fmt: skip


def plain_log(axis: object) -> None:
    """Numbers, not powers, on a logarithmic axis, and not too many."""
    from matplotlib.axis import Axis
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    assert isinstance(axis, Axis)
    low, high = sorted(axis.get_view_interval())
    axis.set_major_locator(
        LogLocator(subs=(1.0,) if high / low > 30 else (1.0, 2.0, 5.0), numticks=9)
        if high / low > 4
        else MaxNLocator(4)
    )
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
