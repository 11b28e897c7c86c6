"""``view --save``: a moving picture of human and robots, drawn without a display."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence
from processes import python

from smooth_operator.cli import main
from smooth_operator.errors import ConfigError
from smooth_operator.simulation import renderer
from smooth_operator.teleop.pages.clip import PANE, RATE_HZ

METHOD = ("--method", "joint_angle", "--quiet")


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("clip")
    recording = str(folder / "hand.npz")
    assert main(["sample", recording, "--duration", "1.2", "--quiet"]) == 0
    assert main(["retarget", recording, *METHOD, "--output", str(folder / "out.npz")]) == 0
    return folder


def view(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """The command on a machine without a display: it finds EGL or OSMesa by itself."""
    chosen = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")
    env = {name: value for name, value in os.environ.items() if name not in chosen}
    files = ("out.npz", "out.npz", "hand.npz")
    return python("-m", "smooth_operator", "view", *files, *options, cwd=folder, env=env)


@pytest.mark.parametrize("suffix", ["gif", pytest.param("webp", marks=pytest.mark.weekly)])
def test_a_clip_shows_every_hand_in_real_time(made, suffix):
    done = view(made, "--frames", "20:50", "--save", f"new/clip.{suffix}")
    if done.returncode == 2 and "can't draw with OpenGL" in done.stderr:
        pytest.skip("this machine has nothing to draw with")
    assert done.returncode == 0, done.stderr
    assert "GLFW" not in done.stderr
    with Image.open(made / "new" / f"clip.{suffix}") as clip:
        frames = [
            np.asarray(one.convert("RGB")).astype(int) for one in ImageSequence.Iterator(clip)
        ]
        assert clip.size == (3 * PANE[0], PANE[1])  # the human, and the robot of each file
        assert clip.info.get("loop", 0) == 0
    assert len(frames) == round(0.3 * RATE_HZ)
    for pane in range(3):
        part = np.s_[60:-20, pane * PANE[0] : (pane + 1) * PANE[0]]
        assert (frames[0][part].min(axis=-1) < 200).mean() > 0.02  # a hand is there
        assert (np.abs(frames[-1][part] - frames[0][part]).max(axis=-1) > 40).mean() > 0.002


def test_what_can_be_mended_is_said(made, capsys):
    names = [str(made / name) for name in ("out.npz", "hand.npz")]
    assert main(["view", *names, "--save", str(made / "clip.mp4")]) == 2
    assert "a clip must be a .gif or a .webp file, not 'clip.mp4'" in capsys.readouterr().err
    assert main(["view", *names, "--frames", "x", "--save", str(made / "clip.gif")]) == 2
    assert not (made / "clip.gif").exists()


def test_a_machine_that_cannot_draw_says_what_to_install(monkeypatch):
    environment: dict[str, str] = {}
    monkeypatch.setattr(os, "environ", environment)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    libraries: list[str] = []
    monkeypatch.setattr(renderer, "find_library", lambda name: name in libraries)
    with pytest.raises(ConfigError, match="libegl1"):
        renderer.draw_off_screen()
    libraries.append("OSMesa")
    renderer.draw_off_screen()
    assert environment == {"MUJOCO_GL": "osmesa"}
