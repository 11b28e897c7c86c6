"""Writes an animated picture of a retargeted recording, with human and robot hands side by side."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from jaxtyping import Bool, Float, UInt8

from smooth_operator import poses
from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import ConfigError
from smooth_operator.landmarks import BASES, BONES
from smooth_operator.simulation.renderer import open_renderer
from smooth_operator.teleop.pages.hand_view import (
    FOV,
    HIGHLIGHT,
    PALM,
    HandView,
    Rgb,
    camera_for,
    finger_colors,
    moved,
    palm_to_model,
    view_axes,
)
from smooth_operator.teleop.pages.player import Playback, check_runs

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
    """Writes an animated GIF or WebP that plays in a loop.

    Args:
        runs: runs to draw: the human hand of the first run, and the robot hand of each.
        path: the file; ``.gif`` or ``.webp``.
        track: wraps the iteration over the pictures, for a progress bar.

    Raises:
        ConfigError: the file has another suffix, or this machine can't draw with OpenGL.
        RecordingError: the runs do not have the same frames and fingers.
        OutputError: the file can't be written.
    """
    from PIL import Image

    check_runs(runs)
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"a clip must be a {' or a '.join(SUFFIXES)} file, not {path.name!r}")
    times = runs[0].times
    due = np.arange(times[0], times[-1] + 1e-9, 1.0 / RATE_HZ)
    rows = np.clip(np.searchsorted(times, due), 0, len(times) - 1)
    panes = [_Pane(runs[0], human=True), *(_Pane(run) for run in runs)]
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
        drawn,
        format=path.suffix[1:].upper(),
        save_all=True,
        append_images=pictures[1:],
        duration=round(1000 / RATE_HZ),
        loop=0,
        optimize=True,
        quality=80,
        method=4,
    )
    with atomic_write(path) as file:
        file.write(drawn.getvalue())


class _Pane:
    """Draws one hand of a run: the human hand, or the robot hand with its own materials.

    Args:
        run: the run whose hand is drawn.
        human: True to draw the human hand, False to draw the robot hand.
    """

    def __init__(self, run: Playback, human: bool = False) -> None:
        trace = run.trace
        self._human = trace.human if human else None
        self._views: Float[np.ndarray, "T 7"] | None = None
        self._pinches, self._landmarks = run.pinches(), run.tips
        self._colors: list[Rgb] = [tuple(c) for c in finger_colors(len(run.tips)).tolist()]
        self._axes = view_axes(HandView(run.hand, simple=True))
        if human:
            self._model = mujoco.MjModel.from_xml_string("<mujoco/>")
            self._tips = trace.human_tips
            cloud = trace.human.reshape(-1, 3)
            cloud = cloud[np.isfinite(cloud).all(axis=-1)]
        else:
            drawn = run.drawn or run.hand
            self._model, world = drawn.model, palm_to_model(drawn)
            palm = poses.invert(world)
            positions = np.tile(drawn.full_configuration(drawn.neutral), (len(run), 1))
            order = [drawn.joint_names.index(name) for name in run.hand.joint_names]
            positions[:, order] = trace.joint_positions
            self._qpos, self._axes = drawn.qpos(positions), poses.rotate(palm[3:], self._axes)
            self._tips = moved(palm, trace.robot_tips)
            if run.palms is not None:  # the world as seen from a palm at rest
                seen = poses.compose(palm, poses.invert(run.palms))
                self._views = poses.compose(seen, world)
            wrist = moved(palm, trace.robot_wrist)
            cloud = np.concatenate([self._tips.reshape(-1, 3), [wrist]])
        self._data = mujoco.MjData(self._model)
        self._renderer = open_renderer(self._model, *PANE)
        self._model.vis.headlight.ambient[:] = _AMBIENT
        self._model.vis.headlight.diffuse[:] = _DIFFUSE
        self._model.vis.global_.fovy = float(np.rad2deg(FOV))
        self._aim(cloud)

    def draw(self, frame: int) -> UInt8[np.ndarray, "H W 3"]:
        """Draws a frame."""
        tips = self._tips[frame]
        if self._human is None:
            self._data.qpos[:] = self._qpos[frame]
        mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data)
        scene = self._renderer.scene
        position, forward, up = self._position, self._forward, self._up
        if self._views is not None:
            view = self._views[frame]
            position = moved(view, position)
            forward, up = poses.rotate(view[3:], forward), poses.rotate(view[3:], up)
        for camera in scene.camera:  # a free camera of MuJoCo's has z upwards
            camera.pos, camera.forward, camera.up = position, forward, up
        scene.lights[0].pos, scene.lights[0].dir = position, forward
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        if self._human is not None:
            self._draw_human(scene, self._human[frame])
        lit = self._pinches[frame]
        for tip, color, pinched in zip(tips[1:], self._colors[1:], lit, strict=True):
            _rod(scene, tips[0], tip, _LINE, HIGHLIGHT if pinched else color)
        picture = np.asarray(self._renderer.render()).copy()
        picture[self._empty(picture)] = _PAPER
        return picture

    def _empty(self, picture: UInt8[np.ndarray, "H W 3"]) -> Bool[np.ndarray, "H W"]:
        """The pixels without a hand. MuJoCo draws them black, but some robots are black too."""
        black = picture.max(axis=-1) == 0
        if self._human is not None:
            return np.asarray(black)
        self._renderer.enable_depth_rendering()
        far = self._renderer.render() > _FAR
        self._renderer.disable_depth_rendering()
        return np.asarray(black & far)

    def close(self) -> None:
        """Frees the OpenGL context."""
        self._renderer.close()

    def _draw_human(self, scene: Any, points: Float[np.ndarray, "21 3"]) -> None:
        owner = {
            landmark: color
            for tip, color in zip(self._landmarks, self._colors, strict=True)
            for landmark in range(tip - 3, tip + 1)
        }
        for parent, child in BONES:
            color = PALM if child in BASES else owner.get(child, PALM)
            _rod(scene, points[parent], points[child], _BONE, color)

    def _aim(self, cloud: Float[np.ndarray, "N 3"]) -> None:
        """Places the camera so that it sees these points."""
        across = cloud @ self._axes.T
        low, high = across.min(axis=0) - 0.02, across.max(axis=0) + 0.02
        half = (float(high[0] - low[0]) / 2, float(high[1] - low[1]) / 2)
        centre = (low + high) / 2 @ self._axes
        self._position, target = camera_for(self._axes, centre, half, PANE[0] / PANE[1])
        self._forward = (target - self._position) / np.linalg.norm(target - self._position)
        up = self._axes[1] - (self._axes[1] @ self._forward) * self._forward
        self._up = up / np.linalg.norm(up)


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
