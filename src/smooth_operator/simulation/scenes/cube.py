"""Scene of the cube rotation: a cube on a pedestal below the hand, to be turned by 90 degrees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco
import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.mount import mount, opposition, reachable
from smooth_operator.simulation.scenes.scene import PLATFORM, Scene, add_shape

EDGE: Final = 0.040
"""Edge length of the cube [m]."""

MASS: Final = 0.045
"""Mass of the cube, printed with an infill of two thirds [kg]."""

_TOP: Final = 0.18  # height of the pedestal's top [m]
_PEDESTAL: Final = 0.055  # half of the pedestal's side [m]
_PEDESTAL_FRICTION: Final = (0.2, 0.001)
_CUBE_FRICTION: Final = (0.9, 0.002)
_TAG: Final = 0.0005  # thickness of a coloured face [m]

_FACES: Final = (
    ((1, 0, 0), (0.84, 0.37, 0.0, 1.0)), ((-1, 0, 0), (0.0, 0.45, 0.7, 1.0)),
    ((0, 1, 0), (0.0, 0.62, 0.45, 1.0)), ((0, -1, 0), (0.8, 0.47, 0.65, 1.0)),
    ((0, 0, 1), (0.94, 0.89, 0.26, 1.0)),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class CubeScene(Scene):
    """The palm looks down on a cube that stands within the fingertips' reach.

    Attributes:
        top: height of the pedestal's top [m].
    """

    view: ClassVar = (150.0, -35.0)

    top: float

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """The pedestal."""
        x, y, _ = self.start[0]
        add_shape(
            world.worldbody, PLATFORM, mujoco.mjtGeom.mjGEOM_BOX,
            (_PEDESTAL, _PEDESTAL, self.top / 2), mass=0.0, friction=_PEDESTAL_FRICTION,
            at=(x, y, self.top / 2), color=(0.62, 0.5, 0.38, 1.0), priority=2,
        )  # fmt: skip

    def add_object(self, body: mujoco.MjsBody) -> None:
        """The cube, with a colour for each face."""
        half = EDGE / 2
        add_shape(
            body, "cube", mujoco.mjtGeom.mjGEOM_BOX, (half, half, half), mass=MASS,
            friction=_CUBE_FRICTION, color=(0.9, 0.9, 0.9, 1.0),
        )  # fmt: skip
        for normal, color in _FACES:
            n = np.array(normal, float)
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, pos=half * n, rgba=color, mass=0.0,
                size=np.where(n != 0, _TAG, 0.8 * half), contype=0, conaffinity=0, group=1,
            )  # fmt: skip


def cube_scene(hand: Hand) -> CubeScene:
    """Scene with the cube midway between thumb and fingers, its upper half in reach of the tips.

    Raises:
        HandModelError: thumb and index finger are in no pose a cube's width apart.
    """
    middle = np.concatenate([opposition(hand, name, EDGE) for name in hand.fingers[1:3]])
    deepest = float(np.quantile(reachable(hand)[:, 1:3, 2], 0.97))  # palmar
    distal, radial = (float(value) for value in np.median(middle[:, :2], axis=0))
    depth = deepest - 0.25 * EDGE  # cube's centre below the wrist
    at = mount(hand, up=(0, 0, -1), forward=(1, 0, 0), wrist=(0.0, 0.0, _TOP + EDGE / 2 + depth))
    centre = at.world((distal, radial, depth))
    reach = np.array([_PEDESTAL + EDGE, _PEDESTAL + EDGE, EDGE])
    return CubeScene(
        mount=at, start=(centre, np.array([1.0, 0.0, 0.0, 0.0])), lower=centre - reach,
        upper=centre + reach * (1, 1, 3), fixture=False, top=_TOP,
    )  # fmt: skip
