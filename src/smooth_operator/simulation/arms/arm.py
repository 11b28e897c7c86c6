"""Description of a robot arm (kinematics, limits, capsules) and its MuJoCo model."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import cos, sin
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.simulation.arms.rigid import Matrix, pose_of

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Capsule:
    """Shape of a link: all points within a radius of a line segment, in the link's frame [m]."""

    start: Point
    end: Point
    radius: float


@dataclass(frozen=True)
class Link:
    """A joint and the link that it turns.

    The frame is that of the modified Denavit-Hartenberg convention (Craig): from the previous link,
    turn by ``alpha`` about x, move by ``a`` along x and by ``d`` along the new z, which is the
    joint's axis.

    Attributes:
        joint: name of the joint, as in the maker's description and in MuJoCo Menagerie.
        alpha: twist about x [rad].
        a: offset along x [m].
        d: offset along the joint's axis [m].
        limits: lowest and highest position [rad].
        velocity: velocity limit by the maker's data sheet [rad/s].
        acceleration: acceleration limit [rad/s^2].
        torque: torque limit [N m].
        mass: mass of the link [kg].
        capsules: shape of the link.
    """

    joint: str
    alpha: float
    a: float
    d: float
    limits: tuple[float, float]
    velocity: float
    acceleration: float
    torque: float
    mass: float
    capsules: tuple[Capsule, ...]


@dataclass(frozen=True)
class ArmSpec:
    """A robot arm.

    Attributes:
        name: name in the catalogue.
        title: the maker's name of it.
        links: the links, from the base.
        flange: distance of the flange from the last joint, along its z [m].
        base: capsules of the base, in its frame: z up, x forward.
        nominal: (n,) preferred joint positions [rad].
        home: (3,) start of the hand's wrist in the base frame [m].
        pitch: downward tilt of the fingers there [rad].
        roll: turn of a hand about the flange's z with which its back points up there [rad].
        reach: reach of the flange by the data sheet [m].
        sources: sources of the figures.
        back: additional distance of the base from a task, for hands whose fingers are level at home
            [m].
        notes: which figures are not the maker's.
    """

    name: str
    title: str
    links: tuple[Link, ...]
    flange: float
    base: tuple[Capsule, ...]
    nominal: tuple[float, ...]
    home: Point
    pitch: float
    roll: float
    reach: float
    sources: tuple[str, ...]
    back: float = 0.0
    notes: tuple[str, ...] = field(default=())

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

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(n,) names of the joints, from the base."""
        return tuple(link.joint for link in self.links)

    @cached_property
    def limits(self) -> Float[np.ndarray, "n 2"]:
        """(n, 2) limits of the positions [rad]."""
        return np.array([link.limits for link in self.links])

    @cached_property
    def velocity(self) -> Float[np.ndarray, " n"]:
        """(n,) limits of the velocities [rad/s]."""
        return np.array([link.velocity for link in self.links])

    @cached_property
    def acceleration(self) -> Float[np.ndarray, " n"]:
        """(n,) limits of the accelerations [rad/s^2]."""
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
_ROTOR: Final = 0.1  # inertia of a geared motor [kg m^2]; MuJoCo Menagerie's Panda and UR5e have it


def arm_spec(arm: ArmSpec) -> mujoco.MjSpec:
    """MuJoCo model of an arm on its base, without actuators.

    Its bodies are ``BASE``, ``link1`` to ``linkn`` and ``FLANGE``. Its weight is compensated, as
    the arms' own controllers do.
    """
    spec = mujoco.MjSpec()
    spec.modelname = arm.name
    spec.compiler.degree = False
    body = spec.worldbody.add_body(name=BASE)
    _add_capsules(body, BASE, arm.base, 0.0, _GREY)
    for number, link in enumerate(arm.links, start=1):
        alpha = link.alpha
        body = body.add_body(
            name=f"link{number}",
            pos=(link.a, -sin(alpha) * link.d, cos(alpha) * link.d),
            quat=(cos(alpha / 2), sin(alpha / 2), 0.0, 0.0),
            gravcomp=1.0,
        )
        body.add_joint(
            name=link.joint, type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 0, 1),
            limited=True, range=link.limits, armature=_ROTOR,
        )  # fmt: skip
        _add_capsules(body, f"link{number}", link.capsules, link.mass, _WHITE)
    body.add_body(name=FLANGE, pos=(0.0, 0.0, arm.flange))
    return spec


def attach_to_flange(
    world: mujoco.MjSpec, hand: mujoco.MjSpec, flange_to_model: Matrix, prefix: str
) -> None:
    """Put a hand's model on the flange of an arm; its weight is compensated, too.

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
    """Add a critically damped position servo: torque = kp (target - q) - kv dq/dt, limited.

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
    """(v, v) joint-space inertia matrix at the positions of ``data``, after ``mj_forward``."""
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
        body.add_geom(
            name=f"{name}_{number}", type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=(*capsule.start, *capsule.end), size=(capsule.radius, 0.0, 0.0),
            mass=mass * float(length / sum(lengths)), rgba=color,
            contype=0, conaffinity=_HANDS,
        )  # fmt: skip
