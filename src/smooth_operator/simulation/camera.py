"""A simulated camera that renders pictures of a simulated hand and its object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from smooth_operator.errors import ConfigError
from smooth_operator.simulation.arms.arm import hand_directions
from smooth_operator.simulation.physics import FURNISHED, HandPhysics
from smooth_operator.simulation.renderer import open_renderer
from smooth_operator.simulation.scenes.physics import ScenePhysics

_DISTANCE_M: Final = 0.45  # distance of the camera from the object [m]
_HAND_LENGTHS: Final = 2.0  # distance from a hand without a task, in lengths of the hand
_SLANT: Final = np.radians(30.0)  # angle between the view of such a hand and its palm's normal
_TOO_COSTLY: Final = ("SHADOW", "REFLECTION")  # nine tenths of the time without a graphics card


@dataclass(frozen=True)
class View:
    """Position and direction of a camera. Fields that are None are chosen from the hand and its
    task.

    Attributes:
        azimuth: azimuth of the direction of view, in MuJoCo's convention [degrees].
        elevation: elevation of the direction of view [degrees]; negative looks down.
        distance: distance from the point in the middle of the picture [m].
    """

    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None


class SimulatedCamera:
    """An off-screen camera that looks at a hand's object, or at the hand if there is no task.

    It has its own state, so the physics can continue in another thread. A picture must be drawn on
    the thread that made the camera.

    Args:
        physics: the hand, and its scene if there is one.
        width: width of a picture [px].
        height: height of a picture [px].
        view: place of the camera.

    Raises:
        ConfigError: a size or distance is out of range; this machine can't draw with OpenGL.
    """

    def __init__(
        self, physics: HandPhysics, width: int = 320, height: int = 240, view: View | None = None
    ) -> None:
        view = view or View()
        if not (16 <= width <= 4096 and 16 <= height <= 4096):
            raise ConfigError(
                f"camera: width and height must be 16 to 4096 pixels, not {width} x {height}"
            )
        if view.distance is not None and not 0.01 <= view.distance <= 10.0:
            raise ConfigError(f"camera: the distance must be 0.01 to 10 m, not {view.distance}")
        model = physics.model
        model.vis.quality.offsamples = 0  # antialiasing takes most of the time on a processor
        if not isinstance(physics, ScenePhysics):  # a scene has its own light
            model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.4, 0.6
        self._model, self._data = model, mujoco.MjData(model)
        self._renderer = open_renderer(model, width, height)
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        self._data.qpos[:] = physics.data.qpos
        target, azimuth, elevation, distance = _aim(physics, self._data)
        self._camera.lookat[:] = target
        self._camera.azimuth = azimuth if view.azimuth is None else view.azimuth
        self._camera.elevation = elevation if view.elevation is None else view.elevation
        self._camera.distance = distance if view.distance is None else view.distance

    def draw(self, qpos: Float[np.ndarray, " q"]) -> UInt8[np.ndarray, "h w 3"]:
        """Renders a (height, width, 3) picture with the channels red, green and blue.

        Args:
            qpos: (q,) positions of the physics' model: joints and object.
        """
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._renderer.update_scene(self._data, self._camera)
        for name in _TOO_COSTLY:
            self._renderer.scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{name}")] = 0
        return np.array(self._renderer.render())

    def close(self) -> None:
        """Releases the OpenGL context."""
        self._renderer.close()


def _aim(
    physics: HandPhysics, data: mujoco.MjData
) -> tuple[Float[np.ndarray, "3"], float, float, float]:
    """(3,) point in the middle of the picture [m], azimuth, elevation [degrees], distance [m]."""
    if isinstance(physics, ScenePhysics):
        azimuth, elevation = physics.scene.view
        if physics.hand.spec.side == "left":
            azimuth = -azimuth
        return np.asarray(physics.scene.start[0]), azimuth, elevation, _DISTANCE_M
    hand = physics.hand
    mujoco.mj_kinematics(physics.model, data)
    name = hand.spec.palm
    if mujoco.mj_name2id(physics.model, mujoco.mjtObj.mjOBJ_BODY, name) < 0:
        name = FURNISHED + name  # the hand is on an arm
    body = physics.model.body(name).id
    turn, place = data.xmat[body].reshape(3, 3), data.xpos[body]
    tips = hand.tips(hand.full_configuration(hand.neutral)[None])[0]
    points = np.concatenate([tips, hand.wrist[None]])
    length = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
    distal, _, palmar = hand_directions(hand)
    look = turn @ (-np.cos(_SLANT) * palmar - np.sin(_SLANT) * distal)
    azimuth = float(np.degrees(np.arctan2(look[1], look[0])))
    elevation = float(np.degrees(np.arcsin(np.clip(look[2], -1.0, 1.0))))
    return place + turn @ points.mean(axis=0), azimuth, elevation, _HAND_LENGTHS * length
