"""Draws the picture of a calibration: distances from the thumb, and the detected pinches."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.atomic_files import atomic_write
from smooth_operator.calibration.estimate import Calibration
from smooth_operator.errors import require
from smooth_operator.landmarks import FINGER_COLORS, FINGERS
from smooth_operator.types import HandRecording

require("the picture of a calibration", "teleop", "matplotlib")

_COLORS: Final = dict(zip(FINGERS, FINGER_COLORS, strict=True))
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

    figure = Figure(figsize=(12, 5), layout="constrained")
    FigureCanvasAgg(figure)
    distances, pinches = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    _distances(distances, calibration, recording)
    _pinches(pinches, calibration, recording)
    figure.suptitle(f"{recording.name}, {recording.side} hand", fontsize=12)
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    with atomic_write(path) as file:
        file.write(stream.getvalue())


def _distances(axes: Any, calibration: Calibration, recording: HandRecording) -> None:
    stamps = recording.stamps - recording.stamps[0]
    for i, finding in enumerate(calibration.findings):
        color, gaps = _COLORS[finding.finger], calibration.gaps.get(finding.finger)
        name = finding.finger
        if gaps is not None:
            gap = 1e3 * float(np.median(gaps))
            name = f"{name}: closes at {gap:.1f} mm"
            axes.axhline(gap, color=color, lw=1, ls=":")
        axes.plot(stamps, 1e3 * calibration.features.gaps[:, i], color=color, lw=1, label=name)
    axes.set_ylim(0, _SEEN_MM)
    axes.set_ylabel("thumb tip to tip [mm]")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=4, frameon=False, fontsize=9)
    axes.set_title("the operator's hand, as tracked", loc="left", fontsize=10)


def _pinches(axes: Any, calibration: Calibration, recording: HandRecording) -> None:
    stamps = recording.stamps - recording.stamps[0]
    for row, finding in enumerate(calibration.findings):
        for segment in finding.segments:
            start, stop = stamps[segment.start], stamps[segment.stop - 1]
            axes.barh(
                row,
                stop - start,
                left=start,
                height=0.75,
                color=_COLORS[finding.finger],
                alpha=0.25 + 0.75 * segment.confidence,
            )
        if not finding.segments:
            axes.text(stamps[0], row, " not found", va="center", fontsize=8, color="#dc2626")
    names = [finding.finger for finding in calibration.findings]
    axes.set_yticks(range(len(names)), names, fontsize=9)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(stamps[0], stamps[-1])
    axes.set_xlabel("time [s]")
    axes.set_title("detected pinches; paler bars are less certain", loc="left", fontsize=10)
