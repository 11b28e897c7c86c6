"""Recordings as a tracker would have given them: noisier, with frames lost, or at another rate.

With the degraded frames it keeps the true ones, which a method is measured against.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.errors import RecordingError
from smooth_operator.lab.benchmark.recordings import SYNTHETIC_SECONDS, Source
from smooth_operator.synthetic.tracker import TrackerModel, TrackerStream
from smooth_operator.types import HandRecording

LEAD: Final = 20
"""The first frame is shown so many times before the clock starts, so that what a method does until
it has settled, from its neutral pose, is not counted."""

FEWEST: Final = 12
"""A recording of fewer frames has neither jitter nor lag worth the name."""


@dataclass(frozen=True, eq=False)
class DegradedRecording:
    """A recording as seen, and as it was.

    Attributes:
        source: where it is from.
        clean: T frames, as they were.
        seen: LEAD + T frames, as the tracker gave them; what was lost is not valid.
    """

    source: Source
    clean: HandRecording
    seen: HandRecording

    def __post_init__(self) -> None:
        if len(self.clean) < FEWEST:
            raise RecordingError(
                f"{self.source.name}: {len(self.clean)} frames are left for this experiment; it "
                f"needs {FEWEST}"
            )

    @property
    def digest(self) -> str:
        """Of what is seen, as one word."""
        assert self.seen.valid is not None  # filled in on construction
        known = np.where(self.seen.valid[..., None], self.seen.landmarks, np.nan)
        total = hashlib.sha256(self.seen.side.encode())
        for array in (known, self.seen.stamps):
            total.update(np.ascontiguousarray(array, "<f8").tobytes())
        return total.hexdigest()


def recording_of(source: Source) -> HandRecording:
    """The frames of a source.

    Raises:
        RecordingError: it could not be read.
    """
    if source.recording is None:
        raise RecordingError(f"{source.name}: {source.error}")
    return source.recording


def middle(recording: HandRecording, frames: int) -> HandRecording:
    """So many frames from the middle; all, where there are fewer."""
    start = max(0, (len(recording) - frames) // 2)
    return recording[start : start + frames]


def through_tracker(source: Source, clean: HandRecording, model: TrackerModel) -> DegradedRecording:
    """What a tracker with noise and losses makes of a recording.

    A lost frame stays in its place without a valid landmark, as a loop meets it that has to send a
    command anyway. The recording's own noise, where a real tracker made it, is in both.
    """
    seen = led(clean)
    ticks = TrackerStream(model, clean.rate_hz).next(len(seen))
    ticks.arrives[:LEAD] = True
    landmarks, valid, metacarpals = seen.landmarks.copy(), seen.valid, seen.metacarpals
    assert valid is not None  # filled in on construction
    if ticks.noise is not None:
        landmarks += ticks.noise[:, :21]
        metacarpals = None if metacarpals is None else metacarpals + ticks.noise[:, 21:]
    gone = ~ticks.arrives[:, None] | ticks.lost
    landmarks[gone] = np.nan
    return DegradedRecording(
        source,
        clean,
        replace(seen, landmarks=landmarks, valid=valid & ~gone, metacarpals=metacarpals),
    )


def at_rate(source: Source, rate_hz: float, seconds: float) -> DegradedRecording | None:
    """The same motion at another frame rate.

    The built-in operator is recorded again, so that nothing is interpolated. Of another
    recording the frames nearest to the ticks are taken with their own stamps.

    Args:
        source: the recording.
        rate_hz: frames a second.
        seconds: how much of its middle.

    Returns:
        None where the recording has not as many frames a second.
    """
    recording = recording_of(source)
    begin = float(recording.stamps[0]) + max(0.0, (recording.duration - seconds) / 2)
    end = begin + min(seconds, recording.duration)
    if source.request.path is None:
        operator = replace(source.request, rate=rate_hz, noise=0.0).operator()
        whole = operator.record(SYNTHETIC_SECONDS)
        inside = np.flatnonzero((whole.stamps >= begin - 1e-9) & (whole.stamps < end + 1e-9))
        clean = whole[int(inside[0]) : int(inside[-1]) + 1]
        return DegradedRecording(source, replace(clean, meta={}), led(clean))
    if recording.rate_hz < 0.95 * rate_hz:
        return None
    chosen = nearest_frames(recording.stamps, np.arange(begin, end, 1 / rate_hz))
    clean = _chosen(recording, chosen)
    return DegradedRecording(source, clean, led(clean))


def nearest_frames(
    stamps: Float[np.ndarray, " T"], ticks: Float[np.ndarray, " S"]
) -> Int[np.ndarray, " U"]:
    """Which frames are nearest to the ticks, each once."""
    after = np.searchsorted(stamps, ticks).clip(1, len(stamps) - 1)
    before_is_nearer = ticks - stamps[after - 1] < stamps[after] - ticks
    return np.unique(after - before_is_nearer)


def led(recording: HandRecording) -> HandRecording:
    """A recording with its first frame LEAD times in front, at its own rate."""
    period = 1.0 / recording.rate_hz
    first = np.zeros(LEAD, int)
    led = _chosen(recording, np.concatenate([first, np.arange(len(recording))]), check=False)
    stamps = led.stamps.copy()
    stamps[:LEAD] -= period * np.arange(LEAD, 0, -1)
    return replace(led, stamps=stamps)


def _chosen(
    recording: HandRecording, at: Sequence[int] | Int[np.ndarray, " S"], check: bool = True
) -> HandRecording:
    optional: dict[str, Any] = {
        name: None if getattr(recording, name) is None else getattr(recording, name)[at]
        for name in ("valid", "metacarpals", "orientations", "T_world_wrist")
    }
    stamps = recording.stamps[at]
    assert not check or (np.diff(stamps) > 0).all()  # frames are taken in order, and once
    return replace(recording, landmarks=recording.landmarks[at], stamps=stamps, meta={}, **optional)
