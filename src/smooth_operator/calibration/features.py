"""Features that identify the poses of a calibration: sizes, straightness, spread, tip gaps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError
from smooth_operator.io.anatomy import check_hand
from smooth_operator.landmarks import BASES, TIPS
from smooth_operator.types import HandRecording

BONE_TOLERANCE: Final = 0.3
"""Largest relative deviation of a bone from its median length in a usable frame."""
MIN_FRAMES: Final = 10


@dataclass(frozen=True, eq=False)
class Features:
    """Features of each frame of a recording; NaN in frames that can't be used.

    Attributes:
        good: (T,) True for usable frames: all landmarks valid, bones of their usual length.
        bones: (5, 3) median lengths of the bones, base to tip [m].
        palm_width: distance from index MCP to pinky MCP [m].
        palm_length: distance from wrist to middle MCP [m].
        straightness: (T, 5) distance from base to tip over the length of the finger.
        spread: (T,) distance from index tip to pinky tip over the palm's width.
        gaps: (T, 4) distance from the thumb's tip to each other tip [m].
    """

    good: Bool[np.ndarray, " T"]
    bones: Float[np.ndarray, "5 3"]
    palm_width: float
    palm_length: float
    straightness: Float[np.ndarray, "T 5"]
    spread: Float[np.ndarray, " T"]
    gaps: Float[np.ndarray, "T 4"]


def measure_features(recording: HandRecording) -> Features:
    """Compute the features of a recording.

    Raises:
        RecordingError: too few frames can be used, or they show the other hand.
    """
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
            f"{recording.name}: {int(good.sum())} of {len(recording)} frames show a whole hand; a "
            f"calibration needs {MIN_FRAMES} at least, and better two minutes of them"
        )
    points = np.where(good[:, None, None], points, np.nan)
    # The reader of the recording has checked the order of landmarks.
    check_hand(points, recording.side, layout="mediapipe", where=recording.name)
    bones = np.median(lengths[good], axis=0)
    width = float(np.nanmedian(np.linalg.norm(points[:, 5] - points[:, 17], axis=-1)))
    reach = np.linalg.norm(points[:, TIPS] - points[:, BASES], axis=-1)
    return Features(
        good=good,
        bones=bones,
        palm_width=width,
        palm_length=float(np.median(palm[good, 2])),
        straightness=reach / bones.sum(axis=1),
        spread=np.linalg.norm(points[:, 8] - points[:, 20], axis=-1) / width,
        gaps=np.linalg.norm(points[:, TIPS[1:]] - points[:, TIPS[:1]], axis=-1),
    )
