"""Recognises held-out recordings by their content.

Each frame has a word: the distances between wrist and fingertips, rounded to 0.01 mm and digested.
That does not change when a recording is renamed, cut, thinned out, moved, turned, mirrored or
written in another format.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from smooth_operator.errors import ConfigError
from smooth_operator.lab.benchmark.recordings import Source
from smooth_operator.landmarks import TIPS, WRIST
from smooth_operator.types import HandRecording

MANY: Final = 10
"""So many frames of a held-out recording, or all of a shorter one, are no coincidence."""

_UNIT: Final = 1e-5  # [m]


def frame_words(recording: HandRecording) -> set[bytes]:
    """Words of the frames whose wrist and fingertips are valid."""
    points = recording.landmarks[:, [WRIST, *TIPS]]
    assert recording.valid is not None  # filled in on construction
    valid = recording.valid[:, [WRIST, *TIPS]].all(axis=1)
    first, second = np.triu_indices(points.shape[1], 1)
    lengths = np.linalg.norm(points[:, first] - points[:, second], axis=-1)[valid]
    # A word for either rounding, so that the last bit of a float32 does not make another frame.
    units = lengths / _UNIT
    rounded = (np.floor(units).astype("<i8"), np.floor(units + 0.5).astype("<i8"))
    return {hashlib.sha256(row.tobytes()).digest()[:12] for rows in rounded for row in rows}


def check_held_out(sources: Sequence[Source], held_out: Iterable[Source]) -> None:
    """Refuses to tune on what is held out.

    Raises:
        ConfigError: a recording holds frames of one that is held out.
    """
    words_held_out = [
        (source, frame_words(source.recording)) for source in held_out if source.recording
    ]
    for source in sources:
        if source.recording is None:
            continue
        words = frame_words(source.recording)
        for other, theirs in words_held_out:
            shared = len(words & theirs)
            if shared >= min(MANY, len(words), len(theirs)) and shared:
                raise ConfigError(
                    f"{source.name} holds frames of {other.name}, which is held out for judging: "
                    "what is tuned on it could no longer be judged; tune on other frames, or "
                    "take it off the list of those held out"
                )
