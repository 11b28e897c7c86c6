"""Scene of the task ``relocate``: a ball, a cylinder or a cube on a table, and a target in the
air."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Self

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.scene import add_shape
from smooth_operator.simulation.scenes.table_scene import TOP, TableScene, mount_over

SHAPES: Final = {
    "ball": (mujoco.mjtGeom.mjGEOM_SPHERE, np.array([0.035]), 0.18),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, np.array([0.025, 0.05]), 0.12),
    "cube": (mujoco.mjtGeom.mjGEOM_BOX, np.array([0.02, 0.02, 0.02]), 0.06),
}
"""Name -> kind of shape, radius or half lengths [m], the last one upright, and mass [kg]. The ball
has the size and mass of Adroit's (Gymnasium-Robotics ``relocate``)."""

_TARGET: Final = (0.0, 0.15, 0.22)  # from the object's place on the table to the target [m]
_ABOVE: Final = 0.20  # height of the grasp centre above the table at the start [m]
_PITCH: Final = np.radians(45.0)  # tilt of the fingers down from level at the start
_FRICTION: Final = (0.8, 0.002)  # rubber on plastic; torsion of a soft fingertip [m]
_MARK: Final = 0.03  # radius of the mark at the target [m]


@dataclass(frozen=True, eq=False)
class RelocateScene(TableScene):
    """Scene with the hand above the object, the palm facing down and the fingers tilted.

    Attributes:
        shape: name of the object's shape in ``SHAPES``.
    """

    shape: str

    def varied(self, shape: int, shift: Float[np.ndarray, "3"]) -> Self:
        """Returns the scene with another shape or target; see ``Scene.varied``."""
        name = list(SHAPES)[shape % len(SHAPES)]
        (x, y, _), turn = self.start
        start = (np.array([x, y, TOP + self.scale * SHAPES[name][1][-1]]), turn)
        return replace(self, shape=name, start=start, target=self.target + self.scale * shift)

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Adds the table, and the mark at the target."""
        super().add_platform(world)
        world.worldbody.add_geom(
            name="target",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=(_MARK * self.scale, 0.0, 0.0),
            pos=self.target,
            rgba=(0.0, 0.62, 0.45, 0.35),
            contype=0,
            conaffinity=0,
        )

    def add_object(self, body: mujoco.MjsBody) -> None:
        """Adds the ball, cylinder or cube."""
        kind, size, mass = SHAPES[self.shape]
        add_shape(
            body,
            self.shape,
            kind,
            self.scale * size,
            mass=self.scale**3 * mass,
            friction=_FRICTION,
            color=(0.84, 0.37, 0.0, 1.0),
        )


def relocate_scene(hand: Hand, shape: str = "ball", scale: float = 1.0) -> RelocateScene:
    """Makes the scene with the hand's grasp centre above the object; HandModelError if the gap
    between thumb and fingers can't be 5 cm.

    Args:
        shape: name in ``SHAPES``.
        scale: factor of the object's lengths; its mass has the third power of it.
    """
    tilt = np.tan(_PITCH)
    at = mount_over(hand, (0.0, 0.0, TOP + _ABOVE), up=(-tilt, 0, -1), forward=(1, 0, 0))
    place = np.array([0.0, 0.0, TOP + scale * SHAPES[shape][1][-1]])
    return RelocateScene(
        mount=at,
        start=(place, np.array([1.0, 0.0, 0.0, 0.0])),
        target=np.array([0.0, 0.0, TOP]) + scale * np.array(_TARGET),
        scale=scale,
        shape=shape,
    )
