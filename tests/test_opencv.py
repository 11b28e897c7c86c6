"""An OpenCV that is installed and can't be loaded."""

import json
import os
import sys
from unittest.mock import MagicMock

import pytest
from processes import python

from smooth_operator.errors import SourceError
from smooth_operator.teleop.sources.webcam import picture_tracker

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

PROGRAM = """
import json, sys
from smooth_operator.errors import SourceError
from smooth_operator.teleop.sources.webcam.camera import opencv
before, texts = list(sys.path), []
for _ in range(2):
    try:
        opencv()
    except SourceError as error:
        texts.append(str(error))
try:
    import cv2  # as another library does
except ImportError as error:
    texts.append(type(error).__name__)
modules = [name for name, module in sys.modules.items() if name.startswith("cv2") and module]
print(json.dumps([sys.path == before, modules, texts]))
"""


def test_a_failed_import_of_opencv_names_the_packages_of_the_system(tmp_path):
    (tmp_path / "cv2").mkdir()
    (tmp_path / "cv2" / "__init__.py").write_text(LOADER)
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = python("-c", PROGRAM, env={**os.environ, "PYTHONPATH": path}, check=True)
    restored, modules, texts = json.loads(done.stdout)
    assert restored
    assert modules == []
    first, second, third = texts
    assert first == second
    assert third == "ImportError"
    assert "libGL.so.1" in first
    if sys.platform.startswith("linux"):
        assert "apt install libgl1 libglib2.0-0 libxcb1" in first


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
