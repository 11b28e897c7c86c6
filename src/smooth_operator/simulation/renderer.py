"""Pictures of a MuJoCo model without a window."""

from __future__ import annotations

import mujoco

from smooth_operator.errors import ConfigError


def open_renderer(
    model: mujoco.MjModel, width: int, height: int, *, most_shapes: int = 10000
) -> mujoco.Renderer:
    """A renderer of a model; the caller closes it.

    Args:
        model: the model; its off-screen buffer is enlarged to the size of the picture.
        width: width of the picture [px].
        height: height of the picture [px].
        most_shapes: largest number of shapes in a picture.

    Raises:
        ConfigError: this machine can't draw with OpenGL.
    """
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    try:
        return mujoco.Renderer(model, height, width, max_geom=most_shapes)
    except Exception as error:  # each backend has errors of its own
        raise ConfigError(
            f"this machine can't draw with OpenGL ({error}); without a display, set the "
            "environment variable MUJOCO_GL to egl or osmesa and install that library"
        ) from error
