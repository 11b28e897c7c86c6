"""Scenes of the user study's tasks for any hand: card pickup, cube rotation, screwdriver pivot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.relocate import relocate_scene
from smooth_operator.simulation.scenes.scene import (
    PLATFORM,
    Scene,
    add_shape,
    mount,
    opposition,
    reachable,
)
from smooth_operator.simulation.scenes.tools import hammer_scene, tongs_scene

CARD: Final = (0.054, 0.0856, 0.002)
"""Size of the card [m]: area of a bank card, but thicker, since fingers press from both sides."""

CARD_MASS: Final = 0.009
"""Mass of the card, of polypropylene [kg]."""

_TABLE_TOP: Final = 0.18  # height of its top [m]
_TABLE: Final = (0.16, 0.24, 0.02)  # size of the table [m]
_INSET: Final = 0.004  # distance of the card from the edge at the start [m]
_TABLE_FRICTION: Final = (0.25, 0.001)  # plastic on a smooth table
_CARD_FRICTION: Final = (0.9, 0.002)  # rubber on plastic


@dataclass(frozen=True, eq=False)
class CardScene(Scene):
    """Scene in which the table's edge lies across the hand, with the fingers on the table and the
    thumb below it.

    Attributes:
        edge: x of the table's edge; the table lies beyond it [m].
        top: height of the table's top [m].
        reach: largest x at which a finger can press on the table [m].
    """

    view: ClassVar = (150.0, -12.0)

    edge: float
    top: float
    reach: float

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Adds the table."""
        half = np.array(_TABLE) / 2
        add_shape(
            world.worldbody,
            PLATFORM,
            mujoco.mjtGeom.mjGEOM_BOX,
            half,
            mass=0.0,
            at=(self.edge + half[0], float(self.start[0][1]), self.top - half[2]),
            friction=_TABLE_FRICTION,
            color=(0.62, 0.5, 0.38, 1.0),
            priority=2,
        )

    def add_object(self, body: mujoco.MjsBody) -> None:
        """Adds the card."""
        add_shape(
            body,
            "card",
            mujoco.mjtGeom.mjGEOM_BOX,
            np.array(CARD) / 2,
            mass=CARD_MASS,
            friction=_CARD_FRICTION,
            color=(0.85, 0.33, 0.25, 1.0),
        )


def card_scene(hand: Hand) -> CardScene:
    """Makes the scene with table and card where a finger can press on the table and the thumb can
    reach below it; HandModelError if the hand has no such place."""
    tips = reachable(hand)
    thumb, others = tips[:, 0], tips[:, 1:3].reshape(-1, 3)
    best: tuple[float, float, float] | None = None
    most = 0.0
    for depth in np.arange(0.0, 0.121, 0.005):
        press = others[np.abs(others[:, 2] - depth) < 0.005]
        below = thumb[(thumb[:, 2] > depth + 0.002) & (thumb[:, 2] < depth + 0.025)]
        for edge in np.arange(0.04, 0.2, 0.005):
            on = press[(press[:, 0] > edge + 0.008) & (press[:, 0] < edge + 0.04)]
            if len(on) < 50:
                continue
            across = float(np.median(on[:, 1]))
            under = (below[:, 0] > edge - 0.02) & (below[:, 0] < edge + 0.004)
            under &= np.abs(below[:, 1] - across) < 0.025
            score = min(len(on) / len(others), float(under.sum()) / len(thumb))
            if score > most:
                most, best = score, (float(depth), float(edge), across)
    if best is None or most < 5e-4:
        raise HandModelError(
            f"hand {hand.name!r} can't press on a table with a finger and reach below it with the "
            "thumb; choose another task or hand"
        )
    return _placed(hand, others, *best)


def _placed(
    hand: Hand, others: Float[np.ndarray, "k 3"], depth: float, edge: float, across: float
) -> CardScene:
    at = mount(hand, up=(0, 0, -1), forward=(1, 0, 0), wrist=(0.0, 0.0, _TABLE_TOP + depth))
    centre = at.world((edge + _INSET + CARD[0] / 2, across, depth - CARD[2] / 2))
    press = others[np.abs(others[:, 2] - depth) < 0.005]
    lower = np.array([edge - 0.10, centre[1] - 0.12, _TABLE_TOP - 0.05])
    upper = np.array([edge + _TABLE[0] + 0.02, centre[1] + 0.12, _TABLE_TOP + 0.15])
    return CardScene(
        mount=at,
        start=(centre, np.array([1.0, 0.0, 0.0, 0.0])),
        lower=lower,
        upper=upper,
        fixture=False,
        edge=edge,
        top=_TABLE_TOP,
        reach=float(np.quantile(press[:, 0], 0.98)),
    )


CUBE: Final = 0.040
"""Edge length of the cube [m]."""

CUBE_MASS: Final = 0.045
"""Mass of the cube, printed with an infill of two thirds [kg]."""

_TOP: Final = 0.18  # height of the pedestal's top [m]
_PEDESTAL: Final = 0.055  # half of the pedestal's side [m]
_PEDESTAL_FRICTION: Final = (0.2, 0.001)
_CUBE_FRICTION: Final = (0.9, 0.002)
_TAG: Final = 0.0005  # thickness of a coloured face [m]

_FACES: Final = (
    ((1, 0, 0), (0.84, 0.37, 0.0, 1.0)),
    ((-1, 0, 0), (0.0, 0.45, 0.7, 1.0)),
    ((0, 1, 0), (0.0, 0.62, 0.45, 1.0)),
    ((0, -1, 0), (0.8, 0.47, 0.65, 1.0)),
    ((0, 0, 1), (0.94, 0.89, 0.26, 1.0)),
)


@dataclass(frozen=True, eq=False)
class CubeScene(Scene):
    """Scene in which the palm faces down above a cube that is within reach of the fingertips.

    Attributes:
        top: height of the pedestal's top [m].
    """

    view: ClassVar = (150.0, -35.0)

    top: float

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Adds the pedestal."""
        x, y, _ = self.start[0]
        add_shape(
            world.worldbody,
            PLATFORM,
            mujoco.mjtGeom.mjGEOM_BOX,
            (_PEDESTAL, _PEDESTAL, self.top / 2),
            mass=0.0,
            friction=_PEDESTAL_FRICTION,
            at=(x, y, self.top / 2),
            color=(0.62, 0.5, 0.38, 1.0),
            priority=2,
        )

    def add_object(self, body: mujoco.MjsBody) -> None:
        """Adds the cube, which has a different colour on each face."""
        half = CUBE / 2
        add_shape(
            body,
            "cube",
            mujoco.mjtGeom.mjGEOM_BOX,
            (half, half, half),
            mass=CUBE_MASS,
            friction=_CUBE_FRICTION,
            color=(0.9, 0.9, 0.9, 1.0),
        )
        for normal, color in _FACES:
            n = np.array(normal, float)
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=half * n,
                rgba=color,
                mass=0.0,
                size=np.where(n != 0, _TAG, 0.8 * half),
                contype=0,
                conaffinity=0,
                group=1,
            )


def cube_scene(hand: Hand) -> CubeScene:
    """Makes the scene with the cube midway between thumb and fingers and its upper half within
    reach of the tips; HandModelError if thumb and index finger are a cube's width apart in no pose.
    """
    middle = np.concatenate([opposition(hand, name, CUBE) for name in hand.fingers[1:3]])
    deepest = float(np.quantile(reachable(hand)[:, 1:3, 2], 0.97))  # palmar
    distal, radial = (float(value) for value in np.median(middle[:, :2], axis=0))
    depth = deepest - 0.25 * CUBE  # cube's centre below the wrist
    at = mount(hand, up=(0, 0, -1), forward=(1, 0, 0), wrist=(0.0, 0.0, _TOP + CUBE / 2 + depth))
    centre = at.world((distal, radial, depth))
    reach = np.array([_PEDESTAL + CUBE, _PEDESTAL + CUBE, CUBE])
    return CubeScene(
        mount=at,
        start=(centre, np.array([1.0, 0.0, 0.0, 0.0])),
        lower=centre - reach,
        upper=centre + reach * (1, 1, 3),
        fixture=False,
        top=_TOP,
    )


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
    """Scene in which the fingers point down and hold the screwdriver's handle level, between thumb
    and fingers.

    The object's frame has z from the handle's end to the blade's tip and its origin at the grip.
    """

    view: ClassVar = (200.0, -5.0)

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Adds nothing: the screwdriver is in the hand or on the floor."""

    def add_object(self, body: mujoco.MjsBody) -> None:
        """Adds handle and shaft; the side with the blade is heavier."""
        radius, length = HANDLE
        add_shape(
            body,
            "handle",
            mujoco.mjtGeom.mjGEOM_CAPSULE,
            (radius, length / 2 - radius),
            mass=MASSES[0],
            friction=_HANDLE_FRICTION,
            color=(0.9, 0.45, 0.1, 1.0),
            at=(0, 0, length / 2 - GRIP),
        )
        add_shape(
            body,
            "shaft",
            mujoco.mjtGeom.mjGEOM_CAPSULE,
            (SHAFT[0], SHAFT[1] / 2 - SHAFT[0]),
            mass=MASSES[1],
            friction=(0.4, 0.001),
            color=(0.55, 0.57, 0.6, 1.0),
            at=(0, 0, length - GRIP + SHAFT[1] / 2),
        )


def screwdriver_scene(hand: Hand) -> ScrewdriverScene:
    """Makes the scene with the screwdriver between thumb and fingers, parallel to their row, with
    the blade at the thumb; HandModelError if thumb and index finger are a handle's width apart in
    no pose."""
    at = mount(hand, up=(-1, 0, 0), forward=(0, 0, 1), wrist=(0.0, 0.0, _WRIST_HEIGHT))
    between = np.median(opposition(hand, hand.fingers[1], 2 * HANDLE[0]), axis=0)
    centre = at.world(between)
    radial = at.directions[:, 1]
    quaternion = np.zeros(4)
    x = np.array([0.0, 0.0, 1.0])
    mujoco.mju_mat2Quat(quaternion, np.stack([x, np.cross(radial, x), radial], axis=1).ravel())
    return ScrewdriverScene(
        mount=at,
        start=(centre, quaternion),
        lower=centre - (0.15, 0.15, 0.10),
        upper=centre + 0.15,
        fixture=True,
    )


SCENES: Final[dict[str, Callable[[Hand], Scene]]] = {
    "card": card_scene,
    "cube": cube_scene,
    "screwdriver": screwdriver_scene,
    "relocate": relocate_scene,
    "hammer": hammer_scene,
    "tongs": tongs_scene,
}
"""Name of the task -> function that builds the scene for a hand."""


def scene_for(task: str, hand: Hand) -> Scene:
    """Makes the scene of a task for a given hand.

    Raises:
        UnknownNameError: there is no such task.
        HandModelError: the hand's size does not allow it.
    """
    if task not in SCENES:
        raise UnknownNameError("task", task, SCENES)
    return SCENES[task](hand)
