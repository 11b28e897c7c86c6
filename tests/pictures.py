"""OpenCV for tests, which skip where it is missing or can't be loaded."""

from typing import Any

import pytest

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.teleop.sources.webcam.camera import opencv


def opencv_or_skip() -> Any:
    """OpenCV's module; skips the test, or the whole file, with what a user would read."""
    try:
        return opencv()
    except SmoothOperatorError as error:
        pytest.skip(str(error), allow_module_level=True)
