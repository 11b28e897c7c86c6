"""Loads OpenCV, or says why it can't be loaded."""

from __future__ import annotations

import os
import sys
from typing import Any, Final

from smooth_operator.errors import MissingExtraError, SourceError

SYSTEM_LIBRARIES: Final = (
    "It needs libraries of the system: sudo apt install libgl1 libglib2.0-0 libxcb1 libegl1 "
    "libgles2 (Debian, Ubuntu)"
)
"""What OpenCV and MediaPipe need on a Linux without a desktop."""

_FAILURES: Final[list[str]] = []
"""Why OpenCV could not be loaded in this process, once it could not."""


def opencv() -> Any:
    """OpenCV's module, without its own messages, which this package words better.

    Raises:
        MissingExtraError: it is not installed.
        SourceError: it is installed, but can't be loaded; with the libraries that it needs.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read when the first file is opened
    if _FAILURES:
        raise SourceError(_FAILURES[0])
    path = list(sys.path)
    try:
        import cv2
    except ModuleNotFoundError as error:
        raise MissingExtraError("reading a camera or a video", "webcam") from error
    except ImportError as error:
        # OpenCV's loader leaves its folder on the path, where its `typing` hides Python's own from
        # every process that is started later, and a mark that makes a second import fail otherwise.
        sys.path[:] = path
        for name in [name for name in sys.modules if name.partition(".")[0] == "cv2"]:
            del sys.modules[name]
        vars(sys).pop("OpenCV_LOADER", None)
        sys.modules["cv2"] = None  # type: ignore[assignment]  # no library that uses it tries again
        advice = (
            SYSTEM_LIBRARIES
            if sys.platform == "linux"
            else "Install it again: python -m pip install --force-reinstall opencv-contrib-python"
        )
        _FAILURES.append(f"OpenCV can't be loaded: {error}. {advice}")
        raise SourceError(_FAILURES[0]) from error
    getattr(cv2.utils, "logging", cv2).setLogLevel(0)  # moved there in OpenCV 5; 0 is silent
    return cv2
