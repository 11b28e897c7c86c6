"""Figures of the experiments: dots with intervals, grids, lines over conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np

from smooth_operator.reporting.drawing import COLORS, GRID, INK, MARKERS
from smooth_operator_research.paper.solver_grid import Point

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from smooth_operator_research.paper.intervals import Estimate

FAMILY_COLORS: Final = {
    "sampling": "#0072b2",
    "slsqp": "#d55e00",
    "rmsprop": "#009e73",
    "newton": "#cc79a7",
}
"""Colours of Okabe and Ito's palette, which colour-blind readers can distinguish."""

FAMILY_MARKERS: Final = {"sampling": "o", "slsqp": "s", "rmsprop": "^", "newton": "D"}
"""Shapes of markers, so that methods can be told apart without colour."""


def dot(
    ax: Axes,
    y: float,
    mean: Estimate,
    each: Sequence[float] | np.ndarray,
    factor: float,
    style: Mapping[str, Any],
    *,
    bar: bool = True,
) -> None:
    """Draws a mean with its interval, and a tick for each recording."""
    color, own = style["color"], factor * np.asarray(each)
    ax.plot(own, [y] * len(own), "|", color=color, markersize=6, alpha=0.55, zorder=2)
    if bar and mean.low is not None and mean.high is not None:
        ax.plot(
            [factor * mean.low, factor * mean.high], [y, y], color=color, linewidth=1.4, zorder=3
        )
    ax.plot(factor * mean.value, y, zorder=4, **{"linestyle": "", **style})


def name_rows(ax: Axes, labels: Sequence[str]) -> None:
    """Labels the vertical axis with names, and shades every other row."""
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_yticks(range(len(labels)), labels)
    ax.tick_params(axis="y", length=0)
    ax.grid(visible=False, axis="y")
    for row in range(1, len(labels), 2):
        ax.axhspan(row - 0.5, row + 0.5, color=INK, alpha=0.045, linewidth=0)


def plain_log(axis: object) -> None:
    """Labels a logarithmic axis with a few plain numbers."""
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


_FLOOR: Final = 0.003
"""Smallest excess over the best cell that is drawn [%]; smaller differences are chance."""


def compute_figure(
    means: Mapping[Point, Estimate], lines: Sequence[Sequence[Point]], reference: float
) -> Figure:
    """Draws the loss over the grid, and along contours of equal compute.

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
            x,
            y,
            shown,
            ha="center",
            va="center",
            fontsize=7.5,
            zorder=3,
            color="white" if norm(_excess(mean, best)) > 0.5 else "black",
        )
        if mean.value < reference:
            ax.add_patch(
                Rectangle(
                    (x - 0.46, y - 0.46), 0.92, 0.92, fill=False, edgecolor="black", linewidth=1.8
                )
            )
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
            xs,
            values,
            color=shades[i],
            marker=MARKERS[i % len(MARKERS)],
            markersize=5,
            linewidth=1.4,
            label=f"N × L = {line[0].budget:,}",
        )
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
    """Excess of a loss over the best cell's [%]."""
    return 100 * (mean.value / best - 1)


_LIBRARY_COLORS: Final = ("#0072b2", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7f8790")
_SPARE: Final = ("#7a68c7", "#6b9c2f", "#7f8790")


@dataclass(frozen=True)
class Look:
    """Style of a method: presets of one method share a colour and differ by line and fill."""

    color: str
    marker: str
    plain: bool

    @property
    def line(self) -> dict[str, Any]:
        """Line style for matplotlib."""
        return {
            "color": self.color,
            "marker": self.marker,
            "markersize": 4.8,
            "markeredgewidth": 1.1,
            "markerfacecolor": self.color if self.plain else "white",
            "linestyle": "-" if self.plain else (0, (4, 1.6)),
            "linewidth": 1.3,
        }


def looks_of(labels: Sequence[str]) -> dict[str, Look]:
    """Returns a look for each method."""
    families = list(dict.fromkeys([*COLORS, *(label.partition(":")[0] for label in labels)]))
    count = len(COLORS)
    looks = {}
    for label in labels:
        family, _, preset = label.partition(":")
        at = families.index(family)
        color = COLORS.get(family, _SPARE[(at - count) % len(_SPARE)])
        looks[label] = Look(color, MARKERS[at % len(MARKERS)], not preset)
    return looks


def fk_figure(
    batches: Sequence[int],
    mean: Callable[[str, int], Estimate],
    names: Sequence[str],
    gaps: Mapping[str, str],
    libraries: Sequence[str],
) -> Figure:
    """Draws the time per pose over the batch size, one line per library; names missing ones."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    figure = Figure(figsize=(7.6, 4.3))
    ax = figure.add_axes((0.105, 0.2, 0.525, 0.775))
    handles = []
    for name in [*names, *gaps]:
        i = libraries.index(name)  # a library looks alike whichever others are missing
        look = Look(
            _LIBRARY_COLORS[i % len(_LIBRARY_COLORS)] if name not in gaps else GRID,
            MARKERS[i],
            "," not in name,
        )
        if name in gaps:
            why = gaps[name] if len(gaps[name]) < 30 else "can't be used, see below"
            handles.append(Line2D([], [], linestyle="", label=f"{name}: {why}"))
            continue
        means = [mean(name, batch) for batch in batches]
        _line(ax, list(batches), means, 1e-3, look)
        handles.append(Line2D([], [], label=name, **look.line))
    ax.set_xscale("log", base=2)
    ax.set_yscale("log")
    ax.set_xticks(list(batches), [f"{batch:,}" for batch in batches], rotation=35, ha="right")
    ax.set_xticks([], minor=True)
    ax.set_xlabel("poses in a batch")
    ax.set_ylabel("time a pose [µs]")
    plain_log(ax.yaxis)
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.64, 0.985), fontsize=8)
    return figure


class Row(NamedTuple):
    """A row of panels: a metric, its factor to the unit of the axis, the axis; and the human's own
    values by name, which are drawn with the methods."""

    metric: str
    factor: float
    title: str
    log: bool = False
    human: Mapping[str, str] | None = None


class Column(NamedTuple):
    """A column of panels: the axis, the position of each condition on it, the names of the
    conditions in the sweep, and tick labels if the positions are not suitable as labels."""

    title: str
    places: Sequence[float]
    conditions: Sequence[Any]
    log: bool = False
    marks: Sequence[str] = ()


Mean: TypeAlias = "Callable[[str, Any, str], Estimate | None]"


def sweep_figure(
    mean: Mean,
    human: Callable[[Any, str], Estimate | None],
    labels: Sequence[str],
    rows: Sequence[Row],
    columns: Sequence[Column],
) -> Figure:
    """Draws lines with intervals over the conditions, one for each method."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    looks, folded = looks_of(labels), len(columns) == 1
    # one column alone is folded into two, each panel with its own axis
    across, down = (2, -(-len(rows) // 2)) if folded else (len(columns), len(rows))
    gap = 0.85 if folded else 0.2
    width, height = 2.65 + 3.2 * across + gap, 0.75 + 2.05 * down
    figure = Figure(figsize=(width, height))
    axes = figure.subplots(
        down, across, sharex="col", sharey=False if folded else "row", squeeze=False
    )
    panel = (width - 2.55 - gap * (across - 1)) / across
    figure.subplots_adjust(
        left=0.95 / width,
        right=1 - 1.6 / width,
        top=1 - 0.12 / height,
        bottom=0.5 / height,
        wspace=gap / panel,
        hspace=0.1,
    )
    placed = [
        (row, columns[0 if folded else j], axes.flat[i] if folded else axes[i, j])
        for i, row in enumerate(rows)
        for j in range(1 if folded else across)
    ]
    reference = {"color": INK, "linewidth": 3.0, "alpha": 0.3}
    dotted = {**reference, "linewidth": 1.6, "linestyle": ":", "alpha": 0.8}
    handles = [Line2D([], [], label=label, **looks[label].line) for label in labels]
    styles: dict[str, dict[str, Any]] = {}
    for row, column, ax in placed:
        spread = _spread(column, len(labels))
        for i, label in enumerate(labels):
            means = [mean(label, condition, row.metric) for condition in column.conditions]
            _line(ax, [spread(x, i) for x in column.places], means, row.factor, looks[label])
        for name, metric in (row.human or {}).items():
            styles.setdefault(name, dotted if styles else reference)
            own = [human(condition, metric) for condition in column.conditions]
            points = [(x, e) for x, e in zip(column.places, own, strict=True) if e is not None]
            ax.plot(
                [x for x, _ in points],
                [row.factor * e.value for _, e in points],
                zorder=1,
                **styles[name],
            )
        _axes(ax, row, column, folded or ax in axes[:, 0], ax in axes[-1])
    for row, _, ax in placed:
        if row.log:  # at last: a second panel that becomes logarithmic undoes it
            plain_log(ax.yaxis)
    handles += [Line2D([], [], label=name, **style) for name, style in styles.items()]
    figure.legend(
        handles=handles,
        loc="upper left",
        fontsize=8,
        borderpad=0.0,
        bbox_to_anchor=(1 - 1.55 / width, 1 - 0.1 / height),
    )
    return figure


def _spread(column: Column, count: int) -> Callable[[float, int], float]:
    """Shifts the methods slightly, so that their intervals don't hide each other."""
    if column.log:
        return lambda x, i: float(x * 1.012 ** (i - (count - 1) / 2))
    step = (max(column.places) - min(column.places)) / 300
    return lambda x, i: x + step * (i - (count - 1) / 2)


def _axes(ax: Axes, row: Row, column: Column, first: bool, last: bool) -> None:
    if row.log:
        ax.set_yscale("log")
    if column.log:
        ax.set_xscale("log")
    marks = column.marks or [f"{x:g}" for x in column.places]
    ax.set_xticks(list(column.places), list(marks))
    ax.set_xticks([], minor=True)
    if first:
        ax.set_ylabel(row.title)
    if last:
        ax.set_xlabel(column.title)


def _line(
    ax: Axes,
    places: Sequence[float],
    estimates: Sequence[Estimate | None],
    factor: float,
    look: Look,
) -> None:
    points = [(x, e) for x, e in zip(places, estimates, strict=True) if e is not None]
    for x, e in points:
        if e.low is not None and e.high is not None:
            ends = [factor * e.low, factor * e.high]
            ax.plot([x, x], ends, color=look.color, linewidth=1.0, alpha=0.5, zorder=2)
    ax.plot([x for x, _ in points], [factor * e.value for _, e in points], zorder=3, **look.line)


class Panel(NamedTuple):
    """One metric of the benchmark's table.

    Attributes:
        title: title of the axis.
        log: True for a logarithmic axis.
        factor: factor to the unit of the axis.
        means: method -> our mean.
        each: method -> values of the recordings.
        paper: method -> value in the paper.
        goal: best possible value, or None.
    """

    title: str
    log: bool
    factor: float
    means: Mapping[str, Estimate | None]
    each: Mapping[str, Sequence[float]]
    paper: Mapping[str, float]
    goal: float | None = None


def table_figure(panels: Sequence[Panel], labels: Sequence[str]) -> Figure:
    """Draws dots with intervals, a row for each method and a panel for each metric; diamonds are
    the paper's values."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    looks, columns = looks_of(labels), 3
    rows = -(-len(panels) // columns)
    height = 0.45 + rows * (0.75 + 0.245 * len(labels))
    figure = Figure(figsize=(9.6, height))
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
    figure.subplots_adjust(
        left=0.13,
        right=0.985,
        top=1 - 0.36 / height,
        bottom=0.52 / height,
        wspace=0.08,
        hspace=0.62 / (0.245 * len(labels)),
    )
    for ax, panel in zip(axes.flat, panels, strict=False):
        for y, label in enumerate(labels):
            if label in panel.paper:
                ax.plot(
                    panel.factor * panel.paper[label],
                    y,
                    "D",
                    color=INK,
                    markersize=8,
                    markerfacecolor="none",
                    markeredgewidth=1.0,
                    zorder=2,
                )
            if (mean := panel.means[label]) is not None:
                style = {**looks[label].line, "linestyle": "", "markersize": 6.0}
                dot(ax, y, mean, panel.each[label], panel.factor, style)
        if panel.log:
            ax.set_xscale("log")
            plain_log(ax.xaxis)
        if panel.goal is not None:
            ax.axvline(panel.goal, color=GRID, linewidth=1.0, linestyle=(0, (4, 3)))
        ax.set_xlabel(panel.title)
        name_rows(ax, labels)
    keys = [
        Line2D([], [], color=INK, linestyle="", marker="o", label="here, mean of recordings"),
        Line2D([], [], color=INK, linestyle="", marker="|", label="here, each recording"),
        Line2D(
            [],
            [],
            color=INK,
            linestyle="",
            marker="D",
            markerfacecolor="none",
            label="in the paper, on other data",
        ),
    ]
    figure.legend(handles=keys, loc="upper left", bbox_to_anchor=(0.12, 1.0), ncols=3, fontsize=8)
    return figure
