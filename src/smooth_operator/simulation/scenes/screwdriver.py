"""Screwdriver pivot: held level by the fingers, to be let down until its blade points downwards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco
import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.mount import mount
from smooth_operator.simulation.scenes.reach import opposition
from smooth_operator.simulation.scenes.scene import Scene, add_shape

HANDLE: Final = (0.010, 0.085)
"""Radius and length of the handle [m]."""

SHAFT: Final = (0.003, 0.090)
"""Radius and length of the shaft [m]."""

MASSES: Final = (0.035, 0.020)
"""Of the handle and of the steel shaft [kg]."""

GRIP: Final = 0.052
"""From the handle's end to where thumb and index finger take it [m]."""

_HIGH: Final = 0.40  # of the wrist [m]
_GRIPS: Final = (0.9, 0.002)


@dataclass(frozen=True, eq=False)
class ScrewdriverScene(Scene):
    """The fingers point down; the handle lies level between thumb and fingers.

    The object's frame: z from the handle's end to the blade's tip, the origin where it is gripped.
    """

    view: ClassVar = (200.0, -5.0)

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Nothing: it is in the hand, or on the floor."""

    def add_object(self, body: mujoco.MjsBody) -> None:
        """Handle and shaft; heavier on the blade's side of the grip."""
        radius, length = HANDLE
        add_shape(
            body, "handle", mujoco.mjtGeom.mjGEOM_CAPSULE, (radius, length / 2 - radius),
            mass=MASSES[0], friction=_GRIPS, color=(0.9, 0.45, 0.1, 1.0),
            at=(0, 0, length / 2 - GRIP),
        )  # fmt: skip
        add_shape(
            body, "shaft", mujoco.mjtGeom.mjGEOM_CAPSULE, (SHAFT[0], SHAFT[1] / 2 - SHAFT[0]),
            mass=MASSES[1], friction=(0.4, 0.001), color=(0.55, 0.57, 0.6, 1.0),
            at=(0, 0, length - GRIP + SHAFT[1] / 2),
        )  # fmt: skip


def screwdriver_scene(hand: Hand) -> ScrewdriverScene:
    """The screwdriver between thumb and fingers, along their row, the blade on the thumb's side.

    Raises:
        HandModelError: thumb and index finger never are a handle's thickness apart.
    """
    at = mount(hand, up=(-1, 0, 0), forward=(0, 0, 1), wrist=(0.0, 0.0, _HIGH))
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
