"""A whole video as a recording: every picture, however long it takes."""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from smooth_operator.errors import RecordingError
from smooth_operator.formats.checks import check_recording
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.teleop.sources.webcam.picture_tracker import PictureConfig, PictureTracker
from smooth_operator.teleop.sources.webcam.video_file import VideoFile
from smooth_operator.types import HandFrame, HandRecording, Side


def track_video(
    path: str | os.PathLike[str],
    *,
    side: Side | None = None,
    config: PictureConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> HandRecording:
    """Track one hand through a video file.

    Args:
        path: the video.
        side: which hand; the one that is seen more often if left out.
        config: how it is found; ``PictureConfig()`` if left out.
        progress: called with the pictures done and, as far as the file says, those there are.

    Returns:
        a frame for each picture, NaN and not valid where the hand is not seen.

    Raises:
        MissingExtraError: MediaPipe is not installed.
        SourceError: the video can't be read, or the model not be had.
        RecordingError: the hand is on no picture.

    Example:
        >>> recording = track_video("clip.mp4", side="right")  # doctest: +SKIP
    """
    path = Path(path)
    with contextlib.ExitStack() as stack:
        video = stack.enter_context(contextlib.closing(VideoFile(path)))
        tracker = stack.enter_context(contextlib.closing(PictureTracker(config or PictureConfig())))
        pictures: list[dict[Side, HandFrame]] = []
        stamps: list[float] = []
        while (time := video.advance()) is not None:
            pixels = video.picture()
            frames = [] if pixels is None else tracker.frames(pixels, time)
            pictures.append({frame.side: frame for frame in frames})
            stamps.append(time)
            if progress is not None:
                progress(len(stamps), max(video.count, len(stamps)))
    seen = Counter(found for hands in pictures for found in hands)
    wanted = side or (seen.most_common(1)[0][0] if seen else "right")
    if not seen[wanted]:
        others = f", but a {next(iter(seen))} hand is on {seen.total()}" if seen else ""
        raise RecordingError(
            f"{path}: no {wanted if side else ''} hand is on any of its {len(stamps)} "
            f"pictures{others}. If the video is mirrored, say so; otherwise more light, and the "
            "whole hand in view, help".replace("  ", " ")
        )
    landmarks = np.full((len(stamps), NUM_LANDMARKS, 3), np.nan)
    valid = np.zeros((len(stamps), NUM_LANDMARKS), bool)
    for i, hands in enumerate(pictures):
        if (frame := hands.get(wanted)) is not None:
            landmarks[i], valid[i] = frame.landmarks, frame.valid
    recording = HandRecording(
        landmarks, np.array(stamps), wanted, valid, name=path.stem, meta={"source": path.name}
    )
    check_recording(recording, str(path))
    return recording
