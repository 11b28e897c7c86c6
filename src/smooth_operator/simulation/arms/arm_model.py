"""MuJoCo models of arms: the bare kinematics, and an arm in a world with a hand on its flange."""

from __future__ import annotations

from math import cos, sin
from typing import Final

import mujoco
import numpy as np

from smooth_operator.simulation.arms.arm import ArmSpec, Capsule
from smooth_operator.simulation.arms.rigid import Matrix, pose_of

FLANGE: Final = "flange"
"""Name of the body to which a hand is attached; its z points out of the flange."""

BASE: Final = "base"
"""Name of the body that stands on the table."""

ARM_PREFIX: Final = "arm/"
"""Before the names of all that is the arm's, in a world with more than an arm in it."""

_WHITE: Final = (0.86, 0.87, 0.88, 1.0)
_GREY: Final = (0.45, 0.47, 0.5, 1.0)
_HANDS: Final = 0xFFFF  # it touches hands, objects and the table, and not itself
_ROTOR: Final = 0.1  # inertia of a geared motor [kg m^2]; MuJoCo Menagerie's Panda and UR5e have it


def arm_spec(arm: ArmSpec) -> mujoco.MjSpec:
    """An arm on its base, without actuators.

    Its bodies are ``BASE``, ``link1`` to ``linkn`` and ``FLANGE``; its weight is compensated, as
    the arms' own controllers do it.
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
        world: with an arm, whose names begin with ``ARM_PREFIX``; it is changed.
        hand: the model, which must not be used afterwards.
        flange_to_model: pose of the model's own world on the flange.
        prefix: goes before the names of all that is the hand's.
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
    """A position servo with critical damping: torque = kp (target - q) - kv dq/dt, limited.

    Args:
        spec: with the joint; it is changed.
        joint: its name, which the servo has, too.
        inertia: that it moves [kg m^2].
        torque: most [N m].
        bandwidth: [Hz].
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
    # What the model's defaults may say of its own actuators does not hold for ours.
    actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
    actuator.gear = _padded(actuator.gear, 1.0)
    actuator.inheritrange = 0.0
    actuator.ctrllimited = actuator.actlimited = False
    actuator.forcelimited = True
    actuator.forcerange = (-torque, torque)


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
