"""Estimates an operator's profile from poses, with a confidence for each figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.calibration.features import Features, measure_features
from smooth_operator.calibration.segments import Segment, find_segments, poses
from smooth_operator.calibration.tips import fit_tip_offsets
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.straight_pose import StraightPose, straight_pose
from smooth_operator.human.alignment import MIN_CONDITION, palm_alignment
from smooth_operator.human.operator import (
    DEFAULT_COMPONENTS,
    Component,
    FingerProfile,
    OperatorProfile,
    tip_frames,
)
from smooth_operator.human.palm_axes import human_palm_axes
from smooth_operator.landmarks import BASES, FINGERS, TIPS
from smooth_operator.types import HandRecording

SURE: Final = 0.3
"""A pose of less confidence is reported, but used only if there is no better one."""
MARGIN: Final = 0.005
"""From where pinches are held to where the latch closes [m]."""
PROJECT: Final = (0.010, 0.020)
"""The latch closes at no less than the first, which SBR publishes, and no more than the second,
where the pads' neighbours would be closed with them [m]."""
ESCAPE: Final = 1.5
"""The latch opens at so many times the distance at which it closes."""

_FRAMES: Final = 300  # of one pinch finger, evenly over its segments, that are looked at


@dataclass(frozen=True)
class Finding:
    """The result of one pose.

    Attributes:
        pose: its name.
        segments: where it was found.
        confidence: of the surest segment; 0 where there is none.
        note: what to do about it; empty where there is nothing.
    """

    pose: str
    segments: tuple[Segment, ...]
    confidence: float
    note: str


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration found.

    Attributes:
        operator: the profile.
        findings: one for each pose that was looked for.
        features: of the recording, frame by frame.
        segments: all that were used or found.
        straight: the robot's side.
        gaps: finger -> (N, 2) thumb to tip in pinches, before and after [m], at human size.
        rotation_deg: how far the flat hand and the robot's straight fingers are apart [degrees];
            None without a flat hand.
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
    """Calibrates an operator for a robot hand.

    Args:
        recording: the operator's hand.
        hand: the robot's.
        segments: where which pose is held, as prompts mark it; None to find out.
        apply: which components the profile shall use; ``tips`` and ``pinch`` do nothing where no
            pinch was found.

    Raises:
        ConfigError: the recording is of the other side.
        RecordingError: hardly a frame can be used, or it is the other hand's after all.
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
    straight = straight_pose(hand)
    rotation, angle = _palm_rotation(points, straight, hand, features, segments)
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
    """Landmarks turned into the palm frame, at the size of the human; and the palm's scale.

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
    """The sure segments of a pose, or, where none is, the surest."""
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
            # Not all of a prompted pinch is one: the operator takes a while, or opens early.
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
    """Where the latch closes: over what nearly all pinches are held at, once they are corrected.

    Args:
        gaps: as ``Calibration.gaps``.
        scale: of the palm.
        corrected: 1 if tips are, 0 if not.
    """
    if not gaps:
        return None
    # The middle one of what is left is closed; the spread about it stays.
    left = (
        np.percentile(gap[:, corrected], 90) - np.median(gap[:, corrected]) for gap in gaps.values()
    )
    return float(np.clip(float(max(left)) * scale + MARGIN, *PROJECT))


def _palm_rotation(
    points: np.ndarray,
    straight: StraightPose,
    hand: Hand,
    features: Features,
    segments: Sequence[Segment],
) -> tuple[tuple[float, float, float, float], float | None]:
    """The least turn of the flat hand's fingers into the robot's, as w x y z and in degrees."""
    usable = np.isfinite(points).all(axis=(1, 2))
    frames = _rows(_used(segments, "flat"), usable)
    if not len(frames):
        return (1.0, 0.0, 0.0, 0.0), None
    long = [FINGERS.index(name) for name in hand.fingers[1:]]
    rays = points[frames][:, [TIPS[i] for i in long]] - points[frames][:, [BASES[i] for i in long]]
    human = _direction(np.median(rays, axis=0))
    robot = _direction(straight.rays[1:])
    cosine = float(np.clip(human @ robot, -1, 1))
    axis = np.cross(human, robot)
    q = np.array([1 + cosine, *axis])
    if np.linalg.norm(q) < 1e-6:  # opposite: no least turn
        return (1.0, 0.0, 0.0, 0.0), 180.0
    q /= np.linalg.norm(q)
    return (float(q[0]), float(q[1]), float(q[2]), float(q[3])), float(
        np.degrees(np.arccos(cosine))
    )


def _direction(rays: np.ndarray) -> np.ndarray:
    mean = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).mean(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))
