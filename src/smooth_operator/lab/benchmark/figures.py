"""The plots of a report: accuracy against smoothness, latency, fingertips, joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.atomic_files import output_error
from smooth_operator.lab.benchmark.panels import Panel, run_of
from smooth_operator.lab.benchmark.results import Row, row_method, value_of
from smooth_operator.metrics import METRICS
from smooth_operator.planning import Plan
from smooth_operator.reporting.drawing import (
    GRID,
    INK,
    MARKERS,
    colors_of,
    name_points,
    plain_logs,
    series,
    styled,
    write_figure,
)
from smooth_operator.types import CommandTrajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRAJECTORY_SECONDS: Final = 4.0
"""How much of a recording the trajectories show [s]: enough to see a gesture and the jitter."""

_METRIC: Final = {metric.name: metric for metric in METRICS}
_HUMAN: Final[dict[str, Any]] = {"color": INK, "linewidth": 3.0, "alpha": 0.3, "label": "human"}


def tradeoff_figure(rows: Sequence[Row], colors: Mapping[str, str]) -> Figure | None:
    """Direction error against fingertip acceleration, one point a cell, with means over recordings.

    Both axes are better towards the lower left. None where nothing can be drawn.
    """
    recordings = list(dict.fromkeys(str(row["recording"]) for row in rows if row["metrics"]))
    points: dict[str, list[tuple[float, float, int]]] = {}
    for row in rows:
        cosine = value_of(row, _METRIC["cosine_similarity"])
        rough = value_of(row, _METRIC["fingertip_acceleration"])
        if cosine is not None and rough is not None and rough > 0:
            at = recordings.index(str(row["recording"]))
            points.setdefault(row_method(row), []).append((rough, max(1 - cosine, 1e-6), at))
    if not points:
        return None
    figure = _figure((7.6, 4.6))
    ax = figure.add_axes((0.1, 0.13, 0.63, 0.82))
    means: dict[str, tuple[float, float]] = {}
    for method, own in points.items():
        for rough, error, at in own:
            ax.scatter(
                rough, error, color=colors[method], marker=MARKERS[at % len(MARKERS)], s=42,
                alpha=0.85 if len(own) == 1 else 0.5, linewidths=0,
                gid=series(method, f"{method} on {recordings[at]}: {rough:.3g} m/s², {error:.2g}"),
            )  # fmt: skip
        x, y = (float(np.exp(np.mean(np.log([p[k] for p in own])))) for k in (0, 1))
        if len(own) > 1:
            label = f"{method}, mean of {len(own)} recordings: {x:.3g} m/s², {y:.2g}"
            ax.scatter(
                x, y, color=colors[method], marker="o", s=150, linewidths=0,
                gid=series(method, label),
            )  # fmt: skip
        means[method] = x, y
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("fingertip acceleration [m/s²]   ← smoother")
    ax.set_ylabel("1 − cosine similarity   ← more accurate")
    ax.margins(0.14)
    plain_logs(ax)
    name_points(ax, means)
    handles = [_proxy(colors[m], "o", m) for m in points]
    if len(recordings) > 1:
        handles.append(_proxy(INK, "", ""))
        handles += [
            _proxy(INK, MARKERS[i % len(MARKERS)], _cut(r)) for i, r in enumerate(recordings)
        ]
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.745, 0.97), fontsize=8)
    return figure


def latency_figure(
    samples: Mapping[str, Sequence[Float[np.ndarray, " N"]]], colors: Mapping[str, str]
) -> Figure | None:
    """Latency of each method as a cloud of its frames with p50, p95 and p99; logarithmic.

    The percentiles are means of those of each recording, as tables have them.

    Args:
        samples: method -> its samples on each recording [ms].
        colors: method -> colour.
    """
    times = {
        m: [positive for v in measured if len(positive := v[v > 0])]
        for m, measured in samples.items()
    }
    times = {method: measured for method, measured in times.items() if measured}
    if not times:
        return None
    height = 1.1 + 0.5 * len(times)
    figure = _figure((8.6, height))
    ax = figure.add_axes((0.17, 0.62 / height, 0.8, 1 - 0.95 / height))
    spread = np.random.default_rng(0)  # where dots lie within a strip says nothing
    for row, (method, measured) in enumerate(times.items()):
        values = np.concatenate(measured)
        at50, at95, at99 = np.mean([np.percentile(v, (50, 95, 99)) for v in measured], axis=0)
        shown = values if len(values) <= 700 else spread.choice(values, 700, replace=False)
        height_of = row + spread.uniform(-0.26, 0.26, len(shown))
        # One path of dots: thousands of markers would make a heavy file.
        ax.plot(
            shown, height_of, linestyle="", marker="o", markersize=2.2, markeredgewidth=0,
            color=colors[method], alpha=0.45, rasterized=True,
        )  # fmt: skip
        for at, style in ((at50, "-"), (at95, "--"), (at99, ":")):
            ax.plot([at, at], [row - 0.36, row + 0.36], color=INK, linestyle=style, linewidth=1.3)
        ax.annotate(
            f"{at50:.3g}", (float(at50), row - 0.38), ha="center", va="bottom", fontsize=8,
        )  # fmt: skip
    ax.set_xscale("log")
    plain_logs(ax, both=False)
    ax.set_ylim(len(times) - 0.4, -0.75)
    ax.set_yticks(range(len(times)), list(times))
    ax.grid(visible=False, axis="y")
    ax.set_xlabel("latency, landmarks to command [ms]")
    styles = {"p50": "-", "p95": "--", "p99": ":"}
    lines = [_line(INK, style, name) for name, style in styles.items()]
    figure.legend(handles=lines, ncols=3, loc="upper right", bbox_to_anchor=(0.98, 1.0), fontsize=8)
    return figure


def fingertip_figure(panel: Panel, colors: Mapping[str, str]) -> Figure:
    """x, y, z of each fingertip over a few seconds [mm], human and every method."""
    cut = panel.window(TRAJECTORY_SECONDS)
    time = panel.stamps[cut]
    rows = len(panel.tips)
    figure, axes = _grid(rows, 3, (3.0, 1.3), (0.42, 0.18))
    human = 1e3 * panel.runs[0].human[cut]
    for i, (finger, tip) in enumerate(zip(panel.hand.fingers, panel.tips, strict=True)):
        for k, axis in enumerate("xyz"):
            ax = axes[i, k]
            ax.plot(time, human[:, tip, k], **_HUMAN)
            for run in panel.runs:
                ax.plot(
                    time, 1e3 * run.robot[cut, tip, k], color=colors[run.method], linewidth=1.0,
                    label=run.method, gid=series(run.method, run.method),
                )  # fmt: skip
            if i == 0:
                ax.set_title(axis)
            if k == 0:
                ax.set_ylabel(f"{finger} [mm]")
            if i == rows - 1:
                ax.set_xlabel("time [s]")
    _legend(figure, axes[0, 0])
    return figure


def joint_figure(panel: Panel, colors: Mapping[str, str]) -> Figure:
    """Joints over a few seconds [rad], every method, with the joints' limits."""
    cut = panel.window(TRAJECTORY_SECONDS)
    time, names = panel.stamps[cut], panel.hand.joint_names
    columns = min(4, len(names))
    rows = -(-len(names) // columns)
    figure, axes = _grid(rows, columns, (2.2, 1.15), (0.42, 0.36))
    for j, ax in enumerate(axes.flat):
        if j >= len(names):
            ax.set_axis_off()
            continue
        for limit in panel.hand.joint_limits[j]:
            if np.isfinite(limit):
                ax.axhline(limit, color=GRID, linewidth=1.0, linestyle=(0, (4, 3)))
        for run in panel.runs:
            ax.plot(
                time, run.joints[cut, j], color=colors[run.method], linewidth=1.0,
                label=run.method, gid=series(run.method, run.method),
            )  # fmt: skip
        ax.set_title(names[j], fontsize=8)
        if j % columns == 0:
            ax.set_ylabel("[rad]")
        if j + columns >= len(names):
            ax.set_xlabel("time [s]")
            ax.tick_params(labelbottom=True)
    _legend(figure, axes[0, 0])
    return figure


def save_plots(todo: Plan, commands: CommandTrajectory, folder: Path) -> None:
    """Writes the plots of one run: fingertips, joints and, where it was measured, latency.

    Args:
        folder: folder of the ``.png`` and ``.svg``; made if it is not there.

    Raises:
        OutputError: a file can't be written.
    """
    run = run_of(todo, commands)
    key = (todo.recording.name, todo.hand.name, todo.hand.spec.side)
    panel = Panel(key, todo.hand, todo.recording.stamps - todo.recording.stamps[0], (run,))
    colors = colors_of([run.method])
    with styled():
        drawn = {
            "fingertips": fingertip_figure(panel, colors),
            "joints": joint_figure(panel, colors),
            "latency": latency_figure({run.method: [commands.latency_ms]}, colors),
        }
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error) from error
    for name, figure in drawn.items():
        if figure is not None:
            write_figure(figure, folder / name)


def _figure(size: tuple[float, float]) -> Figure:
    from matplotlib.figure import Figure  # not pyplot: no display, no global list of figures

    return Figure(figsize=size)


def _grid(
    rows: int,
    columns: int,
    cell: tuple[float, float],
    gap: tuple[float, float],
) -> tuple[Figure, np.ndarray]:
    left, right, top, bottom = 0.62, 0.12, 0.62, 0.5
    width = left + right + columns * cell[0] + (columns - 1) * gap[0]
    height = top + bottom + rows * cell[1] + (rows - 1) * gap[1]
    figure = _figure((width, height))
    figure.subplots_adjust(
        left=left / width, right=1 - right / width, top=1 - top / height,
        bottom=bottom / height, wspace=gap[0] / cell[0], hspace=gap[1] / cell[1],
    )  # fmt: skip
    return figure, figure.subplots(rows, columns, sharex=True, squeeze=False)


def _legend(figure: Figure, ax: Axes) -> None:
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="upper left", ncols=min(len(labels), 9), fontsize=8,
        bbox_to_anchor=(0.05, 1.0),
    )  # fmt: skip


def _proxy(color: str, marker: str, label: str) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, marker=marker, linestyle="", markersize=6, label=label)


def _line(color: str, style: Any, label: str) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, linestyle=style, linewidth=1.3, label=label)


def _cut(text: str, length: int = 23) -> str:
    if len(text) > length:  # the ends distinguish recordings
        text = f"{text[: length // 2]}…{text[len(text) + 1 - length // 2 :]}"
    return f" {text}" if text.startswith("_") else text  # a legend would leave it out
