"""Aligns a whole recording, and estimates an operator's scale."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.alignment import (
    MIN_CONDITION,
    AlignmentConfig,
    palm_alignment,
    reference_landmarks,
)
from smooth_operator.types import HandRecording

_AS_PUBLISHED: Final = AlignmentConfig()


def align_recording(
    recording: HandRecording, hand: Hand, config: AlignmentConfig = _AS_PUBLISHED
) -> Float[np.ndarray, "T 21 3"]:
    """Transforms all frames of a recording to the palm frame, without filters.

    Returns:
        (T, 21, 3) landmarks [m]; NaN where a landmark is invalid, and everywhere in frames whose
        palm is invalid or degenerate.
    """
    valid = _validity(recording)
    landmarks = np.where(valid[..., None], recording.landmarks, np.nan)
    palm = np.all(valid[:, list(hand.align_indices)], axis=1)  # a valid landmark is finite
    safe = np.where(palm[:, None, None], landmarks, reference_landmarks(hand))
    fit = palm_alignment(safe, hand, config)
    usable = palm & (np.asarray(fit.condition) >= MIN_CONDITION)
    aligned: np.ndarray = np.where(usable[:, None, None], fit.apply(safe), np.nan)
    return aligned


def calibrate_scale(recording: HandRecording, hand: Hand) -> float:
    """Estimates the scale of an operator, which is the median of the estimates of all frames.
    Raises RecordingError if no frame has a usable palm."""
    valid = np.all(_validity(recording)[:, list(hand.align_indices)], axis=1)
    if valid.any():
        fit = palm_alignment(recording.landmarks[valid], hand)
        usable = np.asarray(fit.condition) >= MIN_CONDITION
        if usable.any():
            return float(np.median(np.asarray(fit.scale)[usable]))
    raise RecordingError(
        f"{recording.name}: no frame has valid, non-collinear palm landmarks from which to "
        "calibrate a scale"
    )


def _validity(recording: HandRecording) -> Bool[np.ndarray, "T 21"]:
    assert recording.valid is not None  # filled in on construction
    return recording.valid
