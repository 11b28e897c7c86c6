"""Physics simulation of a hand with an object between two fingertips or in the palm."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Collection
from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import HandModelError
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, FINGERS
from smooth_operator.retargeting.alignment import reference_landmarks
from smooth_operator.simulation.physics import FURNISHED, HandPhysics
from smooth_operator.simulation.scenes.physics import Touching, finger_geoms, soften_pads
from smooth_operator.simulation.scenes.scene import OBJECT, Scene, add_shape, mount

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
    """Object to hold; it is grasped across its width.

    The object's frame: x along its width, z along its length, the origin where it is gripped.

    Attributes:
        kind: ``sphere``, ``cube``, ``card``, ``pen``, ``handle`` (a cylinder) or ``ball``.
        width: width between the fingers [m].
    """

    kind: str
    width: float

    @property
    def name(self) -> str:
        """Kind and width in millimetres."""
        return f"{self.kind} {1e3 * self.width:g}"

    @property
    def mass(self) -> float:
        """Mass [kg], from the density of polystyrene (handle and ball are hollow); at least 2 g."""
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

    def add_to(self, body: mujoco.MjsBody) -> None:
        """Adds the object's shape to a body."""
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
            body,
            self.kind,
            kind,
            size,
            mass=self.mass,
            friction=_GRIPS,
            color=_COLOR,
            at=(0.0, 0.0, at),
        )


POWER_GRASP_OBJECTS: Final = (
    GraspObject("handle", 0.03),
    GraspObject("handle", 0.05),
    GraspObject("ball", 0.045),
    GraspObject("ball", 0.065),
)
"""Objects for the whole hand: as wide as tool handles, and balls up to the size of a tennis
ball."""

GRASP_OBJECTS: Final = tuple(
    GraspObject(kind, 1e-3 * width)
    for kind, width in (
        ("card", 2),
        ("pen", 8),
        ("sphere", 10),
        ("sphere", 20),
        ("sphere", 30),
        ("cube", 10),
        ("cube", 20),
        ("cube", 30),
    )
)
"""Objects for pinches, 2 to 30 mm wide."""


@dataclass(frozen=True, eq=False)
class GraspScene(Scene):
    """A hand, palm down and high above the floor, and an object that a person holds.

    Attributes:
        thing: the object to hold.
    """

    view: ClassVar = (150.0, -20.0)

    thing: GraspObject

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Adds nothing: the object is in the hand or on the floor."""

    def add_object(self, body: mujoco.MjsBody) -> None:
        """Adds the object."""
        self.thing.add_to(body)


def grasp_scene(hand: Hand, thing: GraspObject) -> GraspScene:
    """Makes the scene of a hand (palm down) and an object to hold."""
    at = mount(hand, up=(0, 0, -1), forward=(1, 0, 0), wrist=(0.0, 0.0, _HIGH))
    start = np.array([0.0, 0.0, 2 * _HIGH])
    return GraspScene(
        mount=at,
        start=(start, np.array([1.0, 0.0, 0.0, 0.0])),
        lower=-np.ones(3),
        upper=np.ones(3),
        fixture=False,
        thing=thing,
    )


_BIT: Final = 1 << 14
"""Contact bit of the shapes that may touch the object."""

_TURNS: Final = 12
"""Directions of a long object to try, about the line between the pads."""

_DRAG: Final = (5.0, 2e-3)
"""Resistance of the object while a person holds it: force per speed [N s/m], torque per angular
velocity [N m s]."""

_FAR: Final = 1.0  # [m]
_ROOM: Final = 0.03  # enough [m]


class PadGap(NamedTuple):
    """Pads of two fingertips.

    Attributes:
        distance: distance of their surfaces [m]; negative if they overlap.
        ends: (2, 3) nearest points, on the thumb and on the finger [m].
    """

    distance: float
    ends: Float[np.ndarray, "2 3"]


class GraspPhysics(HandPhysics, ABC):
    """A hand and an object that a person gives to it.

    Args:
        timestep: step of the physics [s].
        bandwidth: bandwidth of the servos [Hz].
    """

    def __init__(
        self, hand: Hand, thing: GraspObject, timestep: float = 0.002, bandwidth: float = 20.0
    ) -> None:
        self.thing = thing
        self.scene = grasp_scene(hand, thing)
        super().__init__(hand, timestep, bandwidth, furnish=self.scene.furnish)
        model = self._built.model
        self._touching = Touching(hand, model)
        self._object = model.body(OBJECT).id
        joint = model.joint(OBJECT)
        self._at, self._moves = int(joint.qposadr[0]), int(joint.dofadr[0])
        self._tip_bodies = [
            model.body(FURNISHED + finger.tip.body).id for finger in hand.spec.fingers
        ]
        soften_pads(model, self._object, self._tip_bodies)
        self._limits = model.actuator_forcerange[:, 1]

    @property
    @abstractmethod
    def grip(self) -> float:
        """Force of the weaker side on the object [N]."""

    def let_go(self) -> None:
        """Releases the object."""
        self._carry(False)

    def push(self, force: Float[np.ndarray, "3"]) -> None:
        """Sets the force (3,) at the object's centre [N], in the world."""
        self._data.xfrc_applied[self._object, :3] = force

    @property
    def position(self) -> Float[np.ndarray, "3"]:
        """Position (3,) of the grip on the object, in the world [m]."""
        return np.array(self._data.xpos[self._object])

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """The object's axes in the world as columns, the width first."""
        return np.array(self._data.xmat[self._object]).reshape(3, 3)

    @property
    def effort(self) -> float:
        """Largest torque of a motor, as a fraction of its limit."""
        return float(np.max(np.abs(self._data.actuator_force) / self._limits))

    def _stand(self, pose: Float[np.ndarray, " n"], touching: Collection[int]) -> None:
        """Puts the hand at rest in a pose, with the object out of the way; only some shapes can
        touch it."""
        model = self._built.model
        self.time = self._due = 0.0
        self.command(pose)
        self._place(self._target)
        for geom in self._touching.own:
            model.geom_conaffinity[geom] &= ~_BIT
            if geom in touching:
                model.geom_conaffinity[geom] |= _BIT
        self._solid(False)
        self._put(*self.scene.start)
        self._carry(True)

    def _room(self, apart_from: Collection[int] = ()) -> float:
        """Distance of the object from the hand's other shapes [m]; at most ``_ROOM``."""
        model, data = self._built.model, self._data
        mujoco.mj_kinematics(model, data)
        near = [
            float(mujoco.mj_geomDistance(model, data, own, thing, _ROOM, None))
            for own in self._touching.own
            if own not in apart_from
            for thing in self._touching.things
        ]
        return min(near, default=_ROOM)

    def _carry(self, carried: bool) -> None:
        model = self._built.model
        drag = _DRAG if carried else (0.0, 0.0)
        model.dof_damping[self._moves : self._moves + 6] = np.repeat(drag, 3)
        weight = -float(model.body_mass[self._object]) * model.opt.gravity
        self.push(weight if carried else np.zeros(3))

    def _put(self, position: Float[np.ndarray, "3"], quaternion: Float[np.ndarray, "4"]) -> None:
        self._data.qpos[self._at : self._at + 7] = np.concatenate([position, quaternion])
        self._data.qvel[self._moves : self._moves + 6] = 0.0

    def _solid(self, solid: bool) -> None:
        model = self._built.model
        for geom in self._touching.things:
            model.geom_contype[geom] = _BIT if solid else 0
            model.geom_conaffinity[geom] = 0
        mujoco.mj_forward(model, self._data)


class PinchPhysics(GraspPhysics):
    """A hand and an object that appears between the pads of the thumb and of another finger.

    Only these two fingers and the floor can touch it.

    Args:
        timestep: step of the physics [s].
        bandwidth: bandwidth of the servos [Hz].
    """

    def __init__(
        self, hand: Hand, thing: GraspObject, timestep: float = 0.002, bandwidth: float = 20.0
    ) -> None:
        super().__init__(hand, thing, timestep, bandwidth)
        model = self._built.model
        self._fingers = finger_geoms(hand, model)
        self._tips = [
            [g for g in geoms if model.geom_bodyid[g] == tip]
            for geoms, tip in zip(self._fingers, self._tip_bodies, strict=True)
        ]
        empty = [f.name for f, tip in zip(hand.spec.fingers, self._tips, strict=True) if not tip]
        if empty:
            raise HandModelError(
                f"hand {hand.name!r}: the last link of {', '.join(empty)} has no shape that "
                "collides; a pinch can't be tried"
            )
        self._finger = 1

    def begin(self, finger: int, pose: Float[np.ndarray, " n"]) -> None:
        """Puts the hand at rest in a pose, with the object out of the way.

        Args:
            finger: index of the pinching finger in ``hand.fingers``.
            pose: (n,) positions of all joints [rad].
        """
        self._finger = finger
        self._stand(pose, {*self._fingers[0], *self._fingers[finger]})

    def gap(self) -> PadGap:
        """The pads of thumb and finger in the current pose."""
        model, data = self._built.model, self._data
        best = PadGap(_FAR, np.zeros((2, 3)))
        ends = np.zeros(6)
        for thumb in self._tips[0]:
            for tip in self._tips[self._finger]:
                distance = mujoco.mj_geomDistance(model, data, thumb, tip, _FAR, ends)
                if distance < best.distance:
                    best = PadGap(float(distance), ends.reshape(2, 3).copy())
        return best

    def gap_at(self, finger: int, pose: Float[np.ndarray, " n"]) -> float:
        """Distance of the pads in a pose [m]; negative if they overlap.

        Args:
            finger: index of the finger in ``hand.fingers``.
            pose: (n,) positions of all joints [rad].
        """
        self.begin(finger, pose)
        return self.gap().distance

    def appear(self) -> None:
        """Puts the object between the pads and enables its contacts.

        Somebody holds it loosely: it has no weight, and yields to the pads against some drag.
        """
        thumb, finger = self.gap().ends
        axis = finger - thumb
        axis /= max(float(np.linalg.norm(axis)), 1e-9)
        centre = (thumb + finger) / 2
        aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        aside /= np.linalg.norm(aside)
        over = np.cross(axis, aside)
        angles = 2 * np.pi * np.arange(_TURNS) / _TURNS
        rooms = []
        for angle in angles:
            self._put(centre, frame_of(axis, np.cos(angle) * aside + np.sin(angle) * over))
            rooms.append(self._room({*self._tips[0], *self._tips[self._finger]}))
        angle = float(angles[int(np.argmax(np.round(rooms, 5)))])
        self._put(centre, frame_of(axis, np.cos(angle) * aside + np.sin(angle) * over))
        self._solid(True)

    @property
    def grip(self) -> float:
        """See ``GraspPhysics``; the sides are thumb and finger."""
        return min(self.pinch)

    @property
    def pinch(self) -> tuple[float, float]:
        """Forces of thumb and finger on the object [N]."""
        force, *_ = self._touching.read(self._data)
        return float(force[0]), float(force[self._finger])


def frame_of(x: Float[np.ndarray, "3"], z: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4"]:
    """Quaternion w x y z of a frame with these two perpendicular axes, (3,) each."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.stack([x, np.cross(z, x), z], axis=1).ravel())
    return quaternion


_CLEAR: Final = 0.001  # between the object and the hand where it appears [m]
_FROM: Final = 0.16  # in front of the palm, where the way to it begins [m]
_STEP: Final = 0.002  # of that way [m]
_ALONG: Final = (0.0, -0.01, 0.01, -0.02, 0.02, -0.03, 0.03)
"""Places to try along the fingers' direction, from the row of the finger bases [m]."""
_ASIDE: Final = (0.0, -0.01, -0.02, -0.03, -0.04)
"""Places to try towards the thumb [m]; a long object may have to lie next to it."""
_YAWS: Final = (0.0, np.radians(20.0), np.radians(-20.0))
"""Rotations of a long object to try in front of the palm [rad]."""
_WORTH: Final = 0.2
"""Smallest gain in distance to the palm per metre off the middle."""


class PowerGraspPhysics(GraspPhysics):
    """A hand and an object that a person lays into its palm; every part of the hand can touch it.

    Args:
        timestep: step of the physics [s].
        bandwidth: bandwidth of the servos [Hz].
    """

    def __init__(
        self, hand: Hand, thing: GraspObject, timestep: float = 0.002, bandwidth: float = 20.0
    ) -> None:
        super().__init__(hand, thing, timestep, bandwidth)
        bases = [BASES[FINGERS.index(name)] for name in hand.fingers if name != "thumb"]
        row = reference_landmarks(hand)[bases].mean(axis=0)
        at, turn = self.scene.mount.palm
        self._row = at + turn @ row

    def begin(self, pose: Float[np.ndarray, " n"]) -> None:
        """Puts the hand at rest in a pose, with the object out of the way.

        Args:
            pose: (n,) positions of all joints [rad].
        """
        self._stand(pose, self._touching.own)

    def appear(self) -> float:
        """Lays the object into the palm and enables its contacts.

        It is laid across the palm, from the front, as near to the palm as possible without
        touching the hand. Somebody holds it loosely: it has no weight, and yields against drag.

        Returns:
            distance of its centre in front of the row of the finger bases [m].
        """
        distal, radial, palmar = self.scene.mount.directions.T
        best, where, turn = (np.inf, 0.0), self._row, np.zeros(4)
        for yaw, aside, along in itertools.product(_YAWS, _ASIDE, _ALONG):
            axis = np.cos(yaw) * radial + np.sin(yaw) * distal
            turned = frame_of(palmar, axis)
            place = self._row + along * distal + aside * radial
            depth = self._depth(place, palmar, turned)
            cost = depth + _WORTH * (abs(aside) + abs(along))
            if cost < best[0] - 1e-9:
                best, where, turn = (cost, depth), place, turned
        self._put(where + best[1] * palmar, turn)
        self._solid(True)
        return best[1]

    @property
    def grip(self) -> float:
        """See ``GraspPhysics``; the sides are the fingers, and palm and thumb."""
        force, _, palm, _ = self._touching.read(self._data)
        return float(min(force[1:].sum(), palm + force[0]))

    def _depth(
        self,
        place: Float[np.ndarray, "3"],
        palmar: Float[np.ndarray, "3"],
        turn: Float[np.ndarray, "4"],
    ) -> float:
        """Distance from the front to the resting place of the object [m]."""
        depth = _FROM
        while depth > -_FROM:
            self._put(place + (depth - _STEP) * palmar, turn)
            room = self._room()
            if room < _CLEAR:
                break
            depth -= max(_STEP, _STEP * np.floor((room - _CLEAR) / _STEP))
        return depth
