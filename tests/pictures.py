"""OpenCV and MediaPipe for tests, which skip where one is missing or can't be loaded."""

from pathlib import Path
from typing import Any

import pytest

from smooth_operator.errors import MissingExtraError, SmoothOperatorError, SourceError
from smooth_operator.teleop.sources.webcam.camera import SYSTEM_LIBRARIES, opencv
from smooth_operator.teleop.sources.webcam.picture_tracker import HandLandmarker


def opencv_or_skip() -> Any:
    """OpenCV's module; skips the test, or the whole file, with what a user would read."""
    try:
        return opencv()
    except SmoothOperatorError as error:
        pytest.skip(str(error), allow_module_level=True)


def landmarker_or_skip(model: Path) -> None:
    """Skips the test with what a user would read if MediaPipe or a library of the system is absent.

    Args:
        model: file of the landmarker's model.
    """
    try:
        HandLandmarker(model).close()
    except MissingExtraError as error:
        pytest.skip(str(error))
    except SourceError as error:
        if SYSTEM_LIBRARIES not in str(error):
            raise
        pytest.skip(str(error))
