"""The sources ``webcam`` and ``video``, which track bare hands with a camera or in a video file."""

from __future__ import annotations

import atexit
import contextlib
import os
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.formats.checks import check_recording
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.retargeting.known_gaps import MEDIAPIPE, NO_GAPS
from smooth_operator.settings import check_numbers, check_range
from smooth_operator.teleop.sources.live import Running, SourceHealth, ThreadedSource
from smooth_operator.teleop.sources.webcam.camera import (
    Camera,
    Capture,
    Picture,
    VideoFile,
    open_camera,
)
from smooth_operator.teleop.sources.webcam.picture_tracker import PictureConfig, PictureTracker
from smooth_operator.types import HandFrame, HandRecording, Side


@dataclass(frozen=True)
class _Pictures(PictureConfig, ThreadedSource):
    """Base of the two sources: a camera or a video, with the settings of its tracker."""

    @property
    def pinch_gaps(self) -> Mapping[str, float]:
        """Gaps that the tracker is known to report in pinches; see ``source_gaps``."""
        return MEDIAPIPE if self.points == "world" else NO_GAPS

    def stop(self) -> None:
        """Stops; see ``LiveSource``."""
        super().stop()
        atexit.unregister(self.stop)

    def _hold(self, pictures: Camera | VideoFile, tracker: PictureTracker) -> None:
        """Stores the opened objects for the source's thread."""
        object.__setattr__(self, "_opened", (pictures, tracker))
        atexit.register(self.stop)  # a thread in native code crashes at the interpreter's end


@dataclass(frozen=True)
class Webcam(_Pictures):
    """Source that tracks hands with a camera; see ``PictureConfig`` for further settings.

    A frame's stamp is the time when its picture was read, by the loop's clock. The frame counts as
    received when its hand has been detected.

    Attributes:
        camera: number of the camera, counted from 0; or a device, or an address such as
            ``rtsp://...``.
        width: requested width of the picture [pixels].
        height: requested height of the picture [pixels].
        rate: requested picture rate [Hz].
    """

    camera: int | str = 0
    width: int = 640
    height: int = 480
    rate: float = 30.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.camera, int) and self.camera < 0:
            raise ConfigError(f"camera must not be negative, but is {self.camera}")
        check_numbers(self, positive=("width", "height", "rate"))

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"camera {self.camera}"

    def capture(self) -> Capture:
        """Opens the camera; see ``Camera``."""
        return open_camera(self.camera, self.width, self.height, self.rate)

    def frames(self, picture: Picture, tracker: PictureTracker) -> list[HandFrame]:
        """Finds the hands in a picture."""
        return tracker.frames(picture.pixels, picture.time)

    def open(self) -> None:
        """Loads the model and opens the camera. The caller receives the errors."""
        tracker = PictureTracker(self)
        try:
            camera = Camera(self.capture, self.camera)
        except BaseException:
            tracker.close()
            raise
        self._hold(camera, tracker)

    def run(self, running: Running) -> None:
        """Finds the hands in the newest picture and posts them, repeatedly."""
        camera, tracker = self.__dict__.pop("_opened")
        with contextlib.closing(tracker), contextlib.closing(camera):
            while not running.stopping.is_set():
                picture = camera.newest(timeout=0.1)
                if picture is None:
                    if camera.lost:
                        detail = "the camera was disconnected; trying to open it again"
                        running.health = SourceHealth("waiting", detail)
                    continue
                frames = self.frames(picture, tracker)
                for frame in frames:
                    running.mailbox.post(frame, session=picture.session)
                _say(running, frames)


@dataclass(frozen=True)
class Video(_Pictures):
    """Source that tracks hands in a video file; see ``PictureConfig`` for further settings.

    A frame's stamp is the time of its picture in the video. If the tracker is too slow, pictures
    are skipped, as with a camera.

    Attributes:
        path: the file.
        speed: playback seconds per second.
        every: use every picture; a slow tracker then delays the video.
        loop: start over at the end.
    """

    path: Path
    speed: float = 1.0
    every: bool = False
    loop: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("speed", self.speed, 0.01, 100.0)

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"video {self.path.name}"

    def open(self) -> None:
        """Opens the file and loads the model. The caller receives the errors."""
        video = VideoFile(self.path)
        try:
            tracker = PictureTracker(self)
        except BaseException:
            video.close()
            raise
        self._hold(video, tracker)

    def run(self, running: Running) -> None:
        """Posts the hands of each picture when the picture is due."""
        video, tracker = self.__dict__.pop("_opened")
        with contextlib.closing(tracker):
            session, counts = 0, Counter[str]()
            while True:
                with contextlib.closing(video):
                    self._play(video, tracker, running, session, counts)
                if not self.loop or running.stopping.is_set():
                    break
                video, session = VideoFile(self.path), session + 1
        late = (
            f", {counts['late']} pictures skipped because they were late" if counts["late"] else ""
        )
        tried = counts["pictures"] - counts["late"]
        detail = f"a hand in {counts['hands']} of {tried} pictures{late}"
        running.health = SourceHealth("running", detail)

    def _play(
        self,
        video: VideoFile,
        tracker: PictureTracker,
        running: Running,
        session: int,
        counts: Counter[str],
    ) -> None:
        clock = running.mailbox.clock
        began = clock()
        while not running.stopping.is_set() and (time := video.advance()) is not None:
            counts["pictures"] += 1
            early = began + time / self.speed - clock()
            if early > 0:
                running.stopping.wait(early)
            elif self.every:
                began -= early
            elif -early > 1.0 / (video.rate * self.speed):  # the next one is due already
                counts["late"] += 1
                continue
            pixels = video.picture()
            if pixels is None:
                continue
            frames = tracker.frames(pixels, time)
            for frame in frames:
                running.mailbox.post(frame, session=session, speed=self.speed)
            counts["hands"] += bool(frames)
            _say(running, frames)


def _say(running: Running, frames: list[HandFrame]) -> None:
    """Updates the health."""
    sides = " and ".join(sorted(frame.side for frame in frames))
    detail = f"{sides} hand in the picture" if sides else "no hand in the picture"
    if running.health.detail != detail or running.health.state != "running":
        running.health = SourceHealth("running", detail)


def track_video(
    path: str | os.PathLike[str],
    *,
    side: Side | None = None,
    config: PictureConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> HandRecording:
    """Tracks one hand in a video file.

    Args:
        side: side of the hand; None for the side that is seen in more pictures.
        config: settings of the tracker; None for ``PictureConfig()``.
        progress: called with the number of pictures done and the total according to the file.

    Returns:
        a frame for each picture; landmarks are NaN and not valid where the hand is not seen.

    Raises:
        MissingExtraError: MediaPipe is not installed.
        SourceError: the video can't be read, or the model can't be loaded.
        RecordingError: the hand is not seen in any picture.

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
    counts = Counter(one for hands in pictures for one in hands)
    chosen = side or (counts.most_common(1)[0][0] if counts else "right")
    if not counts[chosen]:
        hand = f"{chosen} hand" if side else "hand"
        others = f", but a {next(iter(counts))} hand is seen in {counts.total()}" if counts else ""
        raise RecordingError(
            f"{path}: no {hand} is seen in any of its {len(stamps)} pictures{others}. If the video "
            "is mirrored, use --mirrored; otherwise use more light and keep the whole hand in view"
        )
    landmarks = np.full((len(stamps), NUM_LANDMARKS, 3), np.nan)
    valid = np.zeros((len(stamps), NUM_LANDMARKS), bool)
    for i, hands in enumerate(pictures):
        if (frame := hands.get(chosen)) is not None:
            landmarks[i], valid[i] = frame.landmarks, frame.valid
    recording = HandRecording(
        landmarks, np.array(stamps), chosen, valid, name=path.stem, meta={"source": path.name}
    )
    check_recording(recording, str(path))
    return recording
