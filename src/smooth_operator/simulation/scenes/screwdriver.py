"""Scene of the screwdriver pivot: held level, to be let down until its blade points downwards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco
import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.mount import mount, opposition
from smooth_operator.simulation.scenes.scene import Scene, add_shape

HANDLE: Final = (0.010, 0.085)
"""Radius and length of the handle [m]."""

SHAFT: Final = (0.003, 0.090)
"""Radius and length of the shaft [m]."""

MASSES: Final = (0.035, 0.020)
"""Masses of the handle and of the steel shaft [kg]."""

GRIP: Final = 0.052
"""Distance from the handle's end to the grip of thumb and index finger [m]."""

_WRIST_HEIGHT: Final = 0.40  # [m]
_HANDLE_FRICTION: Final = (0.9, 0.002)


@dataclass(frozen=True, eq=False)
class ScrewdriverScene(Scene):
    """The fingers point down; the handle lies level between thumb and fingers.

    The object's frame has z from the handle's end to the blade's tip and its origin at the grip.
    """

    view: ClassVar = (200.0, -5.0)

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Adds nothing: the screwdriver is in the hand or on the floor."""

    def add_object(self, body: mujoco.MjsBody) -> None:
        """Add handle and shaft; the blade's side of the grip is the heavier one."""
        radius, length = HANDLE
        add_shape(
            body, "handle", mujoco.mjtGeom.mjGEOM_CAPSULE, (radius, length / 2 - radius),
            mass=MASSES[0], friction=_HANDLE_FRICTION, color=(0.9, 0.45, 0.1, 1.0),
            at=(0, 0, length / 2 - GRIP),
        )  # fmt: skip
        add_shape(
            body, "shaft", mujoco.mjtGeom.mjGEOM_CAPSULE, (SHAFT[0], SHAFT[1] / 2 - SHAFT[0]),
            mass=MASSES[1], friction=(0.4, 0.001), color=(0.55, 0.57, 0.6, 1.0),
            at=(0, 0, length - GRIP + SHAFT[1] / 2),
        )  # fmt: skip


def screwdriver_scene(hand: Hand) -> ScrewdriverScene:
    """Scene with the screwdriver between thumb and fingers, along their row, blade at the thumb.

    Raises:
        HandModelError: thumb and index finger are in no pose a handle's thickness apart.
    """
    at = mount(hand, up=(-1, 0, 0), forward=(0, 0, 1), wrist=(0.0, 0.0, _WRIST_HEIGHT))
    between = np.median(opposition(hand, hand.fingers[1], 2 * HANDLE[0]), axis=0)
    centre = at.world(between)
    radial = at.directions[:, 1]
    quaternion = np.zeros(4)
    x = np.array([0.0, 0.0, 1.0])
    mujoco.mju_mat2Quat(quaternion, np.stack([x, np.cross(radial, x), radial], axis=1).ravel())
    return ScrewdriverScene(
        mount=at, start=(centre, quaternion), lower=centre - (0.15, 0.15, 0.10),
        upper=centre + 0.15, fixture=True,
    )  # fmt: skip
