"""Plots for a benchmark's report, and the data of its animated clips."""

from __future__ import annotations

import base64
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.atomic_files import output_error
from smooth_operator.benchmark.cells import Cell, method_label
from smooth_operator.benchmark.quality import Measured
from smooth_operator.benchmark.suite import Finished, Row, row_method, value_of
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import BASES, BONES, FINGERS, LANDMARKS, NUM_LANDMARKS, TIPS, WRIST
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
from smooth_operator.reporting.hand_surface import view_basis
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


def make_panels(finished: Iterable[Finished]) -> Iterator[Panel]:
    """Yields the panels of a benchmark, in the order of its cells; failed cells are left out."""
    groups: dict[tuple[str, str, str], list[tuple[Cell, Measured]]] = {}
    for one in finished:
        if one.measured is not None:
            groups.setdefault(one.cell.key[:3], []).append((one.cell, one.measured))
    for key, group in groups.items():
        cell = group[0][0]
        assert cell.source.recording is not None  # or there would be no commands
        hand = load_hand(cell.hand, cell.side, fingers=cell.fingers)
        stamps = cell.source.recording.stamps
        runs = tuple(run_of(each.plan(0), measured.commands) for each, measured in group)
        yield Panel(key, hand, stamps - stamps[0], runs)


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


def robot_bones(hand: Hand) -> list[tuple[int, int]]:
    """Bones of the robot's skeleton as (parent, child) landmarks, without landmarks that the robot
    lacks."""
    present = {LANDMARKS.index(name) for name in hand.tree.names}
    bones: list[tuple[int, int]] = []
    for base in BASES:
        chain = [WRIST, *(i for i in range(base, base + 4) if i in present)]
        bones += itertools.pairwise(chain)
    return bones


SECONDS: Final = 8.0
RATE_HZ: Final = 30.0
BUDGET: Final = 12_000_000
"""Largest total size of all clips of a page [bytes]; with many clips, each has fewer frames."""
MIN_FRAMES: Final = 40

_UNIT: Final = 1e-4
"""Resolution of the packed numbers [m]."""
_ABSENT: Final = -32768
_POINTS: Final = 21 * 3 * 2 * 4 / 3  # bytes of one hand in one frame, in base64


def make_clip(panel: Panel, colors: Mapping[str, str], hands: int) -> dict[str, Any]:
    """Makes the animated clip of one panel for the player, ready to be written as JSON.

    Args:
        colors: method -> colour.
        hands: number of hands in all clips of the page, which share the budget.

    Returns:
        ``times`` of the frames [s]; ``humans`` and ``robots``, each (frames, 21, 3) int16 in base64
        little-endian, in units of 0.1 mm about the middle of the clip, turned so that x is right, y
        up and z towards the viewer; -32768 marks missing points; each method's ``objects``,
        (frames, points, 3), if there are any; and instructions to draw them.
    """
    cut = panel.window(SECONDS)
    stamps = panel.stamps[cut]
    allowed = max(MIN_FRAMES, int(BUDGET / (max(hands, 1) * _POINTS)))
    duration = float(stamps[-1] - stamps[0])
    count = min(len(stamps), allowed, max(2, int(duration * RATE_HZ) + 1))
    times = np.linspace(stamps[0], stamps[-1], count)
    chosen = np.unique(np.searchsorted(stamps, times).clip(0, len(stamps) - 1)) + cut.start

    basis = view_basis(panel.hand)
    humans: list[np.ndarray] = []
    panes: list[dict[str, Any]] = []
    drawn = [run.robot[chosen] @ basis.T for run in panel.runs]
    points = np.concatenate([panel.runs[0].human[chosen] @ basis.T, *drawn]).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=-1)]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2 if len(points) else np.zeros(3)
    reach = float(np.linalg.norm(points - middle, axis=-1).max()) if len(points) else 0.1
    for run, robot in zip(panel.runs, drawn, strict=True):
        human = run.human[chosen] @ basis.T
        # Methods that align alike share one human.
        same = (i for i, h in enumerate(humans) if np.array_equal(h, human, equal_nan=True))
        at = next(same, None)
        if at is None:
            at = len(humans)
            humans.append(human)
        panes.append(
            {
                "method": run.method,
                "color": colors[run.method],
                "human": at,
                "robot": _packed(robot - middle),
                "objects": None
                if run.objects is None
                else _packed(run.objects[chosen] @ basis.T - middle),
            }
        )
    objects = [run.objects.shape[1] for run in panel.runs if run.objects is not None]
    return {
        "times": [round(float(t), 3) for t in panel.stamps[chosen]],
        "reach": round(reach / _UNIT),
        "humans": [_packed(human - middle) for human in humans],
        "humanBones": [list(bone) for bone in BONES],
        "robotBones": [list(bone) for bone in robot_bones(panel.hand)],
        "objectPoints": max(objects, default=0),
        "objectEdges": [list(edge) for edge in panel.edges],
        "panes": panes,
    }


def _packed(points: Float[np.ndarray, "F k 3"]) -> str:
    finite = np.isfinite(points)
    units = np.rint(np.where(finite, points, 0.0) / _UNIT).clip(-32767, 32767)
    return base64.b64encode(np.where(finite, units, _ABSENT).astype("<i2").tobytes()).decode()


TRAJECTORY_SECONDS: Final = 4.0
"""Length of the shown trajectories [s]: long enough for a gesture, short enough to see jitter."""

_METRIC: Final = {metric.name: metric for metric in METRICS}
_HUMAN: Final[dict[str, Any]] = {"color": INK, "linewidth": 3.0, "alpha": 0.3, "label": "human"}


def tradeoff_figure(rows: Sequence[Row], colors: Mapping[str, str]) -> Figure | None:
    """Plots direction error against fingertip acceleration, one point per cell, with means over
    recordings.

    Better methods are towards the lower left. None if there is nothing to draw.
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
                rough,
                error,
                color=colors[method],
                marker=MARKERS[at % len(MARKERS)],
                s=42,
                alpha=0.85 if len(own) == 1 else 0.5,
                linewidths=0,
                gid=series(method, f"{method} on {recordings[at]}: {rough:.3g} m/s², {error:.2g}"),
            )
        x, y = (float(np.exp(np.mean(np.log([p[k] for p in own])))) for k in (0, 1))
        if len(own) > 1:
            label = f"{method}, mean of {len(own)} recordings: {x:.3g} m/s², {y:.2g}"
            ax.scatter(
                x,
                y,
                color=colors[method],
                marker="o",
                s=150,
                linewidths=0,
                gid=series(method, label),
            )
        means[method] = x, y
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("fingertip acceleration [m/s²]   ← smoother")
    ax.set_ylabel("1 − cosine similarity   ← more accurate")
    ax.margins(0.14)
    plain_logs(ax)
    name_points(ax, means)
    handles = [_key(colors[m], m, "o") for m in points]
    if len(recordings) > 1:
        handles.append(_key(INK, ""))
        handles += [
            # A legend leaves out a text that begins with an underscore.
            _key(INK, re.sub("^_", " _", shortened(r)), MARKERS[i % len(MARKERS)])
            for i, r in enumerate(recordings)
        ]
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.745, 0.97), fontsize=8)
    return figure


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
    figure = _figure((8.6, height))
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
    lines = [_key(INK, name, line=style) for name, style in styles.items()]
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


def _key(color: str, label: str, marker: str = "", line: str = "") -> Any:
    """Entry of a legend."""
    from matplotlib.lines import Line2D

    style: dict[str, Any] = {"marker": marker, "markersize": 6, "linestyle": line, "linewidth": 1.3}
    return Line2D([], [], color=color, label=label, **style)


def shortened(text: str) -> str:
    """Shortens a text to 22 characters. Keeps both ends, because they distinguish recordings."""
    return text if len(text) <= 22 else f"{text[:10]}…{text[-11:]}"
