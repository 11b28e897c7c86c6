"""An OpenXR runtime for tests: builds ``openxr_runtime.c``, and gives it hands."""

import ctypes
import functools
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import headset_apps as app
import numpy as np
import pytest

from smooth_operator.io.landmark_order import chirality
from smooth_operator.poses import separation
from smooth_operator.types import HandFrame, Side

COMPILER = shutil.which("cc") or shutil.which("gcc")
NEEDS_COMPILER = pytest.mark.skipif(
    COMPILER is None or sys.platform != "linux", reason="needs Linux and a C compiler"
)

HANDS: dict[Side, int] = {"left": 1, "right": 2}
POSES: dict[Side, app.Pose] = {
    "left": (0.5, 0.25, 1.0, 1.0, 0.0, 0.0, 0.0),
    "right": (0.4, -0.3, 1.1, 0.6, -0.48, 0.384, 0.512),
}


class Joint(ctypes.Structure):
    """XrHandJointLocationEXT."""

    _fields_ = (
        ("flags", ctypes.c_uint64),
        ("orientation", ctypes.c_float * 4),
        ("position", ctypes.c_float * 3),
        ("radius", ctypes.c_float),
    )


def joints(side: Side, move: float = 0.0, flags: Sequence[int] = (15,) * 26) -> Any:
    """26 joints in OpenXR's axes: the palm, then those of WebXR, all turned as the wrist."""
    pose, hand = POSES[side], app.hand(side)
    local = np.vstack([(hand[10] + hand[11]) / 2, hand])
    world = local @ app.turn(pose[3:]).T + np.asarray(pose[:3]) + [move, 0.0, 0.0]
    array = (Joint * 26)()
    for one, point, flag in zip(array, world, flags, strict=True):
        one.flags, one.radius = flag, 0.01
        one.position[:] = app.openxr_point(point)
        one.orientation[:] = app.openxr_turn(pose[3:])
    return array


@functools.cache
def _library() -> tempfile.TemporaryDirectory[str]:
    """Folder with the compiled runtime and its manifest."""
    folder = tempfile.TemporaryDirectory(prefix="openxr")
    source, path = Path(__file__).with_name("openxr_runtime.c"), Path(folder.name, "runtime.so")
    subprocess.run([str(COMPILER), "-shared", "-fPIC", "-w", "-o", path, source], check=True)
    manifest = {"file_format_version": "1.0.0", "runtime": {"library_path": str(path)}}
    path.with_suffix(".json").write_text(json.dumps(manifest))
    return folder


def loaded(monkeypatch: pytest.MonkeyPatch, extensions: int, *, ready: bool = False) -> Any:
    """Makes it the runtime of this process, and returns its functions that steer it: with some of
    its extensions, and no hand."""
    library = Path(_library().name, "runtime.so")
    monkeypatch.setenv("XR_RUNTIME_JSON", str(library.with_suffix(".json")))
    monkeypatch.setenv("XR_LOADER_DEBUG", "none")
    runtime = ctypes.CDLL(str(library))
    runtime.last_time.restype = ctypes.c_int64
    runtime.offer(extensions, 1, 1, 1)
    runtime.be_ready_at_once(int(ready))
    return runtime


def check_frame(frame: HandFrame, world: str) -> None:
    """The hand of ``joints`` in the conventions of the project."""
    pose = np.asarray(POSES[frame.side])
    points = app.landmarks(app.hand(frame.side)) @ app.turn(pose[3:]).T + pose[:3]
    np.testing.assert_allclose(frame.landmarks, points, atol=1e-6)
    assert frame.T_world_wrist is not None
    assert (separation(frame.T_world_wrist, pose) < 1e-5).all()
    assert frame.valid is not None
    assert frame.valid.all()
    assert frame.metacarpals is not None
    assert frame.world == world
    sign = 1.0 if frame.side == "right" else -1.0
    assert sign * chirality(frame.landmarks[None])[0] > 0.25
