"""Figure of the experiment ``compute``: the grid with its contours, and the losses along them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from smooth_operator.reporting.drawing import GRID, MARKERS
from smooth_operator_research.paper.budget_grid import Point
from smooth_operator_research.paper.figures import plain_log
from smooth_operator_research.paper.intervals import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FLOOR: Final = 0.003
"""Less above the best cell than this is drawn as this [%]: differences there are chance."""


def compute_figure(
    means: Mapping[Point, Estimate], lines: Sequence[Sequence[Point]], reference: float
) -> Figure:
    """The loss over the grid, and along contours of equal compute.

    Args:
        means: loss of each cell.
        lines: contours, by budget.
        reference: DexPilot's loss.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.2, 4.4))
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    figure.subplots_adjust(left=0.07, right=0.985, top=0.92, bottom=0.13, wspace=0.28)
    _heat(figure, left, means, lines, reference)
    _lines(right, means, lines)
    best = min(mean.value for mean in means.values())
    left.set_title(
        f"best cell: loss {best:.4f}; DexPilot, by the same loss: {reference:.4f}",
        fontsize=9,
        loc="left",
    )
    return figure


def _heat(
    figure: Figure,
    ax: Axes,
    means: Mapping[Point, Estimate],
    lines: Sequence[Sequence[Point]],
    reference: float,
) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.patches import Rectangle

    samples = sorted({point.samples for point in means})
    cycles = sorted({point.cycles for point in means})
    best = min(mean.value for mean in means.values())
    table = np.full((len(cycles), len(samples)), np.nan)
    for point, mean in means.items():
        excess = max(_excess(mean, best), _FLOOR)
        table[cycles.index(point.cycles), samples.index(point.samples)] = excess
    norm = LogNorm(_FLOOR, max(float(np.nanmax(table)), 10 * _FLOOR))
    image = ax.imshow(table, origin="lower", aspect="auto", cmap="viridis_r", norm=norm)
    for point, mean in means.items():
        x, y = samples.index(point.samples), cycles.index(point.cycles)
        shown = f"{_excess(mean, best):.2g}" if mean.value > best else "best"
        ax.text(
            x, y, shown, ha="center", va="center", fontsize=7.5, zorder=3,
            color="white" if norm(_excess(mean, best)) > 0.5 else "black",
        )  # fmt: skip
        if mean.value < reference:
            ax.add_patch(
                Rectangle((x - 0.46, y - 0.46), 0.92, 0.92, fill=False, edgecolor="black",
                          linewidth=1.8)
            )  # fmt: skip
    for line in lines:
        xs = [samples.index(point.samples) for point in line]
        ys = [cycles.index(point.cycles) for point in line]
        ax.plot(xs, ys, linestyle=(0, (4, 3)), color=GRID, linewidth=1.0, zorder=1.5)
    ax.grid(visible=False)
    ax.set_xticks(range(len(samples)), [f"{n:,}" for n in samples])
    ax.set_yticks(range(len(cycles)), [str(c) for c in cycles])
    ax.set_xlabel("samples N")
    ax.set_ylabel("cycles L")
    bar = figure.colorbar(image, ax=ax, pad=0.02)
    bar.set_label("loss above the best cell [%]")
    plain_log(bar.ax.yaxis)


def _lines(ax: Axes, means: Mapping[Point, Estimate], lines: Sequence[Sequence[Point]]) -> None:
    import matplotlib as mpl

    best = min(mean.value for mean in means.values())
    shades = mpl.colormaps["cividis"](np.linspace(0.0, 0.85, max(len(lines), 1)))
    for i, line in enumerate(lines):
        xs = [point.cycles for point in line]
        values = [max(_excess(means[point], best), _FLOOR) for point in line]
        ax.plot(
            xs, values, color=shades[i], marker=MARKERS[i % len(MARKERS)], markersize=5,
            linewidth=1.4, label=f"N × L = {line[0].budget:,}",
        )  # fmt: skip
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(bottom=0.7 * _FLOOR)
    plain_log(ax.xaxis)
    plain_log(ax.yaxis)
    ax.set_xlabel("cycles L (few and wide ← → many and narrow)")
    ax.set_ylabel("loss above the best cell [%]")
    if lines:
        ax.legend(fontsize=8, loc="best")


def _excess(mean: Estimate, best: float) -> float:
    """How much a loss is above the best cell's [%]."""
    return 100 * (mean.value / best - 1)
