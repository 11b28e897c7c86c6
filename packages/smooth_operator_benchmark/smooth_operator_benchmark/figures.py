"""Plots for a benchmark's report, and the data of its animated clips."""

from __future__ import annotations

import base64
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import BASES, BONES, LANDMARKS, WRIST
from smooth_operator.metrics import METRICS
from smooth_operator.reporting.drawing import (
    GRID,
    INK,
    MARKERS,
    legend_entry,
    new_figure,
    plain_logs,
    series,
)
from smooth_operator.reporting.run_plots import Panel, run_of
from smooth_operator.teleop.pages.hand_view import view_basis
from smooth_operator_benchmark.cells import Cell
from smooth_operator_benchmark.quality import Measured
from smooth_operator_benchmark.suite import Finished, Row, row_method, value_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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


_METRIC: Final = {metric.name: metric for metric in METRICS}


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
    figure = new_figure((7.6, 4.6))
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
    handles = [legend_entry(colors[m], m, "o") for m in points]
    if len(recordings) > 1:
        handles.append(legend_entry(INK, ""))
        handles += [
            # A legend leaves out a text that begins with an underscore.
            legend_entry(INK, re.sub("^_", " _", shortened(r)), MARKERS[i % len(MARKERS)])
            for i, r in enumerate(recordings)
        ]
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.745, 0.97), fontsize=8)
    return figure


def name_points(ax: Axes, points: Mapping[str, tuple[float, float]], size: float = 9.0) -> None:
    """Labels each point where there is room. Call it only when the axis limits and the layout no
    longer change.

    Args:
        points: name -> x and y of the data.
        size: size of the letters [points].
    """
    line, letter, aside = 1.22 * size, 0.62 * size, 0.8 * size
    scale = 72.0 / ax.figure.dpi
    places = {name: scale * ax.transData.transform(point) for name, point in points.items()}
    covered = [(x - 4.0, y - 4.0, 8.0, 8.0) for x, y in places.values()]
    (x0, y0), (x1, y1) = scale * ax.bbox.get_points()
    shifts = [sign * 0.25 * line * k for k in range(29) for sign in (1, -1)]
    for name, (x, y) in sorted(places.items(), key=lambda item: -item[1][1]):
        width = letter * len(name)
        boxes = [
            (left, y - 0.4 * size + shift, width, line)
            for shift in shifts
            for left in (x + aside, x - aside - width)
        ]
        within = [
            box
            for box in boxes
            if x0 <= box[0] and box[0] + width <= x1 and y0 <= box[1] and box[1] + line <= y1
        ]
        free = (box for box in within if not any(_meet(box, other) for other in covered))
        box = next(free, (within or boxes)[0])
        covered.append(box)
        far = abs(box[1] + 0.4 * size - y) > line
        ax.annotate(
            name,
            points[name],
            textcoords="offset points",
            fontsize=size,
            xytext=(box[0] - x, box[1] + 0.2 * size - y),
            arrowprops={"arrowstyle": "-", "color": GRID, "linewidth": 0.5} if far else None,
        )


def _meet(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """True if two boxes (left, low, width, height) overlap."""
    return all(one[k] < other[k] + other[k + 2] and other[k] < one[k] + one[k + 2] for k in (0, 1))


def shortened(text: str) -> str:
    """Shortens a text to 22 characters. Keeps both ends, because they distinguish recordings."""
    return text if len(text) <= 22 else f"{text[:10]}…{text[-11:]}"
