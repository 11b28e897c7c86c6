"""MuJoCo model of a robot hand for physics: servos, couplings, contacts, a fixture.

Models of hands are made for kinematics or for one vendor's simulator: most lack actuators, rotors
or sensible damping. Every hand therefore gets the same servo here. Its stiffness follows from the
inertia that it moves and a bandwidth, its damping is critical, and its torque is limited to the
maker's figure (``HandSpec.torque``), so that a blocked finger pushes as hard as the real one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float, Int

from smooth_operator.errors import HandModelError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.loading import load_spec
from smooth_operator.hands.penetration import parts_above
from smooth_operator.simulation.arms.arm import add_servo, inertia_matrix

ARMATURE: Final = 5e-4
"""Inertia of a finger motor's rotor behind its gears, at least [kg m^2]."""

FURNISHED: Final = "hand/"
"""Prefix of the hand's names in a model that holds more than a hand."""

TORQUE: Final = 0.6
"""Torque limit of a finger's motor in a scene [N m] without a figure of its maker: about 10 N at a
fingertip 6 cm away."""

_ACCELERATION: Final = 2000.0
"""Acceleration that the torque limit allows [rad/s^2] for an empty hand without a figure of its
maker; above the acceleration limit of the live loop."""

_STOP_S: Final = 0.005
"""Time constant of the joints' end stops [s]; MuJoCo's default yields by degrees of angle."""

_TOUCHING: Final = 1e-4
"""Distance at rest below which two shapes never collide [m]: shapes are larger than real parts."""


@dataclass(frozen=True, eq=False)
class PhysicsModel:
    """A compiled hand with servos.

    Attributes:
        model: the model.
        qpos: (n,) address of each joint of the hand among the model's positions.
        dofs: (n,) address of each joint among its velocities.
        controls: (m,) address of each servo among its controls.
    """

    model: mujoco.MjModel
    qpos: Int[np.ndarray, " n"]
    dofs: Int[np.ndarray, " n"]
    controls: Int[np.ndarray, " m"]


def build_physics(
    hand: Hand,
    *,
    timestep: float,
    bandwidth: float,
    gravity: bool = False,
    furnish: Callable[[mujoco.MjSpec], mujoco.MjSpec] | None = None,
) -> PhysicsModel:
    """Build a hand's model for physics.

    The palm stands on a fixture; joints that are not the hand's, such as an arm's, are removed.
    Neighbouring bodies do not collide, nor bodies whose shapes overlap at rest.

    Args:
        timestep: time step of the physics [s].
        bandwidth: bandwidth of the servos [Hz].
        gravity: pull along -z of the model's world.
        furnish: puts the hand's model with its servos into a world, under names that begin with
            ``FURNISHED``, and returns that world.

    Raises:
        HandModelError: MuJoCo can't compile the result.
    """
    try:
        bare = _bare(hand, timestep, gravity)
        model = bare.compile()
    except ValueError as error:
        raise HandModelError(f"hand {hand.name!r} can't be simulated: {error}") from error
    inertia = _inertia(hand, model)
    pairs = _never_collide(hand, model)
    spec = _bare(hand, timestep, gravity)  # a new one: compiling fixes values in a spec
    for first, second in pairs:
        exclude = spec.add_exclude()
        exclude.bodyname1, exclude.bodyname2 = first, second
    most = inertia * _ACCELERATION
    if furnish is not None:
        most = np.minimum(most, TORQUE)
    torques = np.where(np.isfinite(hand.torques), hand.torques, most)
    for name, load, torque in zip(hand.actuated_names, inertia, torques, strict=True):
        add_servo(spec, name, float(load), float(torque), bandwidth)
    try:
        model = spec.compile() if furnish is None else furnish(spec).compile()
    except ValueError as error:
        raise HandModelError(f"hand {hand.name!r} can't be simulated: {error}") from error
    prefix = "" if furnish is None else FURNISHED
    joints = [model.joint(prefix + name) for name in hand.joint_names]
    return PhysicsModel(
        model,
        np.array([int(joint.qposadr[0]) for joint in joints]),
        np.array([int(joint.dofadr[0]) for joint in joints]),
        np.array([int(model.actuator(prefix + name).id) for name in hand.actuated_names]),
    )


def _bare(hand: Hand, timestep: float, gravity: bool) -> mujoco.MjSpec:
    """The hand on its fixture, without actuators, with its couplings as equalities."""
    spec = load_spec(hand.spec.model, mirror=hand.spec.mirror)
    own = set(hand.joint_names)
    joint_equality = mujoco.mjtEq.mjEQ_JOINT
    doomed = [*spec.actuators, *spec.sensors, *spec.keys, *spec.tendons]
    doomed += [equality for equality in spec.equalities if equality.type == joint_equality]
    doomed += [joint for joint in spec.joints if joint.name not in own]
    for element in doomed:
        spec.delete(element)
    reference = {joint.name: float(joint.ref) for joint in spec.joints}
    for coupling in hand.couplings:
        equality = spec.add_equality()
        equality.type, equality.active = joint_equality, True
        equality.name1, equality.name2 = coupling.joint, coupling.follows
        # q1 - ref1 = c0 + c1 (q2 - ref2)
        offset = coupling.multiplier * reference[coupling.follows] + coupling.offset
        data = np.zeros_like(np.asarray(equality.data))
        data[:2] = offset - reference[coupling.joint], coupling.multiplier
        equality.data = data
    for joint in spec.joints:
        joint.armature = max(float(joint.armature), ARMATURE)
        joint.frictionloss = 0.0
        joint.damping = np.zeros_like(joint.damping)
        joint.stiffness = np.zeros_like(joint.stiffness)
        joint.solref_limit = (max(_STOP_S, 2.5 * timestep), 1.0)
    option = spec.option
    option.timestep = timestep
    option.gravity = (0.0, 0.0, -9.81 if gravity else 0.0)
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # ``HandPhysics`` resets
    return spec


def _inertia(hand: Hand, model: mujoco.MjModel) -> Float[np.ndarray, " m"]:
    """(m,) inertia at each servo in the neutral pose, coupled joints included [kg m^2]."""
    data = mujoco.MjData(model)
    addresses = [int(model.joint(name).qposadr[0]) for name in hand.joint_names]
    dofs = [int(model.joint(name).dofadr[0]) for name in hand.joint_names]
    data.qpos[addresses] = hand.full_configuration(hand.neutral)
    mujoco.mj_forward(model, data)
    matrix = hand.coupling_matrix
    reduced = matrix.T @ inertia_matrix(model, data)[np.ix_(dofs, dofs)] @ matrix
    return np.asarray(np.diag(reduced))


def _never_collide(hand: Hand, model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Pairs of bodies that are joined, directly or over one link, or overlap in the neutral pose.

    MuJoCo itself excludes a body and its parent, except where the parent is fixed to the world, as
    the palm on its fixture is.
    """
    data = mujoco.MjData(model)
    data.qpos[[int(model.joint(name).qposadr[0]) for name in hand.joint_names]] = (
        hand.full_configuration(hand.neutral)
    )
    mujoco.mj_forward(model, data)
    weld = np.asarray(model.body_weldid)
    shaped = [b for b in range(model.nbody) if model.body_geomnum[b]]
    pairs: set[tuple[int, int]] = set()
    for one in shaped:
        parts = parts_above(model, int(weld[one]))[:2]
        pairs |= {
            (min(one, other), max(one, other))
            for other in shaped
            if weld[other] in parts and weld[other] != weld[one]
        }
    for contact in data.contact[: data.ncon]:
        if contact.dist < _TOUCHING:
            one, other = sorted(int(model.geom_bodyid[g]) for g in contact.geom)
            pairs.add((one, other))
    return [(model.body(a).name, model.body(b).name) for a, b in sorted(pairs) if a]
