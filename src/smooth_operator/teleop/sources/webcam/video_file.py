"""A video file, picture by picture, with the time of each."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from jaxtyping import UInt8
from numpy import ndarray

from smooth_operator.errors import SourceError
from smooth_operator.teleop.sources.webcam.camera import opencv

SUFFIXES: Final = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm")
"""Of files that are taken for videos by their name."""


def is_video(path: Path) -> bool:
    """Whether a file is a video, by its name."""
    return path.suffix.lower() in SUFFIXES


class VideoFile:
    """A video that is being read.

    Args:
        path: the file.

    Raises:
        MissingExtraError: OpenCV is not installed.
        SourceError: there is no such file, or it holds no video.

    Attributes:
        rate: pictures per second, as the file says.
        count: how many there are, as the file says; 0 where it does not.
    """

    def __init__(self, path: Path) -> None:
        cv2 = opencv()
        if not path.is_file():
            raise SourceError(f"{path}: no such file; check the name and the folder")
        self._time_ms = cv2.CAP_PROP_POS_MSEC
        self._capture = cv2.VideoCapture(str(path))
        rate = self._capture.get(cv2.CAP_PROP_FPS) if self._capture.isOpened() else 0.0
        self.rate = rate if 0.0 < rate < 1000.0 else 30.0
        self.count = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        self._time = -1.0 / self.rate
        if not self._capture.isOpened() or not self._capture.grab():
            self.close()
            raise SourceError(
                f"{path}: it can't be read as a video; H.264 in .mp4 is understood everywhere: "
                "ffmpeg -i INPUT -c:v libx264 out.mp4"
            )
        self._grabbed = True

    def advance(self) -> float | None:
        """Go to the next picture without unpacking it.

        Returns:
            its time in the video [s], always later than the last; None at the end.
        """
        if not (self._grabbed or self._capture.grab()):
            return None
        self._grabbed = False
        time = float(self._capture.get(self._time_ms)) * 1e-3
        if time <= self._time:  # some files have no times, or stand still
            time = self._time + 1.0 / self.rate
        self._time = time
        return time

    def picture(self) -> UInt8[ndarray, "h w 3"] | None:
        """The picture that was gone to, blue, green, red; None if it is damaged."""
        there, pixels = self._capture.retrieve()
        return pixels if there else None

    def close(self) -> None:
        """Give it back; a second call does nothing."""
        self._capture.release()
