"""An OpenCV that is installed and can't be loaded."""

import sys
from unittest.mock import MagicMock

import pytest

from smooth_operator.errors import SourceError
from smooth_operator.teleop.sources.webcam import camera, picture_tracker

LOADER = """
import os, sys
if hasattr(sys, "OpenCV_LOADER"):
    raise ImportError("ERROR: recursion is detected during loading")
sys.OpenCV_LOADER = True
sys.path.insert(1, os.path.dirname(__file__))
sys.modules.pop("cv2")
raise ImportError("libGL.so.1: cannot open shared object file: No such file or directory")
"""
"""What the loader of OpenCV 5.1 does where a library of the system is missing."""


def test_a_failed_import_of_opencv_names_the_packages_of_the_system(monkeypatch, tmp_path):
    monkeypatch.setattr(camera, "_FAILURES", [])
    (tmp_path / "cv2").mkdir()
    (tmp_path / "cv2" / "__init__.py").write_text(LOADER)
    for name in {"cv2", *(name for name in sys.modules if name.startswith("cv2."))}:
        monkeypatch.setitem(sys.modules, name, None)  # so that it is restored
        del sys.modules[name]
    monkeypatch.setattr(sys, "OpenCV_LOADER", True, raising=False)
    del sys.OpenCV_LOADER
    monkeypatch.syspath_prepend(tmp_path)
    path, texts = list(sys.path), []
    for _ in range(2):
        with pytest.raises(SourceError, match=r"libGL\.so\.1") as caught:
            camera.opencv()
        texts.append(str(caught.value))
    assert texts[0] == texts[1]
    if sys.platform.startswith("linux"):
        assert "apt install libgl1 libglib2.0-0 libxcb1" in texts[0]
    assert sys.path == path
    assert not [name for name, module in sys.modules.items() if name.startswith("cv2") and module]
    with pytest.raises(ImportError):
        import cv2  # noqa: F401  (as another library does)


def test_mediapipe_without_a_library_of_the_system_names_the_packages(monkeypatch, tmp_path):
    """MediaPipe can be imported without libgles2, and fails when it makes a landmarker."""
    model = tmp_path / "hand_landmarker.task"
    model.write_bytes(b"")
    for problem, words in (
        ("libGLESv2.so.2: cannot open shared object file", r"apt install .*libgles2"),
        ("not a model", "not a model"),
    ):
        vision = MagicMock()
        vision.HandLandmarker.create_from_options.side_effect = OSError(problem)
        modules = (None, vision, MagicMock())
        monkeypatch.setattr(picture_tracker, "_mediapipe", lambda modules=modules: modules)
        with pytest.raises(SourceError, match=words):
            picture_tracker.HandLandmarker(model)
