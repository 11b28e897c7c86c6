"""Film strips of the tasks: the demonstrations, drawn by MuJoCo off screen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from jaxtyping import UInt8

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import StudyError
from smooth_operator.simulation.renderer import open_renderer
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.state import SceneState
from smooth_operator.simulation.tasks.demonstration import Demonstration, load_demonstration, play

_MOMENTS: Final = {
    "card": (0.02, 1.9, 3.5, 4.3),
    "cube": (0.02, 1.1, 1.75, 4.0),
    "screwdriver": (0.02, 1.3, 2.2, 3.4),
}
"""Task -> when [s]."""

_DISTANCE: Final = 0.29  # of the camera [m]
_COLORS: Final = 256  # of the PNG's palette


def film_strip(
    demonstration: Demonstration,
    moments: Sequence[float],
    view: tuple[float, float] | None = None,
    size: tuple[int, int] = (400, 320),
) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures of a demonstration side by side.

    Args:
        demonstration: what is done.
        moments: when [s], in order.
        view: azimuth and elevation of the camera [degrees]; the scene's own if left out.
        size: width and height of each picture.

    Raises:
        ConfigError: this machine can't draw with OpenGL.
        StudyError: the demonstration ends before a moment.
    """
    shots: list[UInt8[np.ndarray, "h w 3"]] = []
    left = list(moments)

    def seen(physics: ScenePhysics, state: SceneState) -> None:
        if left and state.time >= left[0] - 1e-6:
            left.pop(0)
            shots.append(_shot(physics, physics.scene.view if view is None else view, size))

    for _ in play(demonstration, seen=seen):
        pass
    if left:
        raise StudyError(f"the demonstration of {demonstration.task!r} ends before {left[0]} s")
    return np.concatenate(shots, axis=1)


def save_film_strip(task: str, path: str | Path) -> None:
    """Write the film strip of a task's demonstration as a PNG with few colours.

    Raises:
        ConfigError: this machine can't draw with OpenGL.
        OutputError: the file can't be written.
    """
    from PIL import Image

    strip = film_strip(load_demonstration(task), _MOMENTS[task])
    small = Image.fromarray(strip).quantize(_COLORS, dither=Image.Dither.NONE)
    try:
        with atomic_write(path) as file:
            small.save(file, format="PNG", optimize=True)
    except OSError as error:
        raise output_error(path, error) from error


def _shot(
    physics: ScenePhysics, view: tuple[float, float], size: tuple[int, int]
) -> UInt8[np.ndarray, "h w 3"]:
    renderer = open_renderer(physics.model, *size)
    try:
        camera = mujoco.MjvCamera()
        camera.lookat[:] = physics.scene.start[0]
        camera.distance, (camera.azimuth, camera.elevation) = _DISTANCE, view
        renderer.update_scene(physics.data, camera)
        return np.array(renderer.render())
    finally:
        renderer.close()
