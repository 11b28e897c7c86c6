"""Robot arms that carry a hand: descriptions, MuJoCo models, and transforms from flange to wrist.

Single poses are 4 x 4 matrices for the live loop. ``smooth_operator.poses`` does the same for
arrays of poses; for a single pose MuJoCo's functions take a tenth of its time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import cos, sin
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from smooth_operator.errors import ConfigError
from smooth_operator.hands.collision import shape_capsules
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.palm import human_palm_axes

Matrix = Float[np.ndarray, "4 4"]
Pose = Float[np.ndarray, "7"]


def matrix_of(pose: ArrayLike) -> Matrix:
    """Converts a position [m] and a quaternion (w x y z, not zero) to a homogeneous matrix."""
    values = np.asarray(pose, float)
    turn, quaternion = np.zeros(9), values[3:] / np.linalg.norm(values[3:])
    mujoco.mju_quat2Mat(turn, quaternion)
    return rigid(turn.reshape(3, 3), values[:3])


def pose_of(matrix: Matrix) -> Pose:
    """Converts a homogeneous matrix to a position [m] and a unit quaternion (w first, not
    negative)."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(matrix[:3, :3]).ravel())
    return np.concatenate([matrix[:3, 3], quaternion if quaternion[0] >= 0 else -quaternion])


def rigid(rotation: ArrayLike, position: ArrayLike) -> Matrix:
    """Makes a homogeneous matrix from a (3, 3) rotation and a (3,) position [m]."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, position
    return out


def inverse(matrix: Matrix) -> Matrix:
    """Inverts a rigid transform."""
    turn = matrix[:3, :3].T
    return rigid(turn, -turn @ matrix[:3, 3])


def angle_between(one: Matrix, other: Matrix) -> float:
    """Angle of the rotation from one homogeneous matrix to another [rad]."""
    cosine = (float((one[:3, :3] * other[:3, :3]).sum()) - 1.0) / 2.0
    return math.acos(min(max(cosine, -1.0), 1.0))


def hand_directions(hand: Hand) -> Float[np.ndarray, "3 3"]:
    """Matrix whose rows are the distal, radial and palmar directions in the palm frame, at right
    angles to each other."""
    distal, radial, palmar = human_palm_axes(hand)
    distal = np.asarray(distal) / np.linalg.norm(distal)
    palmar = np.asarray(palmar) - (palmar @ distal) * distal
    palmar /= np.linalg.norm(palmar)
    side = np.cross(distal, palmar)
    return np.stack([distal, side * np.sign(side @ radial), palmar])


Point = tuple[float, float, float]
Place = tuple[float, float, float, float, float, float, float]
"""Pose of a frame in another one: x y z [m], quaternion w x y z."""


def denavit_hartenberg(alpha: float, a: float, d: float) -> Place:
    """Pose of a joint's frame in the previous joint's frame, by the modified convention (Craig):
    rotate by ``alpha`` about x [rad], move by ``a`` along x, then by ``d`` along the new z axis
    [m], about which the joint turns."""
    return (a, -sin(alpha) * d, cos(alpha) * d, cos(alpha / 2), sin(alpha / 2), 0.0, 0.0)


@dataclass(frozen=True)
class Capsule:
    """Shape around a link: all points within a radius of a line segment, in the link's frame
    [m]."""

    start: Point
    end: Point
    radius: float


@dataclass(frozen=True)
class Link:
    """A joint and the link that it rotates about the z axis of the link's frame.

    Attributes:
        joint: name of the joint, as in the maker's description and in MuJoCo Menagerie.
        place: frame of the link in that of the previous one, at position 0.
        limits: lowest and highest position [rad].
        velocity: velocity limit in the maker's data sheet [rad/s].
        acceleration: acceleration limit [rad/s^2].
        torque: torque limit [N m].
        mass: mass of the link [kg].
        capsules: shape of the link.
    """

    joint: str
    place: Place
    limits: tuple[float, float]
    velocity: float
    acceleration: float
    torque: float
    mass: float
    capsules: tuple[Capsule, ...]


@dataclass(frozen=True)
class ArmSpec:
    """Description of a robot arm.

    Attributes:
        name: name in the catalogue.
        title: the maker's name of the arm.
        links: the links, from the base.
        flange: frame of the flange, whose z points out of it, in that of the last link.
        base: capsules of the base, in its frame: z up, x forward.
        nominal: (n,) preferred joint positions [rad].
        reach: reach of the flange in the data sheet [m].
        sources: sources of the figures.
        home: (3,) initial position of the hand's wrist in the base frame [m]; None to start in the
            nominal posture.
        pitch: downward tilt of the fingers there [rad].
        roll: rotation of a hand about the flange's z with which its back points up there [rad].
        back: additional distance of the base from a task, for hands whose fingers are level at home
            [m].
        notes: which figures are not the maker's.
        gripper: name of the hand that is built onto the arm, and the frame of its model in that of
            the flange; None if any hand is mounted by its own shape.
    """

    name: str
    title: str
    links: tuple[Link, ...]
    flange: Place
    base: tuple[Capsule, ...]
    nominal: tuple[float, ...]
    reach: float
    sources: tuple[str, ...]
    home: Point | None = None
    pitch: float = 0.0
    roll: float = 0.0
    back: float = 0.0
    notes: tuple[str, ...] = field(default=())
    gripper: tuple[str, Place] | None = None

    def __post_init__(self) -> None:
        if len(self.nominal) != len(self.links):
            raise ConfigError(
                f"arm {self.name!r}: expected {len(self.links)} nominal positions, "
                f"not {len(self.nominal)}"
            )
        for link, q in zip(self.links, self.nominal, strict=True):
            low, high = link.limits
            if not low < q < high:
                raise ConfigError(
                    f"arm {self.name!r}: the nominal position {q} of {link.joint} is not within "
                    f"its limits {low} to {high}"
                )

    def mount_of(self, hand: str) -> Place | None:
        """Pose of a hand's model in the flange's frame, if the arm's maker mounts that hand on
        it."""
        return self.gripper[1] if self.gripper is not None and self.gripper[0] == hand else None

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(n,) names of the joints, starting at the base."""
        return tuple(link.joint for link in self.links)

    @cached_property
    def limits(self) -> Float[np.ndarray, "n 2"]:
        """(n, 2) position limits [rad]."""
        return np.array([link.limits for link in self.links])

    @cached_property
    def velocity(self) -> Float[np.ndarray, " n"]:
        """(n,) velocity limits [rad/s]."""
        return np.array([link.velocity for link in self.links])

    @cached_property
    def acceleration(self) -> Float[np.ndarray, " n"]:
        """(n,) acceleration limits [rad/s^2]."""
        return np.array([link.acceleration for link in self.links])


FLANGE: Final = "flange"
"""Name of the body to which a hand is attached; its z points out of the flange."""

BASE: Final = "base"
"""Name of the body that stands on the table."""

ARM_PREFIX: Final = "arm/"
"""Prefix of the arm's names in a world that holds more than an arm."""

_WHITE: Final = (0.86, 0.87, 0.88, 1.0)
_GREY: Final = (0.45, 0.47, 0.5, 1.0)
_HANDS: Final = 0xFFFF  # collides with hands, objects and the table, not with itself
_POINT: Final = 1e-6  # length below which a capsule is a sphere [m]
_ROTOR: Final = 0.1  # inertia of a geared motor [kg m^2]; MuJoCo Menagerie's Panda and UR5e have it


def arm_spec(arm: ArmSpec) -> mujoco.MjSpec:
    """Builds the MuJoCo model of an arm on its base, without actuators.

    Its bodies are ``BASE``, ``link1`` to ``linkn`` and ``FLANGE``. Gravity is compensated, as in
    the arms' own controllers.
    """
    spec = mujoco.MjSpec()
    spec.modelname = arm.name
    spec.compiler.degree = False
    body = spec.worldbody.add_body(name=BASE)
    _add_capsules(body, BASE, arm.base, 0.0, _GREY)
    for number, link in enumerate(arm.links, start=1):
        body = body.add_body(
            name=f"link{number}", pos=link.place[:3], quat=link.place[3:], gravcomp=1.0
        )
        body.add_joint(
            name=link.joint,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=(0, 0, 1),
            limited=True,
            range=link.limits,
            armature=_ROTOR,
        )
        _add_capsules(body, f"link{number}", link.capsules, link.mass, _WHITE)
    body.add_body(name=FLANGE, pos=arm.flange[:3], quat=arm.flange[3:])
    return spec


def attach_to_flange(
    world: mujoco.MjSpec, hand: mujoco.MjSpec, flange_to_model: Matrix, prefix: str
) -> None:
    """Attaches a hand's model to the flange of an arm. Gravity on the hand is compensated too.

    Args:
        world: a world with an arm, whose names begin with ``ARM_PREFIX``; it is changed.
        hand: the hand's model, which must not be used afterwards.
        flange_to_model: pose of the world of the hand's model in the flange's frame.
    """
    for body in hand.bodies:
        if body.name != "world":
            body.gravcomp = 1.0
    pose = pose_of(flange_to_model)
    frame = world.body(ARM_PREFIX + FLANGE).add_frame(pos=pose[:3], quat=pose[3:])
    world.attach(hand, prefix=prefix, frame=frame)


def add_servo(
    spec: mujoco.MjSpec, joint: str, inertia: float, torque: float, bandwidth: float
) -> None:
    """Adds a critically damped position servo: torque = kp (target - q) - kv dq/dt, limited.

    Args:
        spec: the model that has the joint; it is changed.
        joint: name of the joint and of the new servo.
        inertia: inertia that the servo moves [kg m^2].
        torque: torque limit [N m].
        bandwidth: bandwidth of the servo [Hz].
    """
    omega = 2.0 * np.pi * bandwidth
    kp, kv = inertia * omega**2, 2.0 * inertia * omega
    actuator = spec.add_actuator()
    actuator.name = actuator.target = joint
    actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
    actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm = _padded(actuator.gainprm, kp)
    actuator.biasprm = _padded(actuator.biasprm, 0.0, -kp, -kv)
    # The model's defaults are for its own actuators; these set ours back to MuJoCo's.
    actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
    actuator.gear = _padded(actuator.gear, 1.0)
    actuator.inheritrange = 0.0
    actuator.ctrllimited = actuator.actlimited = False
    actuator.forcelimited = True
    actuator.forcerange = (-torque, torque)


def inertia_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, "v v"]:
    """(v, v) joint-space inertia matrix at the positions in ``data``, after ``mj_forward``."""
    full = np.zeros((model.nv, model.nv))
    try:
        mujoco.mj_fullM(model, data, full)
    except TypeError:  # up to MuJoCo 3.3: packed matrix as an argument, and the result first
        mujoco.mj_fullM(model, full, data.qM)
    return full


def _padded(like: np.ndarray, *values: float) -> np.ndarray:
    out = np.zeros_like(np.asarray(like))
    out[: len(values)] = values
    return out


def _add_capsules(
    body: mujoco.MjsBody,
    name: str,
    capsules: tuple[Capsule, ...],
    mass: float,
    color: tuple[float, float, float, float],
) -> None:
    lengths = [np.linalg.norm(np.subtract(c.end, c.start)) + c.radius for c in capsules]
    for number, (capsule, length) in enumerate(zip(capsules, lengths, strict=True)):
        sphere = length - capsule.radius < _POINT
        shape = {"pos": capsule.start} if sphere else {"fromto": (*capsule.start, *capsule.end)}
        body.add_geom(
            name=f"{name}_{number}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE if sphere else mujoco.mjtGeom.mjGEOM_CAPSULE,
            **shape,
            size=(capsule.radius, 0.0, 0.0),
            mass=mass * float(length / sum(lengths)),
            rgba=color,
            contype=0,
            conaffinity=_HANDS,
        )


@dataclass(frozen=True, eq=False)
class HandMount:
    """How a hand is mounted on a flange: its fingers point along the flange's z, away from the arm.

    Frames: the flange's z points out of the flange. The hand's wrist frame has x toward the base of
    the middle finger, z out of the back of the hand, y = z x x; that is the frame of
    ``WristCommand``.

    Attributes:
        hand: the robot hand.
        adapter: thickness of the plate between flange and hand [m].
        roll: rotation of the hand about the flange's z [rad]; at 0 its back points along x.
        built_on: frame of the hand's model in that of the flange, for the gripper of an arm;
            adapter and roll do not count then.
    """

    hand: Hand
    adapter: float = 0.02
    roll: float = 0.0
    built_on: Place | None = None

    @cached_property
    def palm_to_wrist(self) -> Matrix:
        """Pose of the wrist frame in the palm frame."""
        distal, _, palmar = hand_directions(self.hand)
        back = -palmar
        return rigid(np.stack([distal, np.cross(back, distal), back], axis=1), self.hand.wrist)

    @cached_property
    def model_to_palm(self) -> Matrix:
        """Pose of the palm frame in the world of the hand's own model, with forearm joints at
        rest."""
        hand = self.hand
        data = mujoco.MjData(hand.model)
        data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
        mujoco.mj_kinematics(hand.model, data)
        body = hand.model.body(hand.spec.palm).id
        return rigid(data.xmat[body].reshape(3, 3), data.xpos[body])

    @cached_property
    def length(self) -> float:
        """Distance from the hand's rear end to its wrist, along the fingers [m]."""
        model, data = self.hand.model, mujoco.MjData(self.hand.model)
        data.qpos[:] = self.hand.qpos(self.hand.full_configuration(self.hand.neutral))
        mujoco.mj_kinematics(model, data)
        to_wrist = inverse(self.model_to_palm @ self.palm_to_wrist)
        rear = 0.0
        for geom in range(model.ngeom):
            for capsule in shape_capsules(model, geom):
                turn = data.xmat[capsule.body].reshape(3, 3)
                ends = capsule.ends @ turn.T + data.xpos[capsule.body]
                along = ends @ to_wrist[0, :3] + to_wrist[0, 3]
                rear = min(rear, float(along.min()) - capsule.radius)
        return -rear

    @cached_property
    def flange_to_wrist(self) -> Matrix:
        """Pose of the wrist frame in the flange's frame."""
        if self.built_on is not None:
            return np.asarray(matrix_of(self.built_on) @ self.model_to_palm @ self.palm_to_wrist)
        c, s = np.cos(self.roll), np.sin(self.roll)
        back = np.array([c, s, 0.0])
        out = np.array([0.0, 0.0, 1.0])
        turn = np.stack([out, np.cross(back, out), back], axis=1)
        return rigid(turn, (self.adapter + self.length) * out)

    @cached_property
    def wrist_to_pinch(self) -> Matrix:
        """Pose, in the wrist frame, of a frame midway between the tips of thumb and index
        finger."""
        hand = self.hand
        tips = hand.tips(hand.full_configuration(hand.neutral))[:2]
        middle = inverse(self.palm_to_wrist) @ np.append(tips.mean(axis=0), 1.0)
        return rigid(np.eye(3), middle[:3])

    @cached_property
    def flange_to_model(self) -> Matrix:
        """Pose, in the flange's frame, of the world of the hand's own model."""
        return np.asarray(self.flange_to_wrist @ inverse(self.model_to_palm @ self.palm_to_wrist))


class HandCapsules:
    """Capsules around a hand's parts, whose poses in the flange's frame follow the fingers.

    Args:
        mount: the hand on its flange.

    Attributes:
        radii: (c,) radii [m].
        halves: (c,) half lengths of the segments [m].
        fingers: (c,) mask of the capsules that joints of the hand move; for a gripper, whose fixed
            jaw belongs to the palm, all capsules.
    """

    def __init__(self, mount: HandMount) -> None:
        hand = mount.hand
        self._hand, self._model = hand, hand.model
        self._data = mujoco.MjData(hand.model)
        self._flange = mount.flange_to_model
        model = hand.model
        sites = [
            capsule
            for geom in range(model.ngeom)
            if model.geom_contype[geom] or model.geom_conaffinity[geom]
            for capsule in shape_capsules(model, geom)
        ]
        self._body = np.array([capsule.body for capsule in sites], int)
        ends = np.array([capsule.ends for capsule in sites]).reshape(-1, 2, 3)
        self._middle, axis = ends.mean(axis=1), ends[:, 1] - ends[:, 0]
        self.radii: Float[np.ndarray, " c"] = np.array([capsule.radius for capsule in sites])
        length = np.linalg.norm(axis, axis=1)
        self.halves: Float[np.ndarray, " c"] = length / 2
        upward = np.where(length[:, None] > 1e-9, axis, (0.0, 0.0, 1.0))
        self._axis = upward / np.linalg.norm(upward, axis=1)[:, None]
        palm = model.body_weldid[model.body(hand.spec.palm).id]
        moving = {int(palm)}
        body = int(palm)
        while body:
            body = int(model.body_weldid[model.body_parentid[body]])
            moving.add(body)
        self.fingers = ~np.isin(model.body_weldid[self._body], list(moving)) | hand.spec.gripper

    def __len__(self) -> int:
        return len(self.radii)

    def at(
        self, positions: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "c 3"], Float[np.ndarray, "c 3"]]:
        """Centres [m] and axes (unit vectors) of the capsules in the flange's frame.

        Args:
            positions: (n,) positions of all joints of the hand [rad].
        """
        self._data.qpos[:] = self._hand.qpos(positions)
        mujoco.mj_kinematics(self._model, self._data)
        turn = self._data.xmat.reshape(-1, 3, 3)[self._body]
        middle = np.einsum("cij,cj->ci", turn, self._middle) + self._data.xpos[self._body]
        axis = np.einsum("cij,cj->ci", turn, self._axis)
        rotation, origin = self._flange[:3, :3], self._flange[:3, 3]
        return middle @ rotation.T + origin, axis @ rotation.T


BANDWIDTH: Final = 20
"""Bandwidth of the servos of a simulated arm [Hz]. With that of the hand's servos, the reaction to
a pressing finger moves the arm by at most 2 mm."""


@dataclass(frozen=True, eq=False)
class CarriedHand:
    """An arm with a hand, at a given place in the room.

    Attributes:
        arm: the arm.
        mount: the hand on its flange.
        home: (n,) positions of the arm's joints at the start [rad].
        base: (4, 4) pose of the arm's base in the room: z up.
    """

    arm: ArmSpec
    mount: HandMount
    home: Float[np.ndarray, " n"]
    base: Matrix

    def at_base(self, base: ArrayLike) -> CarriedHand:
        """Returns a copy whose base is at another (3,) position [m] and faces along x."""
        return replace(self, base=rigid(np.eye(3), base))

    def attach(self, world: mujoco.MjSpec, hand: mujoco.MjSpec, prefix: str) -> None:
        """Adds the arm to a world, with servos, and the hand on its flange.

        Args:
            world: the world; it is changed.
            hand: the hand's model, which must not be used afterwards.
        """
        pose = pose_of(self.base)
        frame = world.worldbody.add_frame(pos=pose[:3], quat=pose[3:])
        world.attach(arm_spec(self.arm), prefix=ARM_PREFIX, frame=frame)
        attach_to_flange(world, hand, self.mount.flange_to_model, prefix)
        for link, inertia in zip(self.arm.links, self._inertia, strict=True):
            add_servo(world, ARM_PREFIX + link.joint, float(inertia), link.torque, BANDWIDTH)

    def addresses(self, model: mujoco.MjModel) -> ArmAddresses:
        """Addresses of the arm's joints and servos in a compiled world."""
        return ArmAddresses.of(model, self.arm.joint_names)

    @cached_property
    def _inertia(self) -> Float[np.ndarray, " n"]:
        """(n,) inertia at each servo at home, with the hand as a point mass [kg m^2]."""
        spec, hand = arm_spec(self.arm), self.mount
        mass = max(float(hand.hand.model.body_mass.sum()), 0.1)
        payload = spec.body(FLANGE).add_body(name="payload", pos=hand.flange_to_wrist[:3, 3])
        payload.add_geom(size=(0.03, 0.0, 0.0), mass=mass)
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[:] = self.home
        mujoco.mj_forward(model, data)
        return np.diag(inertia_matrix(model, data)).copy()


@dataclass(frozen=True, eq=False)
class ArmAddresses:
    """Where an arm's joints and servos are in the arrays of a compiled world.

    Attributes:
        qpos: (n,) addresses of its joints among the positions.
        dofs: (n,) addresses of its joints among the velocities.
        controls: (n,) addresses of its servos among the controls.
    """

    qpos: Int[np.ndarray, " n"]
    dofs: Int[np.ndarray, " n"]
    controls: Int[np.ndarray, " n"]

    @classmethod
    def of(cls, model: mujoco.MjModel, joints: Iterable[str]) -> ArmAddresses:
        """Finds the addresses of joints that have servos; the names are given without
        ``ARM_PREFIX``."""
        names = [ARM_PREFIX + name for name in joints]
        return cls(
            np.array([int(model.joint(name).qposadr[0]) for name in names]),
            np.array([int(model.joint(name).dofadr[0]) for name in names]),
            np.array([int(model.actuator(name).id) for name in names]),
        )


class WristKinematics:
    """Forward kinematics from an arm's joints to the palm and wrist of its hand. Not thread-safe.

    Args:
        carried: the arm with its hand.
    """

    def __init__(self, carried: CarriedHand) -> None:
        self._carried = carried
        self._model = arm_spec(carried.arm).compile()
        self._data = mujoco.MjData(self._model)
        self._flange = self._model.body(FLANGE).id

    def wrist(self, positions: Float[np.ndarray, " n"]) -> Pose:
        """Pose of the hand's wrist in the arm's base frame, at (n,) joint positions [rad]."""
        return pose_of(self._flange_at(positions) @ self._carried.mount.flange_to_wrist)

    def palm(self, positions: Float[np.ndarray, " n"]) -> Pose:
        """Pose of the hand's palm frame in the room at (n,) joint positions [rad]."""
        mount = self._carried.mount
        to_palm = mount.flange_to_model @ mount.model_to_palm
        return pose_of(self._carried.base @ self._flange_at(positions) @ to_palm)

    def _flange_at(self, positions: Float[np.ndarray, " n"]) -> Matrix:
        self._data.qpos[:] = positions
        mujoco.mj_kinematics(self._model, self._data)
        turn = self._data.xmat[self._flange].reshape(3, 3)
        return rigid(turn, self._data.xpos[self._flange])
