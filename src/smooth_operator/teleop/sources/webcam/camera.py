"""Reads cameras (newest picture only, with reconnection) and video files with OpenCV."""

from __future__ import annotations

import glob
import os
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

from jaxtyping import UInt8
from numpy import ndarray

from smooth_operator.errors import MissingExtraError, SourceError

SYSTEM_LIBRARIES: Final = (
    "It needs system libraries: sudo apt install libgl1 libglib2.0-0 libxcb1 libegl1 "
    "libgles2 (Debian, Ubuntu)"
)
"""Advice on the libraries that OpenCV and MediaPipe need on Linux without a desktop."""

_FAILURES: Final[list[str]] = []  # the error of this process's first import of OpenCV


def opencv() -> Any:
    """Imports and returns OpenCV's module.

    Raises:
        MissingExtraError: it is not installed.
        SourceError: it can't be loaded; the error names the libraries that it needs.
    """
    if _FAILURES:
        raise SourceError(_FAILURES[0])
    path = list(sys.path)
    try:
        import cv2
    except ModuleNotFoundError as error:
        raise MissingExtraError("reading a camera or a video", "webcam") from error
    except ImportError as error:
        # OpenCV's loader leaves its folder on the path, where its `typing` hides Python's own in
        # each later process.
        sys.path[:] = path
        advice = (
            SYSTEM_LIBRARIES
            if sys.platform == "linux"
            else "Install it again: python -m pip install --force-reinstall opencv-contrib-python"
        )
        _FAILURES.append(f"OpenCV can't be loaded: {error}. {advice}")
        raise SourceError(_FAILURES[0]) from error
    return cv2


RETRY_S: Final = 1.0
"""Pause between attempts to open a camera again [s]."""

Capture: TypeAlias = Any  # OpenCV has no types for mypy


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture of a camera.

    Attributes:
        pixels: blue, green, red.
        time: time at which it was read, by the loop's clock [s].
        session: number of earlier reconnections of the camera.
        depth: what a depth camera adds; None for other cameras.
    """

    pixels: UInt8[ndarray, "h w 3"]
    time: float
    session: int
    depth: Any = None


class Camera:
    """A camera, and the thread that reads its pictures so that none waits in a queue.

    Args:
        open: function that opens the camera, or opens it again, such as ``open_camera``. Its
            ``read`` returns True and the picture, with the depth if it has one, or False.
        name: name of the camera.

    Raises:
        SmoothOperatorError: those of ``open``.

    Attributes:
        lost: True while the camera is lost and the thread tries to open it again.
    """

    def __init__(self, open: Callable[[], Capture], name: int | str) -> None:
        self.lost = False
        self._open = open
        self._stopping = threading.Event()
        self._came = threading.Condition()
        self._newest: Picture | None = None
        capture = self._open()
        self._thread = threading.Thread(
            target=self._read, args=(capture,), name=f"camera {name}", daemon=True
        )
        self._thread.start()

    def newest(self, timeout: float) -> Picture | None:
        """Takes the newest picture; None if no picture arrives within the timeout [s]."""
        with self._came:
            self._came.wait_for(lambda: self._newest is not None, timeout)
            picture, self._newest = self._newest, None
            return picture

    def close(self) -> None:
        """Releases the camera; a second call does nothing."""
        self._stopping.set()
        self._thread.join(5.0)

    def _read(self, capture: Capture) -> None:
        session = 0
        while not self._stopping.is_set():
            there, pixels, *depth = capture.read()
            if there:
                picture = Picture(pixels, time.perf_counter(), session, *depth)
                with self._came:
                    self._newest = picture
                    self._came.notify_all()
                continue
            capture.release()
            self.lost = True
            while not self._stopping.wait(RETRY_S):
                try:
                    capture = self._open()
                except SourceError:
                    continue
                session += 1
                self.lost = False
                break
        capture.release()


def open_camera(name: int | str, width: int, height: int, rate: float) -> Capture:
    """Opens a camera that delivers pictures.

    Args:
        name: number, device or address of the camera.
        width: requested width of the pictures [pixels]; the camera may use a different one.
        height: requested height of the pictures [pixels].
        rate: requested picture rate [Hz].

    Raises:
        MissingExtraError: OpenCV is not installed.
        SourceError: there is no such camera, or it delivers no picture.
    """
    cv2 = opencv()
    if isinstance(name, str) and "://" in name:  # by default, a lost stream blocks for 30 s
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 5000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 3000]
        capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, limits)
    else:
        capture = cv2.VideoCapture(name)
    if capture.isOpened():
        for key, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, width),
            (cv2.CAP_PROP_FRAME_HEIGHT, height),
            (cv2.CAP_PROP_FPS, rate),
            (cv2.CAP_PROP_BUFFERSIZE, 1),
        ):
            capture.set(key, value)
        there, _ = capture.read()
        if there:
            return capture
        trouble = (
            "the camera can be opened, but delivers no picture; check that no other program is "
            "using it"
        )
    else:
        trouble = "it can't be opened"
    capture.release()
    raise SourceError(f"camera {name!r}: {trouble}. {_advice(cv2, name)}")


def _advice(cv2: Any, name: int | str) -> str:
    """Advice for a camera that can't be opened; names this machine's interfaces and devices."""
    backends = cv2.videoio_registry.getCameraBackends()
    tried = ", ".join(cv2.videoio_registry.getBackendName(b) for b in backends)
    advice = f"Interfaces that were tried: {tried or 'none'}."
    if sys.platform.startswith("linux"):
        devices = sorted(glob.glob("/dev/video*"))
        shut = [d for d in devices if not os.access(d, os.R_OK | os.W_OK)]
        if devices:
            advice += f" Video devices on this machine: {', '.join(devices)}."
        else:
            advice += " This machine has no camera: there is no device /dev/video*."
        if shut:
            advice += (
                f" You have no permission to use {', '.join(shut)}: join the group 'video' "
                "and log in again."
            )
    elif sys.platform == "darwin":
        advice += (
            " Allow this terminal to use the camera: System Settings, Privacy & Security, Camera."
        )
    elif sys.platform == "win32":
        advice += " Allow desktop apps to use the camera: Settings, Privacy & security, Camera."
    if name == 0:
        advice += (
            " To use another camera, set its number (1 or more); the source video:FILE needs no "
            "camera."
        )
    return advice


def is_video(path: Path) -> bool:
    """True if a file's suffix is that of a video."""
    return path.suffix.lower() in (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm")


class VideoFile:
    """An open video file.

    Raises:
        MissingExtraError: OpenCV is not installed.
        SourceError: there is no such file, or it is not a video.

    Attributes:
        rate: picture rate in the file [Hz].
        count: number of pictures in the file; 0 if unknown.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise SourceError(f"{path}: no such file; check the name and the folder")
        cv2 = opencv()
        self._time_ms = cv2.CAP_PROP_POS_MSEC
        self._capture = cv2.VideoCapture(str(path))
        rate = self._capture.get(cv2.CAP_PROP_FPS) if self._capture.isOpened() else 0.0
        self.rate = rate if 0.0 < rate < 1000.0 else 30.0
        self.count = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        self._time = -1.0 / self.rate
        if not self._capture.isOpened() or not self._capture.grab():
            self.close()
            raise SourceError(
                f"{path}: the file can't be read as a video; H.264 in .mp4 works everywhere: "
                "ffmpeg -i INPUT -c:v libx264 out.mp4"
            )
        self._grabbed = True

    def advance(self) -> float | None:
        """Moves to the next picture without decoding it.

        Returns:
            its time in the video [s], which always increases; None at the end.
        """
        if not (self._grabbed or self._capture.grab()):
            return None
        self._grabbed = False
        time = float(self._capture.get(self._time_ms)) * 1e-3
        if time <= self._time:  # some files have no times, or repeat one
            time = self._time + 1.0 / self.rate
        self._time = time
        return time

    def picture(self) -> UInt8[ndarray, "h w 3"] | None:
        """Decodes the current picture (blue, green, red); None if it is damaged."""
        there, pixels = self._capture.retrieve()
        return pixels if there else None

    def close(self) -> None:
        """Closes the file; a second call does nothing."""
        self._capture.release()
