"""Objects that a person hands over to a robot hand: into a pinch or into the palm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco
import numpy as np

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.mount import mount
from smooth_operator.simulation.scenes.scene import Scene, add_shape

_HIGH: Final = 0.5  # of the wrist over the floor [m]
_GRIPS: Final = (0.9, 0.002)  # rubber on plastic
_DENSITY: Final = 1000.0  # [kg/m^3]
_LIGHTEST: Final = 0.002  # [kg]
_COLOR: Final = (0.9, 0.45, 0.1, 1.0)
_CARD: Final = (0.054, 0.0856)  # [m]
_CARD_GRIP: Final = 0.010  # from the middle of its short edge [m]
_PEN_LENGTH: Final = 0.14  # [m]
_HANDLE_LENGTH: Final = 0.10  # [m]
_HOLLOW: Final = 0.3  # of a handle's and a ball's volume is material


@dataclass(frozen=True)
class GraspObject:
    """Something to hold; it is taken across its width.

    The object's frame: x along its width, z along its length, the origin where it is gripped.

    Attributes:
        kind: ``sphere``, ``cube``, ``card``, ``pen``, ``handle`` (a cylinder) or ``ball``.
        width: between the fingers [m].
    """

    kind: str
    width: float

    @property
    def name(self) -> str:
        """Kind and width in millimetres."""
        return f"{self.kind} {1e3 * self.width:g}"

    @property
    def mass(self) -> float:
        """[kg]; polystyrene's density (handle and ball are hollow), and 2 g at least."""
        return max(_DENSITY * self._volume, _LIGHTEST)

    @property
    def _volume(self) -> float:
        w = self.width
        return {
            "sphere": np.pi / 6 * w**3,
            "cube": w**3,
            "card": _CARD[0] * _CARD[1] * w,
            "pen": np.pi / 4 * w**2 * _PEN_LENGTH,
            "handle": _HOLLOW * np.pi / 4 * w**2 * _HANDLE_LENGTH,
            "ball": _HOLLOW * np.pi / 6 * w**3,
        }[self.kind]

    @property
    def long(self) -> bool:
        """Whether it is longer along z than across."""
        return self.kind in ("card", "pen")

    def add_to(self, body: mujoco.MjsBody) -> None:
        """Give a body the object's shape."""
        half, geom = self.width / 2, mujoco.mjtGeom
        at, kind, size = {
            "sphere": (0.0, geom.mjGEOM_SPHERE, (half,)),
            "cube": (0.0, geom.mjGEOM_BOX, (half, half, half)),
            "card": (
                _CARD[1] / 2 - _CARD_GRIP,
                geom.mjGEOM_BOX,
                (half, _CARD[0] / 2, _CARD[1] / 2),
            ),
            "pen": (0.0, geom.mjGEOM_CYLINDER, (half, _PEN_LENGTH / 2)),
            "handle": (0.0, geom.mjGEOM_CYLINDER, (half, _HANDLE_LENGTH / 2)),
            "ball": (0.0, geom.mjGEOM_SPHERE, (half,)),
        }[self.kind]
        add_shape(
            body, self.kind, kind, size, mass=self.mass, friction=_GRIPS, color=_COLOR,
            at=(0.0, 0.0, at),
        )  # fmt: skip


POWER_GRASP_OBJECTS: Final = (
    GraspObject("handle", 0.03), GraspObject("handle", 0.05),
    GraspObject("ball", 0.045), GraspObject("ball", 0.065),
)  # fmt: skip
"""For the whole hand: as wide as the handles of tools, and balls up to a tennis ball's size."""

GRASP_OBJECTS: Final = tuple(
    GraspObject(kind, 1e-3 * width)
    for kind, width in (
        ("card", 2), ("pen", 8), ("sphere", 10), ("sphere", 20), ("sphere", 30), ("cube", 10),
        ("cube", 20), ("cube", 30),
    )
)  # fmt: skip
"""From 2 to 30 mm wide."""


@dataclass(frozen=True, eq=False)
class GraspScene(Scene):
    """A hand, palm down and high over the floor, and an object that somebody holds.

    Attributes:
        thing: what is held.
    """

    view: ClassVar = (150.0, -20.0)

    thing: GraspObject

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Nothing: it is in the hand, or on the floor."""

    def add_object(self, body: mujoco.MjsBody) -> None:
        """The object."""
        self.thing.add_to(body)


def grasp_scene(hand: Hand, thing: GraspObject) -> GraspScene:
    """A hand, palm down, and what it is to hold."""
    at = mount(hand, up=(0, 0, -1), forward=(1, 0, 0), wrist=(0.0, 0.0, _HIGH))
    start = np.array([0.0, 0.0, 2 * _HIGH])
    return GraspScene(
        mount=at, start=(start, np.array([1.0, 0.0, 0.0, 0.0])), lower=-np.ones(3),
        upper=np.ones(3), fixture=False, thing=thing,
    )  # fmt: skip
