"""The report of a data set: a page with counts, reasons and histograms of the quality figures."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from smooth_operator.lab.datasets.clip import RobotClip
from smooth_operator.lab.datasets.filters import Dropped
from smooth_operator.lab.datasets.quality import FIGURES, worst
from smooth_operator.reporting.html import Html
from smooth_operator.reporting.report_page import Plots, templates, write_report_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PERCENTILES: Final = (1, 5, 50, 95, 99)
_LIMIT_OF: Final = {
    "jump_m_s": "max_jump",
    "confidence": "min_confidence",
    "valid": "min_valid",
    "gap_s": "max_gap",
    "collision": "max_collision",
    "tip_error_mm": "max_tip_error",
    "reach": "min_reach",
}
_SHOWN: Final = 200
_KEPT: Final = "#0072B2"
_DROPPED: Final = "#D55E00"
_COLUMNS: Final = 3


class FigureTable:
    """The figures of all episodes, of the hand that is worse off: 4 bytes each."""

    def __init__(self) -> None:
        self.kept: dict[str, array[float]] = {}
        self.dropped: dict[str, array[float]] = {}

    def add(self, episode: RobotClip | Dropped) -> None:
        """Takes the figures of an episode."""
        table = self.dropped if isinstance(episode, Dropped) else self.kept
        if not episode.figures:
            return
        for figure in FIGURES:
            value = worst(episode.figures, figure.name)
            if value is not None:
                table.setdefault(figure.name, array("f")).append(value)
        table.setdefault("seconds", array("f")).append(episode.figures["seconds"])

    def extend(self, other: FigureTable) -> None:
        """Takes the figures of another table."""
        for own, more in ((self.kept, other.kept), (self.dropped, other.dropped)):
            for name, values in more.items():
                own.setdefault(name, array("f")).extend(values)

    def percentiles(self) -> dict[str, dict[str, float]]:
        """Name of figure -> percentiles over the episodes that are kept."""
        result = {}
        for name, values in self.kept.items():
            at = np.percentile(np.asarray(values), _PERCENTILES)
            result[name] = {
                f"p{p}": round(float(v), 6) for p, v in zip(_PERCENTILES, at, strict=True)
            }
        return result


def write_report(output: Path, content: Mapping[str, Any], figures: FigureTable) -> None:
    """Writes ``report.html`` and the histograms, as ``plots/quality.png`` and ``.svg``.

    Without matplotlib there are no histograms.

    Args:
        content: content of ``report.json``.

    Raises:
        OutputError: a file can't be written.
    """
    try:
        drawn = _histograms(figures, content["limits"])
    except ImportError:
        drawn = None
    plot = Plots(output / "plots").element(drawn, "quality", "Quality figures of the episodes")
    template = templates("smooth_operator.lab.datasets").get_template("report.html.j2")
    macros: Any = template.make_module(
        {
            **content,
            "plot": plot,
            "percentages": [f"{p} %" for p in _PERCENTILES],
            "measures": {figure.name: figure for figure in FIGURES},
            "shown": _SHOWN,
        }
    )
    sections = [
        (title, anchor, Html(str(section())))
        for title, anchor, section in (
            ("Counts", "counts", macros.counts),
            ("Why episodes were dropped", "reasons", macros.dropped_for),
            ("Quality", "quality", macros.quality),
            ("Could not be read or retargeted", "failed", macros.failures),
        )
    ]
    write_report_page(
        output / "report.html",
        f"{content['episodes']} episodes of {content['hand']}",
        Html(str(macros.heading())),
        sections,
        f"smooth-operator {content['version']}",
    )


def _histograms(figures: FigureTable, limits: Mapping[str, Any]) -> Figure | None:
    """A histogram of each figure, kept over dropped episodes; None where there is none."""
    from matplotlib.figure import Figure  # not pyplot: no global state, no display

    shown = [f for f in FIGURES if f.name in figures.kept or f.name in figures.dropped]
    if not shown:
        return None
    rows = -(-len(shown) // _COLUMNS)
    drawn = Figure(figsize=(3.2 * _COLUMNS, 2.1 * rows))
    # By hand: an automatic layout takes as long as the drawing.
    gap, edge = 0.55, 0.3 / rows
    drawn.subplots_adjust(0.05, 0.6 * edge, 0.98, 1.0 - edge, wspace=0.25, hspace=gap)
    axes = np.atleast_1d(drawn.subplots(rows, _COLUMNS)).ravel()
    for ax, figure in zip(axes, shown, strict=False):
        parts = [
            np.asarray(table.get(figure.name, ())) for table in (figures.kept, figures.dropped)
        ]
        values = np.concatenate(parts)
        top = float(np.percentile(values, 99.0)) * 1.1  # a few odd ones do not squeeze the others
        bins = np.linspace(min(0.0, float(values.min())), top or 1.0, 31)
        clipped = [np.clip(part, bins[0], bins[-1]) for part in parts]
        counts = [np.histogram(part, bins)[0] for part in clipped]
        ax.stairs(counts[0], bins, fill=True, color=_KEPT)
        ax.stairs(counts[0] + counts[1], bins, baseline=counts[0], fill=True, color=_DROPPED)
        limit = limits.get(_LIMIT_OF.get(figure.name, ""))
        if isinstance(limit, int | float) and bins[0] <= limit <= bins[-1]:
            ax.axvline(limit, color="black", linestyle="--", linewidth=1.0)
        unit = f" [{figure.unit}]" if figure.unit else ""
        ax.set_title(f"{figure.name}{unit}", fontsize=9)
        ax.tick_params(labelsize=8)
    for ax in axes[len(shown) :]:
        ax.set_axis_off()
    return drawn
