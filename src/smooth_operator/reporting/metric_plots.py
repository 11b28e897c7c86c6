"""Figures of one run. Matplotlib is imported when a figure is drawn; no display is needed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from smooth_operator.errors import ConfigError, OutputError
from smooth_operator.metrics.accuracy import PINCH_DISTANCE
from smooth_operator.metrics.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette for colour-blind readers; widths and dashes differ in grey print.
_HUMAN: Final = {"color": "#E69F00", "linewidth": 1.8, "label": "human (aligned)"}
_ROBOT: Final = {"color": "#0072B2", "linewidth": 1.0, "label": "robot"}
_LIMIT: Final = {"color": "#D55E00", "linewidth": 1.0, "linestyle": (0, (5, 3)), "label": "limits"}
_MARK: Final = "#D55E00"
_SHADE: Final = {"color": "#000000", "alpha": 0.12, "linewidth": 0}
_DPI: Final = 150


def save_plots(trace: Trace, joint_names: Sequence[str], folder: str | Path) -> list[Path]:
    """Writes the figures of a run as PNG: fingertips, joints, latency, thumb distances.

    Args:
        trace: the run.
        joint_names: (n,) names of the columns of ``trace.joint_positions``.
        folder: where to; made if it is not there.

    Returns:
        The files, in the order above.

    Raises:
        ConfigError: if the number of names is not the number of joints.
        OutputError: if a file can't be written.
    """
    figures = {
        "fingertips": fingertip_figure(trace),
        "joints": joint_figure(trace, joint_names),
        "latency": latency_figure(trace),
        "thumb_distances": thumb_distance_figure(trace),
    }
    folder = Path(folder)
    paths = [folder / f"{name}.png" for name in figures]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, figure in zip(paths, figures.values(), strict=True):
            figure.savefig(path, dpi=_DPI)
    except OSError as error:
        raise OutputError(
            f"plots can't be written to {folder}: {error.strerror or error}; "
            "give a folder that can be made and written to"
        ) from error
    return paths


def fingertip_figure(trace: Trace) -> Figure:
    """x, y, z of each fingertip over time [mm], human and robot, in the palm frame."""
    figure, axes = _grid(len(trace.fingers), 3, cell=(3.1, 1.4), gap=(0.5, 0.15))
    human, robot, time = 1e3 * trace.human_tips, 1e3 * trace.robot_tips, _time(trace)
    for i, finger in enumerate(trace.fingers):
        for k, axis in enumerate("xyz"):
            ax = axes[i, k]
            ax.plot(time, human[:, i, k], **_HUMAN)
            ax.plot(time, robot[:, i, k], **_ROBOT)
            ax.grid(alpha=0.25)
            if i == 0:
                ax.set_title(axis, fontweight="bold")
            if k == 0:
                ax.set_ylabel(f"{finger} [mm]")
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    _finish(figure, "Fingertips in the palm frame", axes[0, 0])
    return figure


def joint_figure(trace: Trace, joint_names: Sequence[str]) -> Figure:
    """Joint positions over time [rad] with their limits.

    Raises:
        ConfigError: if the number of names is not the number of joints.
    """
    count = trace.joint_positions.shape[1]
    if len(joint_names) != count:
        raise ConfigError(
            f"joint_names must name the {count} joints of the trace, not {len(joint_names)}"
        )
    columns = min(4, max(count, 1))
    rows = max(1, -(-count // columns))
    figure, axes = _grid(rows, columns, cell=(2.4, 1.25), gap=(0.6, 0.35))
    time = _time(trace)
    for j, ax in enumerate(axes.flat):
        if j >= count:
            ax.set_axis_off()
            continue
        for limit in trace.joint_limits[j]:
            if np.isfinite(limit):
                ax.axhline(limit, **_LIMIT)
        ax.plot(time, trace.joint_positions[:, j], **_ROBOT)
        ax.set_title(joint_names[j], fontsize=9)
        ax.grid(alpha=0.25)
        if j % columns == 0:
            ax.set_ylabel("angle [rad]")
        if j + columns >= count:  # nothing is drawn below it
            ax.set_xlabel("time [s]")
            ax.tick_params(labelbottom=True)
    _finish(figure, "Joint positions and their limits", axes[0, 0])
    return figure


def latency_figure(trace: Trace) -> Figure:
    """Histogram and cumulative share of the latency [ms], with its median and 99th percentile."""
    figure, axes = _grid(1, 2, cell=(4.2, 2.9), gap=(0.75, 0.0))
    left, right = axes[0]
    latency = np.sort(trace.latency_ms[np.isfinite(trace.latency_ms)])
    for ax in (left, right):
        ax.set_xlabel("latency [ms]")
        ax.grid(alpha=0.25)
    left.set_ylabel("commands")
    right.set_ylabel("share of commands")
    if not len(latency):
        left.text(0.5, 0.5, "no latency recorded", ha="center", transform=left.transAxes)
        _finish(figure, "Latency of a command", None)
        return figure
    p50, p99 = np.percentile(latency, [50, 99])
    # A slow first command would squeeze all others into one bin: the view ends just past p99.
    end = min(float(latency[-1]), 1.5 * float(p99)) or 1.0
    beyond = int(np.sum(latency > end))
    left.hist(latency, bins=50, range=(0.0, end), color=str(_ROBOT["color"]), alpha=0.8)
    right.step(
        latency,
        np.arange(1, len(latency) + 1) / len(latency),
        where="post",
        color=str(_ROBOT["color"]),
    )
    for ax in (left, right):
        ax.axvline(p50, color="black", linewidth=1.2, label=f"p50  {p50:.3g} ms")
        ax.axvline(p99, color=_MARK, linewidth=1.2, linestyle="--", label=f"p99  {p99:.3g} ms")
        ax.set_xlim(0.0, end * 1.02)
    right.set_ylim(0.0, 1.02)
    note = f"; {beyond} beyond the view, longest {latency[-1]:.3g} ms" if beyond else ""
    _finish(figure, f"Latency of {len(latency)} commands{note}", left)
    return figure


def thumb_distance_figure(trace: Trace) -> Figure:
    """Thumb tip to fingertip distances over time [mm]; shaded while the human pinches."""
    figure, grid = _grid(len(trace.fingers) - 1, 1, cell=(9.0, 1.5), gap=(0.0, 0.15))
    axes = grid[:, 0]
    human = 1e3 * np.linalg.norm(trace.human_keyvectors[:, trace.thumb_vectors], axis=-1)
    robot = 1e3 * np.linalg.norm(trace.robot_keyvectors[:, trace.thumb_vectors], axis=-1)
    threshold, time = 1e3 * PINCH_DISTANCE, _time(trace)
    for i, ax in enumerate(axes):
        top = max(np.max(d[np.isfinite(d)], initial=threshold) for d in (human[:, i], robot[:, i]))
        ax.fill_between(
            time, 0, 1, where=human[:, i] < threshold, transform=ax.get_xaxis_transform(),
            label="human pinches", **_SHADE,
        )  # fmt: skip
        ax.axhline(threshold, **_LIMIT | {"label": f"pinch threshold, {threshold:.0f} mm"})
        ax.plot(time, human[:, i], **_HUMAN)
        ax.plot(time, robot[:, i], **_ROBOT)
        ax.set_ylim(0.0, 1.08 * top)
        ax.set_ylabel(f"thumb to\n{trace.fingers[i + 1]} [mm]")
        ax.grid(alpha=0.25)
    axes[-1].set_xlabel("time [s]")
    _finish(figure, "Thumb tip to fingertip distances", axes[0])
    return figure


def _grid(
    rows: int, columns: int, cell: tuple[float, float], gap: tuple[float, float]
) -> tuple[Figure, np.ndarray]:
    """A figure and its (rows, columns) axes, sizes in inches as (width, height).

    Margins are set by hand because an automatic layout doubles the time of drawing.
    """
    from matplotlib.figure import Figure  # not pyplot: no global state, no display

    left, right, top, bottom = 0.8, 0.2, 0.65, 0.95
    width = left + right + columns * cell[0] + (columns - 1) * gap[0]
    height = top + bottom + rows * cell[1] + (rows - 1) * gap[1]
    figure = Figure(figsize=(width, height))
    figure.subplots_adjust(
        left=left / width,
        right=1 - right / width,
        top=1 - top / height,
        bottom=bottom / height,
        wspace=gap[0] / cell[0],
        hspace=gap[1] / cell[1],
    )
    return figure, figure.subplots(rows, columns, sharex=True, squeeze=False)


def _finish(figure: Figure, title: str, legend_of: Axes | None) -> None:
    height = figure.get_figheight()
    figure.suptitle(title, fontsize=12, y=1 - 0.12 / height)
    if legend_of is not None:
        handles, labels = legend_of.get_legend_handles_labels()
        once = dict(zip(labels, handles, strict=True))
        figure.legend(
            list(once.values()),
            list(once),
            loc="lower center",
            bbox_to_anchor=(0.5, 0.05 / height),
            ncols=4,
            frameon=False,
        )


def _time(trace: Trace) -> np.ndarray:
    return np.asarray(trace.stamps - trace.stamps[:1])
