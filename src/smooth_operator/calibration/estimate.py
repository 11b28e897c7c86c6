"""Estimate of an operator's profile from the poses of a recording, with confidences and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.calibration.segments import (
    Features,
    Segment,
    find_segments,
    measure_features,
    poses,
)
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.hands.hand import Hand, StraightPose
from smooth_operator.human.alignment import MIN_CONDITION, palm_alignment
from smooth_operator.human.flat_hand import human_palm_axes, open_rays
from smooth_operator.human.operator import (
    DEFAULT_COMPONENTS,
    Component,
    FingerProfile,
    OperatorProfile,
    tip_frames,
)
from smooth_operator.human.palm import PalmAxes
from smooth_operator.landmarks import BASES, FINGERS, TIPS
from smooth_operator.types import HandRecording

SURE: Final = 0.3
"""Confidence below which a pose is used only if there is no better one."""
MARGIN: Final = 0.005
"""Difference between the gap of a held pinch and the distance at which the latch closes [m]."""
PROJECT: Final = (0.010, 0.020)
"""Limits on the distance at which the latch closes [m]: SBR's published value, and the value from
which it would also close the neighbouring fingers."""
ESCAPE: Final = 1.5
"""Distance at which the latch opens over the distance at which it closes."""

_FRAMES: Final = 300  # largest number of frames per pinching finger, evenly over its segments


@dataclass(frozen=True)
class Finding:
    """The result of one pose.

    Attributes:
        pose: name of the pose.
        segments: frames that show it.
        confidence: highest confidence of the segments; 0 without any.
        note: problem and advice; empty if there is none.
    """

    pose: str
    segments: tuple[Segment, ...]
    confidence: float
    note: str


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of a calibration.

    Attributes:
        operator: the profile.
        findings: one for each pose.
        features: features of the recording, frame by frame.
        segments: all segments of the recording.
        straight: the robot hand with straight fingers.
        gaps: finger -> (N, 2) distance from thumb to tip in pinches, before and after the
            correction of tips [m], at human size.
        rotation_deg: angle between the flat hand's fingers and the robot's straight fingers
            [degrees]; None without a flat hand.
    """

    operator: OperatorProfile
    findings: tuple[Finding, ...]
    features: Features
    segments: tuple[Segment, ...]
    straight: StraightPose
    gaps: dict[str, Float[np.ndarray, "N 2"]]
    rotation_deg: float | None


def calibrate(
    recording: HandRecording,
    hand: Hand,
    segments: Sequence[Segment] | None = None,
    *,
    apply: tuple[Component, ...] = DEFAULT_COMPONENTS,
) -> Calibration:
    """Calibrate an operator for a robot hand.

    Args:
        recording: recording of the operator's hand.
        hand: the robot hand.
        segments: frames in which poses are held, as prompts mark them; None to search for them.
        apply: components that the profile uses; ``tips`` and ``pinch`` have no effect without a
            pinch in the recording.

    Raises:
        ConfigError: the recording is of the other side.
        RecordingError: too few frames can be used, or they show the other hand.
    """
    if recording.side != hand.spec.side:
        raise ConfigError(
            f"a {recording.side} operator can't be calibrated for the {hand.spec.side} hand "
            f"{hand.name!r}: load the {recording.side} one"
        )
    features = measure_features(recording)
    if segments is None:
        segments = find_segments(features, recording.stamps)
    findings = tuple(_finding(pose, segments) for pose in poses(hand.fingers))
    points, scale = _at_human_size(recording, hand, features)
    axes = human_palm_axes(hand)
    pinches = _pinches(points, hand, features, segments)
    offsets = fit_tip_offsets(pinches, axes)
    gaps = {}
    for finger, (frames, _) in pinches.items():
        i = FINGERS.index(finger)
        along, pad = tip_frames(frames, [0, i], axes)
        shift = along * offsets[[0, i], :1] + pad * offsets[[0, i], 1:]
        apart = frames[:, TIPS[i]] - frames[:, TIPS[0]]
        after = apart + shift[:, 1] - shift[:, 0]
        gaps[finger] = np.linalg.norm(np.stack([apart, after], axis=1), axis=-1)
    straight = hand.straight_pose
    rotation, angle = _palm_rotation(points, hand, segments)
    project = _project(gaps, scale, 1 if "tips" in apply else 0)
    operator = OperatorProfile(
        hand=hand.name,
        side=hand.spec.side,
        scale=scale,
        palm_width=features.palm_width,
        palm_length=features.palm_length,
        fingers=_fingers(hand, features, segments, straight, offsets, gaps),
        palm_rotation=rotation,
        project=project,
        escape=None if project is None else project * ESCAPE,
        apply=apply,
        source=recording.name,
    )
    return Calibration(operator, findings, features, tuple(segments), straight, gaps, angle)


def _finding(pose: str, segments: Sequence[Segment]) -> Finding:
    mine = tuple(s for s in segments if s.pose == pose)
    sure = max((s.confidence for s in mine), default=0.0)
    note = ""
    if not mine:
        note = _MISSING["pinch" if pose.startswith("pinch") else pose]
    elif sure < SURE:
        note = "found, but short or indistinct: hold it longer and more clearly"
    return Finding(pose, mine, sure, note)


_MISSING: Final = {
    "flat": "not found: reach is the sum of the bones, and the palm's direction is not known",
    "spread": "not found; nothing depends on it",
    "fist": "not found; nothing depends on it",
    "pinch": "not found: this finger's tip offset is that of the others, if any pinched",
}


def _at_human_size(
    recording: HandRecording, hand: Hand, features: Features
) -> tuple[Float[np.ndarray, "T 21 3"], float]:
    """Landmarks in the palm frame at the size of the human, and the scale of the palm.

    Raises:
        RecordingError: no frame has a usable palm.
    """
    good = features.good
    fit = palm_alignment(np.where(good[:, None, None], recording.landmarks, 0.0), hand)
    usable = good & (np.asarray(fit.condition) >= MIN_CONDITION)
    if not usable.any():
        raise RecordingError(f"{recording.name}: its palm landmarks are collinear in every frame")
    sizes = np.where(usable, np.asarray(fit.scale), 1.0)
    points = fit.apply(recording.landmarks) / sizes[:, None, None]
    scale = float(np.median(np.asarray(fit.scale)[usable]))
    return np.where(usable[:, None, None], points, np.nan), scale


def _used(segments: Sequence[Segment], pose: str) -> list[Segment]:
    """Segments of a pose with enough confidence, else those with the highest confidence."""
    mine = [s for s in segments if s.pose == pose]
    best = max((s.confidence for s in mine), default=0.0)
    return [s for s in mine if s.confidence >= min(SURE, best)]


def _rows(segments: Sequence[Segment], usable: np.ndarray) -> np.ndarray:
    rows = [np.arange(s.start, s.stop) for s in segments]
    frames = np.concatenate(rows) if rows else np.empty(0, int)
    return np.asarray(frames[usable[frames]])


def _pinches(
    points: np.ndarray, hand: Hand, features: Features, segments: Sequence[Segment]
) -> dict[str, tuple[np.ndarray, int]]:
    pinches = {}
    usable = np.isfinite(points).all(axis=(1, 2))
    for finger in hand.fingers[1:]:
        mine = _used(segments, f"pinch_{finger}")
        frames = _rows(mine, usable)
        if len(frames):
            # in a prompted segment the operator may close late or open early
            gap = features.gaps[frames, FINGERS.index(finger) - 1]
            frames = frames[gap <= np.percentile(gap, 80)]
            chosen = np.linspace(0, len(frames) - 1, min(_FRAMES, len(frames))).astype(int)
            pinches[finger] = (points[frames[chosen]], len(mine))
    return pinches


def _fingers(
    hand: Hand,
    features: Features,
    segments: Sequence[Segment],
    straight: StraightPose,
    offsets: np.ndarray,
    gaps: dict[str, np.ndarray],
) -> tuple[FingerProfile, ...]:
    flat = _rows(_used(segments, "flat") + _used(segments, "spread"), features.good)
    fingers = []
    for spec, robot in zip(hand.spec.fingers, straight.reach, strict=True):
        i = FINGERS.index(spec.name)
        length = float(features.bones[i].sum())
        reach = length
        if len(flat):
            reach = length * min(1.0, float(np.percentile(features.straightness[flat, i], 75)))
        gap = gaps.get(spec.name)
        before, after = (None, None) if gap is None else np.median(gap, axis=0).tolist()
        fingers.append(
            FingerProfile(
                name=spec.name,
                robot=spec.tip.body,
                bones=tuple(features.bones[i].tolist()),
                reach=reach,
                robot_reach=float(robot),
                scale=float(robot) / reach,
                tip_along=float(offsets[i, 0]),
                tip_pad=float(offsets[i, 1]),
                pinch_gap=before,
                pinch_gap_after=after,
            )
        )
    return tuple(fingers)


def _project(gaps: dict[str, np.ndarray], scale: float, corrected: int) -> float | None:
    """Distance at which the latch closes, above the corrected gaps of nearly all pinches [m];
    ``corrected`` is the column of gaps: 1 with the correction of tips, 0 without."""
    if not gaps:
        return None
    # the correction of pinches removes the median gap, so only the spread above it remains
    spreads = (
        np.percentile(gap[:, corrected], 90) - np.median(gap[:, corrected]) for gap in gaps.values()
    )
    return float(np.clip(float(max(spreads)) * scale + MARGIN, *PROJECT))


def _palm_rotation(
    points: np.ndarray, hand: Hand, segments: Sequence[Segment]
) -> tuple[tuple[float, float, float, float], float | None]:
    """Smallest rotation from the flat hand's fingers to the robot's: w x y z, and in degrees."""
    usable = np.isfinite(points).all(axis=(1, 2))
    frames = _rows(_used(segments, "flat"), usable)
    if not len(frames):
        return (1.0, 0.0, 0.0, 0.0), None
    long = [FINGERS.index(name) for name in hand.fingers[1:]]
    rays = points[frames][:, [TIPS[i] for i in long]] - points[frames][:, [BASES[i] for i in long]]
    human = _direction(np.median(rays, axis=0))
    robot = _direction(open_rays(hand)[1:])
    cosine = float(np.clip(human @ robot, -1, 1))
    axis = np.cross(human, robot)
    q = np.array([1 + cosine, *axis])
    if np.linalg.norm(q) < 1e-6:  # opposite directions have no unique smallest rotation
        return (1.0, 0.0, 0.0, 0.0), 180.0
    q /= np.linalg.norm(q)
    return (float(q[0]), float(q[1]), float(q[2]), float(q[3])), float(
        np.degrees(np.arccos(cosine))
    )


def _direction(rays: np.ndarray) -> np.ndarray:
    mean = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).mean(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


PRIOR: Final = 0.004
"""Prior standard deviation of an offset about zero [m]."""
DEVIATION: Final = 0.002
"""Prior standard deviation of a long finger's offset about their common one [m]."""
NOISE: Final = 0.002
"""Standard deviation of the gap between the pads in one pinch, by the tracker or in truth [m]."""
LIMIT: Final = 0.02
"""Largest offset [m]."""

_PER_SEGMENT: Final = 2.0  # number of independent frames in a pinch, whose frames are alike
_HUBER: Final = 2.0  # transition of Huber's weights [NOISE]
_ROUNDS: Final = 10


def fit_tip_offsets(
    pinches: Mapping[str, tuple[Float[np.ndarray, "N 21 3"], int]],
    axes: PalmAxes[np.ndarray],
) -> Float[np.ndarray, "5 2"]:
    """Offsets of the tips with which thumb pad and finger pad meet in every pinch.

    In each frame of a pinch, finger tip + offset = thumb tip + offset, each offset a constant in
    the frame of its tip. The long fingers share an offset and differ from it by little, so that a
    finger without a pinch gets the common one; the thumb has its own. This is a least-squares
    problem with a prior, and with Huber's weights against outliers.

    Args:
        pinches: finger -> landmarks of its frames in the palm frame, at human size [m], and the
            number of pinches in them.
        axes: axes of the palm, in that frame.

    Returns:
        (5, 2) offsets along the last bone and toward the pad, thumb first [m]; zeros without any
        pinch.
    """
    if not pinches:
        return np.zeros((5, 2))
    rows, targets, counts = [], [], []
    for finger, (points, times) in pinches.items():
        i = FINGERS.index(finger)
        along, pad = tip_frames(points, [0, i], axes)
        frames = np.stack([along, pad], axis=-1)  # (N, thumb and finger, 3, 2)
        row = np.zeros((len(points), 3, 12))
        row[..., 0:2] = -frames[:, 0]
        row[..., 2:4] = frames[:, 1]  # common offset of the long fingers
        row[..., 2 + 2 * i : 4 + 2 * i] = frames[:, 1]  # deviation of this finger
        rows.append(row)
        targets.append(points[:, TIPS[0]] - points[:, TIPS[i]])
        share = min(1.0, _PER_SEGMENT * times / len(points))
        counts.append(np.full(len(points), share))
    matrix, target = np.concatenate(rows), np.concatenate(targets)
    weight = np.concatenate(counts) / NOISE**2
    prior = np.diag(np.array([PRIOR] * 4 + [DEVIATION] * 8) ** -2.0)
    robust = np.ones(len(target))
    x = np.zeros(12)
    for _ in range(_ROUNDS):
        w = weight * robust
        normal = np.einsum("nki,n,nkj->ij", matrix, w, matrix) + prior
        x = np.linalg.solve(normal, np.einsum("nki,n,nk->i", matrix, w, target))
        off = np.linalg.norm(matrix @ x - target, axis=1)
        robust = np.minimum(1.0, _HUBER * NOISE / np.maximum(off, 1e-12))
    offsets = np.concatenate([x[None, 0:2], x[None, 2:4] + x[4:].reshape(4, 2)])
    return np.asarray(np.clip(offsets, -LIMIT, LIMIT))


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
