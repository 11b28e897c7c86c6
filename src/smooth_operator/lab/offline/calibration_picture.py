"""The picture of a calibration: poses on a time line, reach and pinches before and after."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.atomic_files import atomic_write
from smooth_operator.calibration.estimate import Calibration, closed_gaps
from smooth_operator.errors import require
from smooth_operator.landmarks import FINGER_COLORS, FINGERS
from smooth_operator.types import HandRecording

require("the picture of a calibration", "lab", "matplotlib")

_COLORS: Final = dict(zip(FINGERS, FINGER_COLORS, strict=True))
_POSES: Final = {"flat": "#94a3b8", "spread": "#64748b", "fist": "#334155"}
_BEFORE, _AFTER, _ROBOT = "#cbd5e1", "#64748b", "#0f172a"
_SEEN_MM: Final = 120.0


def draw_calibration(calibration: Calibration, recording: HandRecording, path: Path) -> None:
    """Draws the report of a calibration.

    Args:
        path: the ``.png`` to write.

    Raises:
        OutputError: it can't be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    operator = calibration.operator
    figure = Figure(figsize=(12, 8.4), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 3, height_ratios=(1.5, 0.95, 1.7))
    distances = figure.add_subplot(grid[0, :])
    poses = figure.add_subplot(grid[1, :], sharex=distances)
    _distances(distances, calibration, recording)
    _poses(poses, calibration, recording)
    _reach(figure.add_subplot(grid[2, 0]), calibration)
    _pinches(figure.add_subplot(grid[2, 1]), calibration)
    _tips(figure.add_subplot(grid[2, 2]), calibration)
    used = ", ".join(operator.apply) or "nothing"
    figure.suptitle(
        f"{recording.name} on {operator.hand} {operator.side}: palm scale {operator.scale:.3f}, "
        f"in use: {used}",
        fontsize=12,
    )
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    with atomic_write(path) as file:
        file.write(stream.getvalue())


def _distances(axes: Any, calibration: Calibration, recording: HandRecording) -> None:
    stamps = recording.stamps - recording.stamps[0]
    for i, finger in enumerate(FINGERS[1:]):
        if finger in {f.name for f in calibration.operator.fingers}:
            gap = 1e3 * calibration.features.gaps[:, i]
            axes.plot(stamps, gap, color=_COLORS[finger], lw=1, label=finger)
    axes.set_ylim(0, _SEEN_MM)
    axes.set_ylabel("thumb tip to tip [mm]")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=4, frameon=False, fontsize=9)
    axes.set_title("the operator, as tracked", loc="left", fontsize=10)


def _poses(axes: Any, calibration: Calibration, recording: HandRecording) -> None:
    stamps = recording.stamps - recording.stamps[0]
    names = [finding.pose for finding in calibration.findings]
    for row, finding in enumerate(calibration.findings):
        color = _POSES.get(finding.pose) or _COLORS[finding.pose.removeprefix("pinch_")]
        for segment in finding.segments:
            start, stop = stamps[segment.start], stamps[segment.stop - 1]
            axes.barh(
                row, stop - start, left=start, height=0.75, color=color,
                alpha=0.25 + 0.75 * segment.confidence,
            )  # fmt: skip
        if not finding.segments:
            axes.text(stamps[0], row, " not found", va="center", fontsize=8, color="#dc2626")
    axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names], fontsize=9)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(stamps[0], stamps[-1])
    axes.set_xlabel("time [s]")
    axes.set_title("poses that were found; the paler, the less sure", loc="left", fontsize=10)


def _reach(axes: Any, calibration: Calibration) -> None:
    operator = calibration.operator
    at = np.arange(len(operator.fingers))
    before = [1e3 * f.reach * operator.scale for f in operator.fingers]
    robot = [1e3 * f.robot_reach for f in operator.fingers]
    after = [
        1e3 * f.reach * (f.scale if operator.has("fingers") else operator.scale)
        for f in operator.fingers
    ]
    axes.bar(at - 0.2, before, 0.38, color=_BEFORE, label="aligned")
    axes.bar(at + 0.2, after, 0.38, color=_AFTER, label="calibrated")
    axes.hlines(robot, at - 0.42, at + 0.42, color=_ROBOT, lw=2, label="robot's reach")
    axes.set_xticks(at, [f.name for f in operator.fingers], fontsize=9)
    axes.set_ylim(0, 1.35 * max(*robot, *before))
    axes.set_ylabel("base to tip, straight [mm]")
    axes.legend(frameon=False, fontsize=8, loc="upper right", ncols=3)
    note = "" if operator.has("fingers") else " ('fingers' is not in use)"
    axes.set_title(f"reach{note}", loc="left", fontsize=10)


def _pinches(axes: Any, calibration: Calibration) -> None:
    names = [f.name for f in calibration.operator.fingers[1:]]
    for row, name in enumerate(names):
        gaps = calibration.gaps.get(name)
        closed = closed_gaps(calibration, name)
        if gaps is None or closed is None:
            axes.text(row, 0, "none\nfound", ha="center", va="bottom", fontsize=8, color="#dc2626")
            continue
        for offset, values, color in ((-0.18, gaps[:, 0], _BEFORE), (0.18, closed, _AFTER)):
            box = axes.boxplot(
                1e3 * values, positions=[row + offset], widths=0.3, patch_artist=True,
                showfliers=False, medianprops={"color": _ROBOT},
            )  # fmt: skip
            box["boxes"][0].set_facecolor(color)
    axes.set_xticks(range(len(names)), names, fontsize=9)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.set_ylim(bottom=0)
    axes.set_ylabel("thumb to tip in a pinch [mm]")
    axes.set_title("pinches: tracked (light), left (dark)", loc="left", fontsize=10)


def _tips(axes: Any, calibration: Calibration) -> None:
    operator = calibration.operator
    at = np.arange(len(operator.fingers))
    along = [1e3 * f.tip_along for f in operator.fingers]
    pad = [1e3 * f.tip_pad for f in operator.fingers]
    axes.axhline(0, color=_ROBOT, lw=0.8)
    axes.bar(at - 0.2, along, 0.38, color=_BEFORE, label="along the last bone")
    axes.bar(at + 0.2, pad, 0.38, color=_AFTER, label="to the pad")
    axes.set_xticks(at, [f.name for f in operator.fingers], fontsize=9)
    span = max(2.0, 1.5 * max(map(abs, (*along, *pad))))
    axes.set_ylim(-span, span)
    axes.set_ylabel("offset [mm]")
    axes.legend(frameon=False, fontsize=8, loc="upper right")
    note = "" if operator.has("tips") else " ('tips' is not in use)"
    axes.set_title(f"tip landmark to pad{note}", loc="left", fontsize=10)
