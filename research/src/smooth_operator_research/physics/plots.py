"""Plots that measures share: figures of each method with their intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from smooth_operator_research.physics.measure import Drawing
from smooth_operator_research.physics.results import Figure, MeasureResults

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROW: Final = 0.24  # of a method [inch]


def interval_drawings(
    name: str, results: MeasureResults, figures: Sequence[Figure], colors: Mapping[str, str]
) -> list[Drawing]:
    """A plot for each condition: a panel for each figure, a row for each hand and method.

    Args:
        name: of the measure; the files begin with it.
        results: all rows.
        figures: which figures.
        colors: method -> colour.
    """
    conditions = list(dict.fromkeys(condition for _, _, condition in results.panels))
    drawings = []
    for condition in conditions:
        panels = [panel for panel in results.panels if panel[2] == condition]
        words = f" ({condition})" if condition else ""
        caption = (
            f"{', '.join(figure.heading for figure in figures)}{words}: dots are means or shares, "
            "bars their 95 % intervals, small dots the independent units."
        )
        stem = "-".join(filter(None, (name, condition.replace(" ", "-"))))
        drawings.append(Drawing(stem, caption, _plot(panels, results, figures, colors)))
    return drawings


def _plot(
    panels: Sequence[tuple[str, str, str]],
    results: MeasureResults,
    figures: Sequence[Figure],
    colors: Mapping[str, str],
) -> Any:
    from matplotlib.figure import Figure as Plot

    rows = sum(len(results.lines(panel)) + 1 for panel in panels)
    size = (2.6 * len(figures) + 1.6, _ROW * rows + 1.0)
    plot = Plot(figsize=size, layout="constrained")
    axes = plot.subplots(1, len(figures), sharey=True, squeeze=False)[0]
    names: list[tuple[float, str]] = []
    at = 0.0
    for panel in panels:
        hand, side, _ = panel
        names.append((at, f"{hand} {side}"))
        at += 1
        for line in results.lines(panel):
            names.append((at, line.method))
            for ax, figure in zip(axes, figures, strict=True):
                _mark(ax, at, line.summaries[figure.name], colors[line.method])
                if not figure.share:
                    own = [r[figure.name] for r in results.of(panel, line.method)
                           if r.get(figure.name) is not None]  # fmt: skip
                    ax.plot(own, [at] * len(own), ".", color=colors[line.method], alpha=0.35,
                            markersize=3)  # fmt: skip
            at += 1
    for ax, figure in zip(axes, figures, strict=True):
        ax.set_title(" ".join(filter(None, (figure.heading, figure.sign))))
        ax.set_xlabel(figure.unit or ("share" if figure.share else ""))
        ax.set_xlim(left=min(0.0, ax.get_xlim()[0]))
    axes[0].set_yticks([y for y, _ in names], [text for _, text in names])
    axes[0].set_ylim(at - 0.5, -0.7)
    return plot


def _mark(ax: Axes, at: float, summary: Any, color: str) -> None:
    if summary.value is None:
        return
    if summary.low is not None and summary.high is not None:
        ax.plot([summary.low, summary.high], [at, at], color=color, linewidth=2, alpha=0.6)
    ax.plot(summary.value, at, "o", color=color, markersize=5)
