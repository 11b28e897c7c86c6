"""Measures, from a recording, the gap that a tracker reports when an operator's thumb and finger
touch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.calibration.operator_file import OperatorProfile
from smooth_operator.calibration.segments import (
    Features,
    Segment,
    find_segments,
    measure_features,
)
from smooth_operator.landmarks import FINGERS
from smooth_operator.types import HandRecording

SURE: Final = 0.3
"""Confidence below which a pinch is used only if there is no better pinch."""
MOST: Final = 0.6
"""Largest gap of a pinch [palm lengths]."""


@dataclass(frozen=True)
class Finding:
    """Result of the search for pinches with one finger.

    Attributes:
        finger: the finger.
        segments: frames that show the pinches.
        confidence: highest confidence of the segments; 0 without any.
        note: problem and advice; empty without a problem.
    """

    finger: str
    segments: tuple[Segment, ...]
    confidence: float
    note: str


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of a calibration.

    Attributes:
        operator: operator profile to store.
        findings: one for each finger except the thumb.
        features: features of the recording, frame by frame.
        gaps: finger -> (N,) distance from thumb to tip in its pinches [m].
    """

    operator: OperatorProfile
    findings: tuple[Finding, ...]
    features: Features
    gaps: dict[str, Float[np.ndarray, " N"]]


def calibrate(recording: HandRecording, segments: Sequence[Segment] | None = None) -> Calibration:
    """Measures the gap that a tracker reports between thumb and finger when an operator pinches.

    The gap of a finger is the median distance from the thumb in the closest four fifths of the
    frames of its pinches, because an operator may close late or open early.

    Args:
        recording: recording of the operator's hand.
        segments: frames in which pinches are held, as prompts mark them; None to search for them.

    Raises:
        RecordingError: too few frames can be used, or they show the other hand.
    """
    features = measure_features(recording)
    if segments is None:
        segments = find_segments(features, recording.stamps)
    findings, gaps = [], {}
    for i, finger in enumerate(FINGERS[1:]):
        finding = _finding(finger, segments)
        used = [s for s in finding.segments if s.confidence >= min(SURE, finding.confidence)]
        rows = [np.arange(s.start, s.stop) for s in used]
        frames = np.concatenate(rows) if rows else np.empty(0, int)
        gap = features.gaps[frames[features.good[frames]], i]
        if len(gap) and np.median(gap) > MOST * features.palm_length:
            apart = (
                f"thumb and finger stay {1e3 * np.median(gap):.0f} mm apart: this is not a pinch"
            )
            finding = replace(finding, note=apart)
        elif len(gap):
            gaps[finger] = gap[gap <= np.percentile(gap, 80)]
        findings.append(finding)
    found = {f: round(float(np.median(g)) / features.palm_length, 4) for f, g in gaps.items()}
    return Calibration(
        OperatorProfile(recording.side, found, recording.name), tuple(findings), features, gaps
    )


def _finding(finger: str, segments: Sequence[Segment]) -> Finding:
    mine = tuple(s for s in segments if s.finger == finger)
    sure = max((s.confidence for s in mine), default=0.0)
    note = ""
    if not mine:
        note = (
            "no pinch was found, so the tracker's usual gap is used, or the gap is estimated "
            "during use"
        )
    elif sure < SURE:
        note = (
            "a pinch was found, but it is too short or unclear: hold the pinch longer and more "
            "clearly"
        )
    return Finding(finger, mine, sure, note)


def report(calibration: Calibration, recording: HandRecording) -> dict[str, Any]:
    """Content of ``OPERATOR.report.json``."""
    features = calibration.features
    stamps = recording.stamps - recording.stamps[0]
    return {
        "recording": recording.name,
        "side": recording.side,
        "frames": len(recording),
        "frames_used": int(features.good.sum()),
        "duration_s": recording.duration,
        "palm_length_mm": 1e3 * features.palm_length,
        "fingers": {
            finding.finger: {
                "pinch_gap": calibration.operator.pinch_gaps.get(finding.finger),
                "pinch_gap_mm": _spread(calibration.gaps.get(finding.finger)),
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


def _spread(gaps: Float[np.ndarray, " N"] | None) -> dict[str, float] | None:
    """Median and 90th percentile [mm]."""
    if gaps is None:
        return None
    median, high = np.percentile(1e3 * gaps, [50, 90]).tolist()
    return {"median": median, "p90": high}
