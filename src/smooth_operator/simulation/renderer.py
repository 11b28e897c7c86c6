"""Renders pictures of a MuJoCo model without opening a window."""

from __future__ import annotations

import os
import sys
from ctypes.util import find_library
from typing import TYPE_CHECKING, Final

from smooth_operator.errors import ConfigError

if TYPE_CHECKING:
    import mujoco

_ADVICE: Final = (
    "without a display, install EGL (Debian, Ubuntu: libegl1) or OSMesa (libosmesa6), or set the "
    "environment variable MUJOCO_GL to egl or osmesa where it is installed"
)


def draw_off_screen() -> None:
    """Makes MuJoCo draw with EGL or OSMesa on a Linux machine without a display.

    MuJoCo chooses its OpenGL backend when it is imported, so call this function before. A choice in
    the environment variable MUJOCO_GL is kept.

    Raises:
        ConfigError: there is neither a display nor one of the two libraries.
    """
    if not _needs_a_display() or "mujoco" in sys.modules or os.environ.get("MUJOCO_GL"):
        return
    for name in ("EGL", "OSMesa"):
        if find_library(name):
            os.environ["MUJOCO_GL"] = name.lower()
            return
    raise ConfigError(f"this machine can't draw with OpenGL: {_ADVICE}")


def _needs_a_display() -> bool:
    """True if MuJoCo would draw on a Linux display and there is none."""
    choice = os.environ.get("MUJOCO_GL", "").strip().lower()
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return sys.platform == "linux" and choice not in ("egl", "osmesa") and not display


def open_renderer(
    model: mujoco.MjModel, width: int, height: int, *, most_shapes: int = 10000
) -> mujoco.Renderer:
    """Opens a renderer for a model. The caller must close it.

    Args:
        model: the model; its off-screen buffer is enlarged to the size of the picture.
        width: width of the picture [px].
        height: height of the picture [px].
        most_shapes: largest number of shapes in a picture.

    Raises:
        ConfigError: this machine can't draw with OpenGL.
    """
    import mujoco

    if _needs_a_display():  # MuJoCo would try to open it, which may end the process
        raise ConfigError(f"this machine can't draw with OpenGL: {_ADVICE}")
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    try:
        return mujoco.Renderer(model, height, width, max_geom=most_shapes)
    except Exception as error:  # each backend has errors of its own
        raise ConfigError(f"this machine can't draw with OpenGL ({error}); {_ADVICE}") from error
