"""Finds the pinches of a calibration, from prompts or by searching a recording.

Both produce ``Segment`` objects for the estimator.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError
from smooth_operator.io.landmark_order import check_hand
from smooth_operator.landmarks import BASES, FINGERS, TIPS
from smooth_operator.types import HandRecording

BONE_TOLERANCE: Final = 0.3
"""Largest relative deviation of a bone from its median length in a usable frame."""
MIN_FRAMES: Final = 10


@dataclass(frozen=True, eq=False)
class Features:
    """Features of each frame of a recording; NaN in frames that can't be used.

    Attributes:
        good: (T,) True for usable frames: all landmarks valid, bones of their usual length.
        palm_length: distance from wrist to middle MCP [m].
        straightness: (T, 5) distance from base to tip over the length of the finger.
        gaps: (T, 4) distance from the thumb's tip to each other tip [m].
    """

    good: Bool[np.ndarray, " T"]
    palm_length: float
    straightness: Float[np.ndarray, "T 5"]
    gaps: Float[np.ndarray, "T 4"]


def measure_features(recording: HandRecording) -> Features:
    """Computes the features of a recording; RecordingError if too few frames can be used, or they
    show the other hand."""
    assert recording.valid is not None  # filled in on construction
    points = recording.landmarks
    whole = np.asarray(recording.valid.all(axis=1))
    good = whole
    with np.errstate(invalid="ignore"):
        lengths = np.linalg.norm(np.diff(points[:, 1:].reshape(-1, 5, 4, 3), axis=2), axis=-1)
        palm = np.linalg.norm(points[:, BASES] - points[:, :1], axis=-1)
        sizes = np.concatenate([lengths.reshape(-1, 15), palm], axis=1)
        if whole.any():
            usual = np.median(sizes[whole], axis=0)
            good = whole & (np.abs(sizes - usual) <= BONE_TOLERANCE * usual).all(axis=1)
    if good.sum() < MIN_FRAMES:
        raise RecordingError(
            f"{recording.name}: {int(good.sum())} of {len(recording)} frames show a whole "
            f"hand; a calibration needs at least {MIN_FRAMES}, preferably two minutes"
        )
    points = np.where(good[:, None, None], points, np.nan)
    # The reader of the recording has checked the order of landmarks.
    check_hand(points, recording.side, layout="mediapipe", where=recording.name)
    bones = np.median(lengths[good], axis=0)
    reach = np.linalg.norm(points[:, TIPS] - points[:, BASES], axis=-1)
    return Features(
        good=good,
        palm_length=float(np.median(palm[good, 2])),
        straightness=reach / bones.sum(axis=1),
        gaps=np.linalg.norm(points[:, TIPS[1:]] - points[:, TIPS[:1]], axis=-1),
    )


FIST: Final = 0.65
"""Largest straightness of the long fingers in a fist, relative to each finger's largest."""
PINCH_REACH: Final = 0.025
"""Largest thumb-to-tip distance in a pinch [m]; trackers report the tips of touching pads up to 2
cm apart."""
PINCH_DEPTH: Final = 0.018
"""Distance below which thumb and finger must come for a pinch [m]."""
CORE: Final = 0.004
"""Distance above its minimum up to which a pinch counts as held [m]."""

_BRIDGE_S: Final = 0.08  # longest break within a pinch
_PINCH_S: Final = 0.1  # shortest pinch
_SURE_S: Final = 0.5  # length of full confidence
_OTHER_NEAR: Final = 0.006  # distance of a second tip that makes a pinch doubtful [m]


@dataclass(frozen=True)
class Segment:
    """Range of frames in which an operator holds a pinch.

    Attributes:
        finger: the finger that pinches.
        start: first frame.
        stop: one past the last frame.
        confidence: confidence in the pinch, 0 to 1.
    """

    finger: str
    start: int
    stop: int
    confidence: float


def find_segments(features: Features, stamps: Float[np.ndarray, " T"]) -> list[Segment]:
    """Finds the pinches in a recording with (T,) stamps [s], ordered by time."""
    segments = [s for i in range(len(FINGERS) - 1) for s in _pinches(features, stamps, i)]
    return sorted(segments, key=lambda segment: segment.start)


def _pinches(features: Features, stamps: np.ndarray, i: int) -> Iterator[Segment]:
    gaps = features.gaps
    others = np.delete(gaps, i, axis=1).min(axis=1)
    straight = features.straightness[:, 1:]
    largest = np.clip(np.nanpercentile(straight, 98, axis=0), 0.9, 1.0)  # below 1 with noise
    fist = (straight / largest).max(axis=1) <= FIST + 0.1
    near = (gaps[:, i] < PINCH_REACH) & (gaps[:, i] <= others) & ~fist
    for start, stop in _runs(near, stamps, _PINCH_S):
        gap = gaps[start:stop, i]
        depth = float(np.nanpercentile(gap, 5))
        if depth > PINCH_DEPTH:
            continue
        for first, last in _runs(gap <= depth + CORE, stamps[start:stop], _PINCH_S):
            held = slice(start + first, start + last)
            alone = float(np.nanmedian(others[held] - gaps[held, i]))
            sure = min((1.25 * PINCH_REACH - depth) / PINCH_REACH, alone / _OTHER_NEAR)
            length = min(1.0, float(stamps[held.stop - 1] - stamps[held.start]) / _SURE_S)
            confidence = float(np.clip(sure, 0.05, 1.0)) * (0.3 + 0.7 * length)
            yield Segment(FINGERS[i + 1], held.start, held.stop, round(confidence, 3))


def _runs(
    frames: Bool[np.ndarray, " T"], stamps: np.ndarray, shortest: float
) -> Iterator[tuple[int, int]]:
    """Long enough runs of true frames; short breaks are bridged."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], frames.astype(np.int8), [0]])))
    merged: list[list[int]] = []
    for start, stop in edges.reshape(-1, 2).tolist():
        if merged and stamps[start] - stamps[merged[-1][1] - 1] <= _BRIDGE_S:
            merged[-1][1] = stop
        else:
            merged.append([start, stop])
    for start, stop in merged:
        if stamps[stop - 1] - stamps[start] >= shortest:
            yield start, stop


@dataclass(frozen=True)
class Prompt:
    """A pose or a motion that the program asks the operator to make.

    Attributes:
        name: name of its frames; the finger of a pinch.
        text: instruction to the operator.
        settle: time to get ready, whose frames are not used [s].
        hold: time of the pose or the motion, whose frames are used [s].
    """

    name: str
    text: str
    settle: float = 2.0
    hold: float = 4.0


PROMPTS: Final = tuple(
    Prompt(finger, f"pinch: thumb pad on {finger} finger pad, lightly") for finger in FINGERS[1:]
)
"""Prompts of a calibration of pinches, in order."""
