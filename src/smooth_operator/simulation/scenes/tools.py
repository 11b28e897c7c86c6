"""Scenes of the tasks ``hammer`` and ``tongs``: a tool on a stand, across the hand and below its
palm.

They resemble Adroit's ``hammer`` (Gymnasium-Robotics; its documentation has the nail's friction)
and DexJoCo's ``hammer_nail`` and ``pinch_tongs``. Shapes and sizes are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Final, Self, TypeVar

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.scene import PLATFORM, add_shape
from smooth_operator.simulation.scenes.table_scene import TOP, TableScene, mount_over

HANDLE: Final = (0.024, 0.260, 0.028)
"""Width, length and height of the hammer's handle [m]."""

HEAD: Final = (0.020, 0.060)
"""Radius and length of the hammer's head, whose faces are round [m]."""

HEAD_AT: Final = 0.125
"""Distance from the middle of the grip to the head's axis [m]."""

HAMMER_MASSES: Final = (0.100, 0.200)
"""Masses of handle and head [kg]."""

NAIL: Final = 0.050
"""Length of the nail above the block [m]; all of it can be driven in."""

NAIL_FRICTION: Final = 15.0
"""Force of friction on the nail [N]."""

ARM: Final = (0.008, 0.200, 0.022)
"""Thickness, length and height of an arm of the tongs [m]."""

TONGS_MASSES: Final = (0.030, 0.020)
"""Masses of an arm of the tongs and of the jaw at its end [kg]; the tongs balance at the grip."""

GAPS: Final = (0.060, 0.015)
"""Gaps between the ends of the arms of open and of shut tongs [m]."""

SQUEEZE: Final = (1.5, 3.0)
"""Forces at the middle of the grip at which the tongs begin to shut, and are shut [N]."""

HINGE_AT: Final = 0.125
"""Distance from the middle of the grip to the hinge [m]."""

RAISED: Final = 0.10
"""Height to which the tongs are to be lifted above the stand [m]."""

_HEAD_END: Final = 0.015  # of the handle beyond the head's axis [m]
_NAIL_AT: Final = (0.16, HEAD_AT, 0.06)  # from the place below the grip to the nail's hole [m]
_TARGET_SHARE: Final = 0.4  # of a variation's shift of the target: 4 cm, and 2 cm of height
_CAP: Final = (0.020, 0.003)  # radius and half height of the nail's cap [m]
_BLOCK: Final = 0.035  # half of the side of the nail's block [m]
_ANGLE: Final = (GAPS[0] - GAPS[1]) / ARM[1]  # between the arms of open tongs [rad]
_STIFFNESS: Final = (SQUEEZE[1] - SQUEEZE[0]) * HINGE_AT / _ANGLE  # of their spring [N m/rad]
_DAMPING: Final = 0.02  # [N m s/rad]
_ABOVE: Final = 0.14  # height of the grasp centre above the grip at the start [m]
_STOP: Final = ((0.004, 1.0), (0.95, 0.99, 0.0005, 0.5, 2.0))  # solref, solimp of a joint's end
_WOOD, _STEEL, _BLUE = (0.75, 0.6, 0.42, 1.0), (0.55, 0.57, 0.6, 1.0), (0.0, 0.45, 0.7, 1.0)
_BOX, _CYLINDER = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER


@dataclass(frozen=True, eq=False)
class ToolScene(TableScene):
    """Scene with a tool that lies on two posts.

    The object's origin is the middle of the grip, and its y points along the tool to its working
    end, which is on the thumb's side of the hand.
    """

    pitch: ClassVar[float]  # tilt of the fingers down from level at the start [degrees]
    post: ClassVar[tuple[float, float, float]]  # half lengths of a post [m]
    posts: ClassVar[tuple[float, float]]  # places of the posts along the tool [m]
    height: ClassVar[float]  # of the tool's middle above the posts [m]

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Adds the table, and the posts below the tool."""
        super().add_platform(world)
        (x, y, _), turn = self.start
        stand = world.worldbody.add_body(name=f"{PLATFORM}_stand", pos=(x, y, TOP), quat=turn)
        half = self.scale * np.array(self.post)
        for number, along in enumerate(self.posts):
            _add(stand, f"post{number}", _BOX, half, (0, self.scale * along, half[2]), _WOOD)


_S = TypeVar("_S", bound=ToolScene)


def _tool_scene(kind: type[_S], hand: Hand, scale: float, target: Float[np.ndarray, "3"]) -> _S:
    """Makes a scene around a hand; the target is relative to the table's top, at scale 1 [m]."""
    height = TOP + scale * (2 * kind.post[2] + kind.height)
    tilt = np.tan(np.radians(kind.pitch))
    at = mount_over(hand, (0.0, 0.0, height + _ABOVE), up=(-tilt, 0, -1), forward=(1, 0, 0))
    right = at.directions[1, 1] > 0  # the thumb's side of a left hand is that of -y
    return kind(
        mount=at,
        start=(np.array([0.0, 0.0, height]), np.array([right, 0.0, 0.0, not right], float)),
        target=target * (scale, scale if right else -scale, scale) + (0.0, 0.0, TOP),
        scale=scale,
    )


def _add(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    size: ArrayLike,
    at: ArrayLike,
    color: tuple[float, float, float, float],
    mass: float | None = None,
) -> None:
    """Add a part of a tool with a mass [kg], or of the platform without one."""
    fixed = mass is None
    add_shape(
        body,
        name,
        kind,
        np.asarray(size, float),
        mass=0.01 if mass is None else mass,
        friction=(0.5, 0.001) if fixed else (0.8, 0.002),  # rubber, torsion of a soft fingertip [m]
        color=color,
        at=np.asarray(at, float).tolist(),
        priority=2 if fixed else 1,
    )


class HammerScene(ToolScene):
    """Scene with a hammer, and a nail in a block. The target is the nail's hole."""

    mechanism: ClassVar = "nail"
    pitch, post, posts, height = 15.0, (0.020, 0.012, 0.030), (-0.107, 0.090), HANDLE[2] / 2

    def varied(self, shape: int, shift: Float[np.ndarray, "3"]) -> Self:
        """Returns the scene with another target; see ``Scene.varied``."""
        return replace(self, target=self.target + self.scale * _TARGET_SHARE * shift)

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Adds the table, the stand, the block and the nail."""
        super().add_platform(world)
        s, (x, y, top) = self.scale, self.target
        half = np.array([s * _BLOCK, s * _BLOCK, (top - TOP) / 2])
        _add(world.worldbody, "block", _BOX, half, (x, y, TOP + half[2]), _WOOD)
        nail = world.worldbody.add_body(name=f"{PLATFORM}_nail", pos=(x, y, top + s * NAIL))
        joint = nail.add_joint(name=self.mechanism, axis=(0, 0, -1), limited=True)
        joint.type, joint.range = mujoco.mjtJoint.mjJNT_SLIDE, (0.0, s * NAIL)
        joint.frictionloss, (joint.solref_limit, joint.solimp_limit) = NAIL_FRICTION, _STOP
        radius, thick = s * _CAP[0], s * _CAP[1]
        _add(nail, "cap", _CYLINDER, (radius, thick), (0, 0, thick), _STEEL)
        shaft = (radius / 6, s * NAIL / 2)
        _add(nail, "shaft", _CYLINDER, shaft, (0, 0, -shaft[1]), _STEEL)
        nail.geoms[-1].contype = nail.geoms[-1].conaffinity = 0  # it goes into the block

    def add_object(self, body: mujoco.MjsBody) -> None:
        """Adds the hammer."""
        s, (handle, head) = self.scale, HAMMER_MASSES
        middle = HEAD_AT + _HEAD_END - HANDLE[1] / 2
        half = s / 2 * np.array(HANDLE)
        _add(body, "handle", _BOX, half, (0, s * middle, 0), _WOOD, handle * s**3)
        size = s * np.array([HEAD[0], HEAD[1] / 2 - HEAD[0]])
        capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
        _add(body, "head", capsule, size, (0, s * HEAD_AT, 0), _STEEL, head * s**3)


class TongsScene(ToolScene):
    """Scene with tongs, whose spring pushes the fingers' arm away from the thumb's arm. The target
    is ``RAISED`` above the start."""

    mechanism: ClassVar = "tongs"
    pitch, post, posts, height = 40.0, (0.045, 0.008, 0.025), (-0.105, 0.060), ARM[2] / 2

    def gap(self, angle: float) -> float:
        """Gap between the ends of the arms [m] for a given angle between the arms [rad]."""
        return self.scale * (GAPS[1] + ARM[1] * angle)

    def add_object(self, body: mujoco.MjsBody) -> None:
        """Adds the tongs."""
        s, half = self.scale, self.scale / 2 * np.array(ARM)
        for side, name in ((-1, "thumb_arm"), (1, "finger_arm")):
            turn = np.cos(_ANGLE / 4), 0.0, 0.0, -side * np.sin(_ANGLE / 4)
            arm = body.add_body(name=name, pos=(0.0, -s * HINGE_AT, 0.0), quat=turn)
            x = side * (s * GAPS[1] / 2 + half[0])
            mass, jaw = TONGS_MASSES
            _add(arm, name, _BOX, half, (x, half[1], 0), _BLUE, mass * s**3)
            at, size = (x, 2 * half[1], 0), (half[0], half[2], half[2])
            _add(arm, f"{name}_jaw", _BOX, size, at, _STEEL, jaw * s**3)
        hinge = arm.add_joint(name=self.mechanism, axis=(0, 0, -1), limited=True)
        hinge.range, hinge.ref = (0.0, _ANGLE), _ANGLE
        hinge.solref_limit, hinge.solimp_limit = _STOP
        hinge.springref = _ANGLE + SQUEEZE[0] * HINGE_AT / _STIFFNESS
        hinge.stiffness = _first(hinge.stiffness, s * _STIFFNESS)
        hinge.damping = _first(hinge.damping, s * _DAMPING)


def _first(like: ArrayLike, value: float) -> np.ndarray:
    """The value as the first of the coefficients, of which MuJoCo has one or several."""
    out = np.zeros_like(np.asarray(like))
    out.flat[0] = value
    return out


def hammer_scene(hand: Hand, scale: float = 1.0) -> HammerScene:
    """Makes the hammer's scene; HandModelError if the gap between thumb and fingers can't be 5 cm.

    Args:
        scale: factor of the lengths of hammer and nail; masses have the third power of it.
    """
    return _tool_scene(HammerScene, hand, scale, np.array(_NAIL_AT))


def tongs_scene(hand: Hand, scale: float = 1.0) -> TongsScene:
    """Makes the tongs' scene; HandModelError if the gap between thumb and fingers can't be 5 cm.

    Args:
        scale: factor of the lengths of the tongs; their mass has the third power of it.
    """
    height = 2 * TongsScene.post[2] + TongsScene.height + RAISED
    return _tool_scene(TongsScene, hand, scale, np.array([0.0, 0.0, height]))
