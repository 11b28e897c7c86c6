"""Plots of a recording on a robot hand: fingertips, joints and latency of one or more methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.atomic_files import output_error
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS, LANDMARKS, NUM_LANDMARKS, TIPS, WRIST
from smooth_operator.planning import Plan
from smooth_operator.reporting.drawing import (
    GRID,
    INK,
    colors_of,
    legend_entry,
    method_label,
    new_figure,
    plain_logs,
    series,
    styled,
    write_figure,
)
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.types import CommandTrajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Run:
    """Result of one method on the recording of a panel; positions are in the palm frame [m].

    Attributes:
        method: name of the method.
        human: (T, 21, 3) landmarks of the human hand, aligned as for the method; NaN in unusable
            frames.
        robot: (T, 21, 3) the robot's landmarks; NaN for landmarks that it does not have.
        joints: (T, n) joint positions [rad].
        objects: (T, p, 3) points of objects; None without objects.
    """

    method: str
    human: Float[np.ndarray, "T 21 3"]
    robot: Float[np.ndarray, "T 21 3"]
    joints: Float[np.ndarray, "T n"]
    objects: Float[np.ndarray, "T p 3"] | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """One recording on one robot hand, with the results of all methods.

    Attributes:
        key: recording, hand, side.
        hand: the robot hand.
        stamps: (T,) time since the first frame [s].
        runs: the methods that produced commands, at least one.
        edges: pairs of the runs' object points that are joined by a line.
    """

    key: tuple[str, str, str]
    hand: Hand
    stamps: Float[np.ndarray, " T"]
    runs: tuple[Run, ...]
    edges: tuple[tuple[int, int], ...] = ()

    @property
    def tips(self) -> list[int]:
        """Indices of the fingertip landmarks that the robot has, thumb first."""
        return [TIPS[FINGERS.index(finger)] for finger in self.hand.fingers]

    def window(self, seconds: float) -> slice:
        """Frames of the part of the recording, of the given length, in which the human's fingertips
        travel the farthest."""
        tips = self.runs[0].human[:, self.tips] - self.runs[0].human[:, None, WRIST]
        steps = np.linalg.norm(np.diff(tips, axis=0), axis=-1)
        travelled = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps).sum(axis=-1))])
        ends = np.searchsorted(self.stamps, self.stamps + seconds, side="right") - 1
        start = int(np.argmax(travelled[ends] - travelled))
        return slice(start, int(ends[start]) + 1)


def run_of(todo: Plan, commands: CommandTrajectory) -> Run:
    """Makes a run from a plan and its commands."""
    human = align_recording(todo.recording, todo.hand, todo.config.alignment)
    joints = np.asarray(commands.joint_positions, np.float64)
    label = method_label(todo.method, todo.preset)
    return Run(label, human, robot_landmarks(todo.hand, joints), joints)


def robot_landmarks(hand: Hand, joints: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T 21 3"]:
    """Landmarks of a robot hand in the palm frame [m]; NaN for landmarks that the hand does not
    have."""
    robot = np.full((len(joints), NUM_LANDMARKS, 3), np.nan)
    robot[:, [LANDMARKS.index(name) for name in hand.tree.names]] = hand.tree.positions(joints)
    return robot


TRAJECTORY_SECONDS: Final = 4.0
"""Length of the shown trajectories [s]: long enough for a gesture, short enough to see jitter."""

_HUMAN: Final[dict[str, Any]] = {"color": INK, "linewidth": 3.0, "alpha": 0.3, "label": "human"}


def latency_figure(
    samples: Mapping[str, Sequence[Float[np.ndarray, " N"]]], colors: Mapping[str, str]
) -> Figure | None:
    """Plots the latency of each method as a cloud of its frames with p50, p95 and p99, on a
    logarithmic axis.

    The percentiles are means over the percentiles of each recording, as in the tables.

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
    figure = new_figure((8.6, height))
    ax = figure.add_axes((0.17, 0.62 / height, 0.8, 1 - 0.95 / height))
    styles = {"p50": "-", "p95": "--", "p99": ":"}
    spread = np.random.default_rng(0)  # the place of a dot within its strip has no meaning
    for row, (method, measured) in enumerate(times.items()):
        values = np.concatenate(measured)
        at50, at95, at99 = np.mean([np.percentile(v, (50, 95, 99)) for v in measured], axis=0)
        shown = values if len(values) <= 700 else spread.choice(values, 700, replace=False)
        height_of = row + spread.uniform(-0.26, 0.26, len(shown))
        # One path of dots: thousands of markers would make a heavy file.
        ax.plot(
            shown,
            height_of,
            linestyle="",
            marker="o",
            markersize=2.2,
            markeredgewidth=0,
            color=colors[method],
            alpha=0.45,
            rasterized=True,
        )
        for at, style in zip((at50, at95, at99), styles.values(), strict=True):
            ax.plot([at, at], [row - 0.36, row + 0.36], color=INK, linestyle=style, linewidth=1.3)
        ax.annotate(
            f"{at50:.3g}",
            (float(at50), row - 0.38),
            ha="center",
            va="bottom",
            fontsize=8,
        )
    ax.set_xscale("log")
    plain_logs(ax, both=False)
    ax.set_ylim(len(times) - 0.4, -0.75)
    ax.set_yticks(range(len(times)), list(times))
    ax.grid(visible=False, axis="y")
    ax.set_xlabel("latency, landmarks to command [ms]")
    lines = [legend_entry(INK, name, line=style) for name, style in styles.items()]
    figure.legend(handles=lines, ncols=3, loc="upper right", bbox_to_anchor=(0.98, 1.0), fontsize=8)
    return figure


def fingertip_figure(panel: Panel, colors: Mapping[str, str]) -> Figure:
    """Plots x, y, z of each fingertip over a few seconds [mm], for the human and every method."""
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
                    time,
                    1e3 * run.robot[cut, tip, k],
                    color=colors[run.method],
                    linewidth=1.0,
                    label=run.method,
                    gid=series(run.method, run.method),
                )
            if i == 0:
                ax.set_title(axis)
            if k == 0:
                ax.set_ylabel(f"{finger} [mm]")
            if i == rows - 1:
                ax.set_xlabel("time [s]")
    _legend(figure, axes[0, 0])
    return figure


def joint_figure(panel: Panel, colors: Mapping[str, str]) -> Figure:
    """Plots joint positions over a few seconds [rad] for every method, with joint limits."""
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
                time,
                run.joints[cut, j],
                color=colors[run.method],
                linewidth=1.0,
                label=run.method,
                gid=series(run.method, run.method),
            )
        ax.set_title(names[j], fontsize=8)
        if j % columns == 0:
            ax.set_ylabel("[rad]")
        if j + columns >= len(names):
            ax.set_xlabel("time [s]")
            ax.tick_params(labelbottom=True)
    _legend(figure, axes[0, 0])
    return figure


def save_plots(todo: Plan, commands: CommandTrajectory, folder: Path) -> None:
    """Writes the plots of one run: fingertips, joints and, if measured, latency.

    Args:
        folder: folder for the ``.png`` and ``.svg`` files; created if missing.

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


def _grid(
    rows: int,
    columns: int,
    cell: tuple[float, float],
    gap: tuple[float, float],
) -> tuple[Figure, np.ndarray]:
    left, right, top, bottom = 0.62, 0.12, 0.62, 0.5
    width = left + right + columns * cell[0] + (columns - 1) * gap[0]
    height = top + bottom + rows * cell[1] + (rows - 1) * gap[1]
    figure = new_figure((width, height))
    figure.subplots_adjust(
        left=left / width,
        right=1 - right / width,
        top=1 - top / height,
        bottom=bottom / height,
        wspace=gap[0] / cell[0],
        hspace=gap[1] / cell[1],
    )
    return figure, figure.subplots(rows, columns, sharex=True, squeeze=False)


def _legend(figure: Figure, ax: Axes) -> None:
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="upper left",
        ncols=min(len(labels), 9),
        fontsize=8,
        bbox_to_anchor=(0.05, 1.0),
    )
