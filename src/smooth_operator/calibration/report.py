"""Figures of a calibration for its report: sizes, confidences, gaps before and after."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.calibration.estimate import Calibration
from smooth_operator.types import HandRecording

FEWEST: Final = 10
"""Smallest number of pinch frames for ``closed_gaps``."""


def report(calibration: Calibration, recording: HandRecording) -> dict[str, Any]:
    """Content of ``OPERATOR.report.json``."""
    operator, features = calibration.operator, calibration.features
    stamps = recording.stamps - recording.stamps[0]
    return {
        "recording": recording.name,
        "hand": operator.hand,
        "side": operator.side,
        "frames": len(recording),
        "frames_used": int(features.good.sum()),
        "duration_s": recording.duration,
        "palm_scale": operator.scale,
        "palm_width_mm": 1e3 * operator.palm_width,
        "palm_length_mm": 1e3 * operator.palm_length,
        "palm_rotation_deg": calibration.rotation_deg,
        "project_mm": _mm(operator.project),
        "escape_mm": _mm(operator.escape),
        "apply": operator.apply,
        "fingers": {
            finger.name: {
                "robot": finger.robot,
                "bones_mm": [1e3 * bone for bone in finger.bones],
                "reach_mm": 1e3 * finger.reach,
                "reach_aligned_mm": 1e3 * finger.reach * operator.scale,
                "robot_reach_mm": 1e3 * finger.robot_reach,
                "scale": finger.scale,
                "tip_along_mm": 1e3 * finger.tip_along,
                "tip_pad_mm": 1e3 * finger.tip_pad,
                "pinch_gap_mm": spread_of(calibration.gaps.get(finger.name), 0),
                "pinch_gap_tips_mm": spread_of(calibration.gaps.get(finger.name), 1),
                "pinch_gap_corrected_mm": spread_of(closed_gaps(calibration, finger.name), None),
            }
            for finger in operator.fingers
        },
        "poses": {
            finding.pose: {
                "found": bool(finding.segments),
                "confidence": finding.confidence,
                "note": finding.note,
                "segments": [
                    {
                        "from_s": float(stamps[s.start]),
                        "to_s": float(stamps[s.stop - 1]),
                        "frames": [s.start, s.stop],
                        "confidence": s.confidence,
                    }
                    for s in finding.segments
                ],
            }
            for finding in calibration.findings
        },
    }


def closed_gaps(calibration: Calibration, finger: str) -> Float[np.ndarray, " N"] | None:
    """Gap between thumb and tip that the profile leaves in pinches to which it was not fitted.

    The correction removes the median gap of the frames to which it was fitted. Therefore each half
    of a finger's pinch frames is corrected here by the median of the other half.

    Returns:
        (N,) gaps [m], at human size; None for a finger with fewer than ``FEWEST`` pinch frames.
    """
    gaps, operator = calibration.gaps.get(finger), calibration.operator
    if gaps is None:
        return None
    gap = gaps[:, 1 if operator.has("tips") else 0]
    if not operator.has("pinch"):
        return gap
    if len(gap) < FEWEST:
        return None
    early, late = np.array_split(gap, 2)  # in the order of time
    left = [early - np.median(late), late - np.median(early)]
    return np.asarray(np.maximum(np.concatenate(left), 0.0))


def spread_of(values: np.ndarray | None, column: int | None) -> dict[str, float] | None:
    """Median and 90th percentile [mm]."""
    if values is None:
        return None
    chosen = values if column is None else values[:, column]
    return {
        "median": 1e3 * float(np.median(chosen)),
        "p90": 1e3 * float(np.percentile(chosen, 90)),
    }


def _mm(value: float | None) -> float | None:
    return None if value is None else 1e3 * value
