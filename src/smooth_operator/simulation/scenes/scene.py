"""Base of the tasks' scenes: a hand on its fixture, an object, the object's platform, and their
state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Self

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator.errors import HandModelError
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.arm import HandMount, Pose, hand_directions, pose_of, rigid
from smooth_operator.simulation.arms.free_wrist import FreeWrist, HandCarrier
from smooth_operator.simulation.physics import FURNISHED


@dataclass(frozen=True, eq=False)
class Mount:
    """Pose in which a fixture holds a hand.

    A scene places its parts in directions of the hand, from the wrist: distal along the fingers,
    radial towards the thumb's side, palmar out of the palm. The world's z points up.

    Attributes:
        directions: (3, 3) columns: distal, radial and palmar in the world.
        wrist: (3,) position of the hand's wrist in the world [m].
        frame: position (3,) [m] and quaternion (4,) of the world of the hand's model in this world.
        palm: position (3,) [m] and rotation (3, 3) of the palm frame in the world.
    """

    directions: Float[np.ndarray, "3 3"]
    wrist: Float[np.ndarray, "3"]
    frame: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]
    palm: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]

    @property
    def wrist_pose(self) -> Pose:
        """(7,) pose of the wrist frame (see ``HandMount``) in the world."""
        distal, back = self.directions[:, 0], -self.directions[:, 2]
        turn = np.stack([distal, np.cross(back, distal), back], axis=1)
        return pose_of(rigid(turn, self.wrist))

    def world(self, point: ArrayLike) -> Float[np.ndarray, "3"]:
        """Converts a point given as (distal, radial, palmar) from the wrist [m] to (3,) world
        coordinates [m]."""
        return np.asarray(self.wrist + self.directions @ np.asarray(point, float))

    def in_palm(
        self, position: Float[np.ndarray, "3"], quaternion: Float[np.ndarray, "4"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]:
        """Converts a pose in the world to the palm frame, in which the pages draw hands.

        Args:
            position: (3,) position in the world [m].
            quaternion: (4,) rotation to the world, w x y z.
        """
        at, turn = self.palm
        back, out = np.zeros(4), np.zeros(4)
        mujoco.mju_mat2Quat(back, np.ascontiguousarray(turn.T).ravel())
        mujoco.mju_mulQuat(out, back, quaternion)
        return turn.T @ (position - at), out


def mount(hand: Hand, *, up: ArrayLike, forward: ArrayLike, wrist: ArrayLike = (0, 0, 0)) -> Mount:
    """Places a hand in the world.

    Args:
        up: (3,) direction of the hand (distal, radial, palmar) that is the world's z.
        forward: (3,) direction of the hand that is the world's x; its part along ``up`` is ignored.
        wrist: (3,) position of the wrist in the world [m].
    """
    axes = hand_directions(hand)
    z = np.asarray(up, float) @ axes
    z /= np.linalg.norm(z)
    x = np.asarray(forward, float) @ axes
    x -= (x @ z) * z
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(z, x), z])  # palm frame to world
    at = np.asarray(wrist, float)
    palm = at - turn @ hand.wrist
    # A model may have a forearm between its world and the palm.
    model_to_palm = HandMount(hand).model_to_palm
    rotation = turn @ model_to_palm[:3, :3].T
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    frame = (palm - rotation @ model_to_palm[:3, 3], quaternion)
    return Mount(turn @ axes.T, at, frame, (palm, turn))


_POSES = 20_000


def reachable(hand: Hand) -> Float[np.ndarray, "s f 3"]:
    """Returns (s, f, 3) fingertips in random poses, as (distal, radial, palmar) from the wrist [m].

    The random poses are the same in every call, so that a hand's scene is always the same.
    """
    low, high = hand.limits.T
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    tips = hand.tips(hand.full_configuration(poses)) - hand.wrist
    return np.asarray(tips @ hand_directions(hand).T)


def opposition(hand: Hand, finger: str, gap: float) -> Float[np.ndarray, "k 3"]:
    """Returns (k, 3) midpoints between the tips of thumb and finger, in poses in which they are
    ``gap`` apart.

    All lengths are in metres.

    Raises:
        HandModelError: fewer than 20 of the random poses have that gap.
    """
    tips = reachable(hand)
    thumb, other = tips[:, 0], tips[:, hand.fingers.index(finger)]
    near = np.abs(np.linalg.norm(other - thumb, axis=1) - gap) < 0.006
    if near.sum() < 20:
        raise HandModelError(
            f"hand {hand.name!r}: thumb and {finger} can't grasp an object {1e3 * gap:.0f} "
            "mm thick; choose another task or hand"
        )
    return np.asarray((thumb + other)[near] / 2)


OBJECT: Final = "object"
"""Name of the object's body."""

PLATFORM: Final = "platform"
"""Prefix of the names of the platform's shapes."""

OBJECT_POSE: Final = tuple(f"object_{name}.pos" for name in ("x", "y", "z", "qw", "qx", "qy", "qz"))
"""Names of the components of ``object_pose``."""

_ALL: Final = 0xFFFF  # collision mask: collides with every shape that collides
_STIFF: Final = 0.004  # time constant of contacts [s]; in MuJoCo's default a card sinks in
_WIDTH, _HEIGHT = 1280, 960  # largest picture


@dataclass(frozen=True, eq=False)
class Scene(ABC):
    """Description of a hand and its object in a world whose z axis points up and whose floor is at
    0.

    Attributes:
        mount: pose of the hand.
        start: position (3,) [m] and quaternion (4,) of the object at the start of a trial.
        lower: (3,) lower corner of the workspace [m]; an object that leaves it is dropped.
        upper: (3,) upper corner of the workspace [m].
        fixture: True if a fixture holds the object until the hand does.
        view: azimuth and elevation of a camera that sees a right hand at work [degrees], in
            MuJoCo's convention; for a left hand the azimuth is negated.
        mechanism: name of the joint of a part that moves in the scene, such as a nail; empty
            without one.
    """

    view: ClassVar[tuple[float, float]]
    mechanism: ClassVar[str] = ""

    mount: Mount
    start: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]
    lower: Float[np.ndarray, "3"]
    upper: Float[np.ndarray, "3"]
    fixture: bool

    @abstractmethod
    def add_platform(self, world: mujoco.MjSpec) -> None:
        """Adds the object's support to the world."""

    @abstractmethod
    def add_object(self, body: mujoco.MjsBody) -> None:
        """Adds the shapes of the object to its body."""

    def varied(self, shape: int, shift: Float[np.ndarray, "3"]) -> Self:
        """Returns the scene with another shape of its object and another target position; a scene
        with only one shape and no target returns itself.

        Args:
            shape: number of the shape, modulo the number of shapes.
            shift: (3,) shift of the target from its nominal place [m].
        """
        return self

    def free_wrist(self, hand: Hand) -> FreeWrist:
        """Returns a free wrist that starts at the scene's mount."""
        return FreeWrist(hand, self.mount.wrist_pose)

    def furnish(self, hand: mujoco.MjSpec, carried: HandCarrier | None = None) -> mujoco.MjSpec:
        """Builds the world around the hand; see ``build_physics``.

        Args:
            carried: arm or free wrist that carries the hand, at its place; None for a fixture.
        """
        hand.option.gravity = (0.0, 0.0, -9.81)
        world = empty_world(hand)
        if carried is None:
            position, quaternion = self.mount.frame
            world.attach(
                hand,
                prefix=FURNISHED,
                frame=world.worldbody.add_frame(pos=position, quat=quaternion),
            )
        else:
            carried.attach(world, hand, FURNISHED)
        self.add_platform(world)
        body = world.worldbody.add_body(name=OBJECT, pos=self.start[0], quat=self.start[1])
        body.add_freejoint(name=OBJECT)
        self.add_object(body)
        if self.fixture:
            hold = world.add_equality(name=OBJECT, type=mujoco.mjtEq.mjEQ_WELD, active=True)
            hold.objtype = mujoco.mjtObj.mjOBJ_BODY
            hold.name1, hold.name2 = "world", OBJECT
            hold.solref = (_STIFF, 1.0)
            data = np.zeros_like(np.asarray(hold.data))
            data[10] = 1.0  # torque as force; the pose is that of the start
            hold.data = data
        return world


def add_shape(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    size: Sequence[float] | Float[np.ndarray, " k"],
    *,
    mass: float,
    friction: tuple[float, float],
    color: tuple[float, float, float, float],
    at: Sequence[float] = (0.0, 0.0, 0.0),
    priority: int = 1,
) -> None:
    """Adds a shape that collides with everything.

    Args:
        body: the body that gets the shape.
        size: half lengths [m], or radius and half length [m].
        mass: mass [kg].
        friction: coefficient of sliding friction, and of torsional friction [m], like those of a
            soft fingertip.
        at: centre in the body's frame [m].
        priority: in a contact, the shape with the higher priority sets the parameters.
    """
    body.add_geom(
        name=name,
        type=kind,
        size=[*size, *[0.0] * (3 - len(size))],
        pos=at,
        mass=mass,
        friction=(*friction, 1e-4),
        condim=4,
        rgba=color,
        priority=priority,
        contype=_ALL,
        conaffinity=_ALL,
        solref=(_STIFF, 1.0),
        solimp=(0.95, 0.99, 0.0005, 0.5, 2.0),
    )


def empty_world(hand: mujoco.MjSpec) -> mujoco.MjSpec:
    """Makes a world with a floor and a light, and with the physics settings of the hand's model."""
    world = mujoco.MjSpec()
    for name in ("timestep", "integrator", "disableflags"):
        setattr(world.option, name, getattr(hand.option, name))
    world.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    world.option.impratio = 10.0
    world.option.noslip_iterations = 4  # else soft friction lets an object creep out of the fingers
    world.compiler.degree = False
    for name in ("fusestatic", "balanceinertia", "boundmass", "boundinertia"):
        setattr(world.compiler, name, getattr(hand.compiler, name))
    world.visual.global_.offwidth, world.visual.global_.offheight = _WIDTH, _HEIGHT
    world.visual.headlight.ambient = (0.35, 0.35, 0.35)
    world.visual.headlight.diffuse = (0.45, 0.45, 0.45)
    world.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        width=32,
        height=192,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.98, 0.98, 0.98),
        rgb2=(0.8, 0.84, 0.9),
    )
    world.worldbody.add_light(pos=(0.2, -0.3, 1.0), dir=(-0.2, 0.3, -1.0), castshadow=True)
    add_shape(
        world.worldbody,
        "floor",
        mujoco.mjtGeom.mjGEOM_PLANE,
        (0.6, 0.6, 0.01),
        mass=0.0,
        friction=(0.5, 0.001),
        color=(0.93, 0.93, 0.92, 1.0),
        priority=2,
    )
    return world


@dataclass(frozen=True, eq=False)
class SceneState:
    """State of a scene at one moment, in a world whose z axis points up.

    Attributes:
        time: simulated time [s].
        position: (3,) position of the object's centre in the world [m].
        quaternion: (4,) rotation from the object's frame to the world, w x y z.
        velocity: (3,) velocity of the object's centre [m/s].
        spin: (3,) angular velocity of the object in the world [rad/s].
        force: (f,) normal force of each finger on the object [N], thumb first.
        touch: (f, 3) point of contact of each finger in the object's frame [m]; NaN without one.
        palm: normal force of the rest of the hand on the object [N].
        support: normal force of the platform or the floor on the object [N].
        placed: False while the object can't be touched and waits for the hand to leave its place.
        fixed: True while the fixture holds the object.
        starts: number of times that the object was put to its start.
        away: True while there is no object, as in free movement; ``position`` is then its start.
        mechanism: position of the scene's moving part [m or rad]; 0 without one.
    """

    time: float
    position: Float[np.ndarray, "3"]
    quaternion: Float[np.ndarray, "4"]
    velocity: Float[np.ndarray, "3"]
    spin: Float[np.ndarray, "3"]
    force: Float[np.ndarray, " f"]
    touch: Float[np.ndarray, "f 3"]
    palm: float = 0.0
    support: float = 0.0
    placed: bool = True
    fixed: bool = False
    starts: int = 0
    away: bool = False
    mechanism: float = 0.0


def object_pose(
    position: Float[np.ndarray, "3"],
    quaternion: Float[np.ndarray, "4"],
    reference: Float[np.ndarray, "4"],
) -> Float[np.ndarray, "7"]:
    """(7,) float32 pose of the object: position [m] and quaternion w x y z, whose sign never jumps.

    Args:
        position: (3,) position of the object in the world [m].
        quaternion: (4,) rotation of the object, w x y z.
        reference: (4,) rotation at the start. The result is q or -q, whichever is nearer to it.
    """
    sign = 1.0 if float(np.dot(quaternion, reference)) >= 0.0 else -1.0
    return np.concatenate([position, sign * quaternion]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class ScenePart:
    """One shape of a scene, for drawing.

    Attributes:
        name: name of the shape.
        kind: ``box``, ``capsule`` or ``cylinder``.
        size: half lengths of a box; radius and half length along z of the others [m].
        color: (4,) red, green, blue and opacity, 0 to 1.
        position: (3,) position in the object's frame if ``moves``, else in the world [m].
        quaternion: (4,) rotation to that frame, w x y z.
        moves: True for a part of the object.
    """

    name: str
    kind: str
    size: tuple[float, ...]
    color: tuple[float, float, float, float]
    position: Float[np.ndarray, "3"]
    quaternion: Float[np.ndarray, "4"]
    moves: bool
