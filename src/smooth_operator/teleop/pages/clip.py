"""A moving picture of a retargeted recording: the human hand and each robot hand, side by side."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from jaxtyping import Bool, Float, UInt8

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import ConfigError
from smooth_operator.landmarks import BASES, BONES
from smooth_operator.simulation.renderer import open_renderer
from smooth_operator.teleop.pages.hand_view import HIGHLIGHT, PALM, Rgb, finger_colors
from smooth_operator.teleop.pages.page_layout import FOV, camera_for, view_axes
from smooth_operator.teleop.pages.playback import Playback, check_runs

RATE_HZ: Final = 20.0
PANE: Final = (300, 360)
"""Width and height of each hand's picture [px]."""
SUFFIXES: Final = (".gif", ".webp")

_BONE, _LINE = 0.0052, 0.0012  # radii [m]
_FAR: Final = 4.0  # of what is no hand [m]
_PAPER: Final = (244, 245, 247)
_INK: Final = (40, 46, 52)
_COLORS: Final = 96  # of a GIF's palette
_AMBIENT, _DIFFUSE = 0.42, 0.6  # of the light at the camera: no room of the model has one


def save_clip(
    runs: Sequence[Playback],
    path: Path,
    *,
    track: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> None:
    """Writes a GIF or WebP that loops.

    Args:
        runs: runs to draw: the human of the first, the robot of each.
        path: the file; ``.gif`` or ``.webp``.
        track: wraps the pictures' numbers, for a progress bar.

    Raises:
        ConfigError: the suffix is another, or this machine can't draw with OpenGL.
        RecordingError: the runs are not of the same frames and fingers.
        OutputError: the file can't be written.
    """
    from PIL import Image

    check_runs(runs)
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"a clip is a {' or a '.join(SUFFIXES)}, not {path.name!r}")
    times = runs[0].times
    due = np.arange(times[0], times[-1] + 1e-9, 1.0 / RATE_HZ)
    rows = np.clip(np.searchsorted(times, due), 0, len(times) - 1)
    panes = [_Pane(runs[0], None), *(_Pane(run, run) for run in runs)]
    try:
        pictures = [
            _labelled(np.concatenate([pane.draw(int(row)) for pane in panes], axis=1), runs)
            for row in track(rows.tolist())
        ]
    finally:
        for pane in panes:
            pane.close()
    if path.suffix.lower() == ".gif":
        palette = Image.fromarray(np.concatenate([np.asarray(p) for p in pictures[::8]]))
        shared = palette.quantize(_COLORS, dither=Image.Dither.NONE)
        pictures = [p.quantize(palette=shared, dither=Image.Dither.NONE) for p in pictures]
    drawn = io.BytesIO()
    pictures[0].save(
        drawn, format=path.suffix[1:].upper(), save_all=True, append_images=pictures[1:],
        duration=round(1000 / RATE_HZ), loop=0, optimize=True, quality=80, method=4,
    )  # fmt: skip
    with atomic_write(path) as file:
        file.write(drawn.getvalue())


class _Pane:
    """The picture of one hand: the human's of a run, or its robot's with its own materials.

    Args:
        run: whose human hand, or which robot, it is.
        robot: the run if it is the robot's; None for the human's.
    """

    def __init__(self, run: Playback, robot: Playback | None) -> None:
        self._run, self._robot = run, robot
        self._pinches = run.pinches()
        self._model = robot.model if robot else mujoco.MjModel.from_xml_string("<mujoco/>")
        self._data = mujoco.MjData(self._model)
        self._renderer = open_renderer(self._model, *PANE)
        self._model.vis.headlight.ambient[:] = _AMBIENT
        self._model.vis.headlight.diffuse[:] = _DIFFUSE
        self._axes = np.stack(view_axes(run))
        self._camera = self._aimed()

    def draw(self, frame: int) -> UInt8[np.ndarray, "H W 3"]:
        """The picture of a frame."""
        tips = self._run.human[frame, list(self._run.human_tips)]
        if self._robot:
            self._data.qpos[:] = self._robot.qpos[frame]
            tips = self._robot.robot_tips[frame]
        mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, self._camera)
        scene = self._renderer.scene
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        if not self._robot:
            self._draw_human(scene, self._run.human[frame])
        lit = self._pinches[frame]
        for tip, color, pinched in zip(tips[1:], self._colors[1:], lit, strict=True):
            _rod(scene, tips[0], tip, _LINE, HIGHLIGHT if pinched else color)
        picture = np.asarray(self._renderer.render()).copy()
        picture[self._empty(picture)] = _PAPER
        return picture

    def _empty(self, picture: UInt8[np.ndarray, "H W 3"]) -> Bool[np.ndarray, "H W"]:
        """The pixels without a hand: there MuJoCo draws black, as some robots are."""
        black = picture.max(axis=-1) == 0
        if not self._robot:
            return np.asarray(black)
        self._renderer.enable_depth_rendering()
        far = self._renderer.render() > _FAR
        self._renderer.disable_depth_rendering()
        return np.asarray(black & far)

    def close(self) -> None:
        """Gives the OpenGL context back."""
        self._renderer.close()

    @property
    def _colors(self) -> list[Rgb]:
        return [tuple(c) for c in finger_colors(len(self._run.fingers)).tolist()]

    def _draw_human(self, scene: Any, points: Float[np.ndarray, "21 3"]) -> None:
        owner = {
            landmark: color
            for tip, color in zip(self._run.human_tips, self._colors, strict=True)
            for landmark in range(tip - 3, tip + 1)
        }
        for parent, child in BONES:
            color = PALM if child in BASES else owner.get(child, PALM)
            _rod(scene, points[parent], points[child], _BONE, color)

    def _aimed(self) -> mujoco.MjvCamera:
        """A camera that sees this hand in every frame."""
        if self._robot:
            cloud = np.concatenate(
                [self._robot.robot_tips.reshape(-1, 3), [self._robot.robot_wrist]]
            )
        else:
            points = self._run.human.reshape(-1, 3)
            cloud = points[np.isfinite(points).all(axis=-1)]
        across = cloud @ self._axes.T
        low, high = across.min(axis=0) - 0.02, across.max(axis=0) + 0.02
        half = (float(high[0] - low[0]) / 2, float(high[1] - low[1]) / 2)
        centre = (low + high) / 2 @ self._axes
        position, target = camera_for(self._axes, centre, half, PANE[0] / PANE[1])
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        return _placed(camera, self._model, position, target)


def _placed(
    camera: mujoco.MjvCamera,
    model: mujoco.MjModel,
    position: Float[np.ndarray, "3"],
    target: Float[np.ndarray, "3"],
) -> mujoco.MjvCamera:
    """A free camera at a place; MuJoCo's free cameras have z upwards."""
    model.vis.global_.fovy = float(np.rad2deg(FOV))
    offset = target - position
    distance = float(np.linalg.norm(offset))
    camera.lookat[:] = target
    camera.distance = distance
    camera.azimuth = float(np.rad2deg(np.arctan2(offset[1], offset[0])))
    camera.elevation = float(np.rad2deg(np.arcsin(offset[2] / distance)))
    return camera


def _rod(
    scene: Any,
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
    radius: float,
    color: Rgb,
) -> None:
    if scene.ngeom >= scene.maxgeom or not np.isfinite([start, end]).all():
        return
    geom = scene.geoms[scene.ngeom]
    rgba = np.array([*(np.array(color) / 255.0), 1.0], np.float32)
    kind = mujoco.mjtGeom.mjGEOM_CAPSULE
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
    mujoco.mjv_connector(geom, kind, radius, start, end)
    scene.ngeom += 1


def _labelled(picture: UInt8[np.ndarray, "H W 3"], runs: Sequence[Playback]) -> Any:
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(picture)
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(15)
    for i, name in enumerate(("human", *(run.label for run in runs))):
        pen.text((PANE[0] * (i + 0.5), 8), name, fill=_INK, font=font, anchor="ma")
    return image
