"""Simulates a robot hand in MuJoCo: takes joint commands and returns joint positions.

Models of hands are made for kinematics or for one vendor's simulator: most lack actuators, rotors
or sensible damping. Therefore every hand gets the same kind of servo here. Its stiffness follows
from the inertia that it moves and a bandwidth, its damping is critical, and its torque is limited
to the maker's figure (``HandSpec.torque``), so that a blocked finger pushes as hard as the real
one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float, Int
from numpy.polynomial import Polynomial

from smooth_operator.errors import ConfigError, HandModelError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.loading import load_spec
from smooth_operator.hands.penetration import parts_above
from smooth_operator.simulation.arms.arm import add_servo, inertia_matrix
from smooth_operator.simulation.arms.free_wrist import HandCarrier

ARMATURE: Final = 5e-4
"""Minimum inertia of a finger motor's rotor, as seen through its gears [kg m^2]."""

FURNISHED: Final = "hand/"
"""Prefix of the hand's names in a model that holds more than a hand."""

TORQUE: Final = 0.6
"""Torque limit of a finger's motor in a scene [N m] if the maker states none: about 10 N at a
fingertip 6 cm away.
"""

_ACCELERATION: Final = 2000.0
"""Acceleration that the torque limit of an empty hand allows if the maker states no torque
[rad/s^2]; it is above the acceleration limit of the live loop.
"""

_STOP_S: Final = 0.005
"""Time constant of the joints' end stops [s]; MuJoCo's default lets joints pass the stops by
degrees.
"""

_TOUCHING: Final = 1e-4
"""Distance at rest below which two shapes never collide [m], because shapes are larger than real
parts.
"""


@dataclass(frozen=True, eq=False)
class PhysicsModel:
    """A compiled model of a hand with servos.

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
    """Builds a hand's model for physics.

    The palm is on a fixture; joints that are not the hand's, such as an arm's, are removed.
    Neighbouring bodies and bodies whose shapes overlap at rest do not collide.

    Args:
        timestep: time step of the physics [s].
        bandwidth: bandwidth of the servos [Hz].
        gravity: True for gravity along -z of the model's world.
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
    """Builds the hand on its fixture, without actuators and with its couplings as equalities."""
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
        # q1 - ref1 = c0 + c1 (q2 - ref2) + c2 (q2 - ref2)^2 + ...
        shifted = Polynomial(coupling.coefficients)(Polynomial([reference[coupling.follows], 1.0]))
        data = np.zeros_like(np.asarray(equality.data))
        data[: len(shifted.coef)] = shifted.coef
        data[0] -= reference[coupling.joint]
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
    matrix = hand.transmission.slopes(hand.neutral)
    reduced = matrix.T @ inertia_matrix(model, data)[np.ix_(dofs, dofs)] @ matrix
    return np.asarray(np.diag(reduced))


def _never_collide(hand: Hand, model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Pairs of bodies that are joined, directly or over one link, or overlap in the neutral pose.

    MuJoCo itself excludes a body and its parent, except if the parent is fixed to the world, like
    the palm on its fixture.
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


def finger_bodies(
    hand: Hand, model: mujoco.MjModel, prefix: str = FURNISHED
) -> Int[np.ndarray, " b"]:
    """(b,) index of the finger to which each body belongs, thumb first; -1 for all other bodies.

    Args:
        prefix: prefix of the hand's names in the model.
    """
    palm = model.body(prefix + hand.spec.palm).id
    numbers = np.full(model.nbody, -1)
    for number, finger in enumerate(hand.spec.fingers):
        body = model.body(prefix + finger.tip.body).id
        while body not in (palm, 0):
            numbers[body] = number if numbers[body] < 0 else numbers[body]
            body = int(model.body_parentid[body])
    for body, parent in enumerate(model.body_parentid):  # parents come first
        numbers[body] = numbers[parent] if numbers[body] < 0 else numbers[body]
    return numbers


_RUNAWAY = 500.0
"""Joint velocity above which the simulation counts as diverged [rad/s]."""


class HandPhysics:
    """A simulated hand with position servos, mounted on a fixture. Not thread-safe.

    Args:
        hand: the robot hand.
        timestep: time step of the physics [s].
        bandwidth: bandwidth of the servos [Hz]. With a higher one, the hand follows faster and
        pushes harder.
        gravity: True for gravity along -z of the model's world.
        furnish: adds the surroundings of the hand, see ``build_physics``.
        carried: the arm or free wrist on which ``furnish`` puts the hand; None for a fixture.

    Attributes:
        time: simulated time [s].
        carried: the arm or free wrist that carries the hand; None on a fixture.
        resets: number of times that the simulation diverged and was reset to the command.
    """

    def __init__(
        self,
        hand: Hand,
        timestep: float = 0.002,
        bandwidth: float = 20.0,
        gravity: bool = False,
        furnish: Callable[[mujoco.MjSpec], mujoco.MjSpec] | None = None,
        carried: HandCarrier | None = None,
    ) -> None:
        if not (0.0 < timestep <= 0.005 and 0.0 < bandwidth <= 0.05 / timestep):
            raise ConfigError(
                "simulation: expected a time step up to 5 ms and a bandwidth up to 0.05 / time "
                f"step, not {timestep} s and {bandwidth} Hz"
            )
        self.hand = hand
        self.time = 0.0
        self.resets = 0
        self._built = build_physics(
            hand, timestep=timestep, bandwidth=bandwidth, gravity=gravity, furnish=furnish
        )
        model = self._built.model
        self._data = mujoco.MjData(model)
        bodies = finger_bodies(hand, model, "" if furnish is None else FURNISHED)
        self._finger_of_geom = bodies[model.geom_bodyid]
        self.carried = carried
        self._arm = None if carried is None else carried.addresses(self._built.model)
        self._home = np.zeros(0) if carried is None else carried.home
        self._arm_target: Float[np.ndarray, " a"] = self._home
        self._due = 0.0
        self._actuated = list(hand.actuated)
        self._target: Float[np.ndarray, " m"] = hand.neutral.copy()
        self._place(self._target)

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self._built.model

    @property
    def data(self) -> mujoco.MjData:
        """State of the model; callers only read it."""
        return self._data

    def restart(self) -> None:
        """Resets the hand to time 0, at rest in the neutral pose."""
        self.time = self._due = 0.0
        self.resets = 0
        self._target = self.hand.neutral.copy()
        self._arm_target = self._home
        self._place(self._target)

    @property
    def positions(self) -> Float[np.ndarray, " n"]:
        """(n,) positions of the joints [rad], in the order of ``hand.joint_names``."""
        return np.array(self._data.qpos[self._built.qpos])

    @property
    def arm_positions(self) -> Float[np.ndarray, " a"] | None:
        """(a,) joint positions of the arm or of the free wrist [rad or m]; None on a fixture."""
        return None if self._arm is None else np.array(self._data.qpos[self._arm.qpos])

    @property
    def velocities(self) -> Float[np.ndarray, " n"]:
        """(n,) velocities of the joints [rad/s]."""
        return np.array(self._data.qvel[self._built.dofs])

    @property
    def timestep(self) -> float:
        """Time step of the physics [s]."""
        return float(self._built.model.opt.timestep)

    @property
    def contacts(self) -> int:
        """Number of contacts."""
        return int(self._data.ncon)

    @property
    def finger_forces(self) -> Float[np.ndarray, " f"]:
        """(f,) normal force on each finger from objects, palm and other fingers, thumb first
        [N]."""
        forces = np.zeros(len(self.hand.fingers) + 1)  # the last one: of all other bodies
        contacts, wrench = self._data.contact, np.zeros(6)
        owners = self._finger_of_geom[contacts.geom]
        counts = (owners[:, 0] != owners[:, 1]) & (contacts.efc_address >= 0)
        for index in np.flatnonzero(counts):
            mujoco.mj_contactForce(self._built.model, self._data, index, wrench)
            for owner in owners[index]:
                forces[owner] += wrench[0]
        return forces[:-1]

    def command(self, positions: Float[np.ndarray, " n"]) -> None:
        """Sets the targets of the hand's servos.

        Args:
            positions: (n,) positions of all joints [rad]. Coupled joints follow their leaders. A
                value that is not finite leaves its target unchanged; others are clipped to the
                limits.
        """
        targets = np.asarray(positions, float)[self._actuated]
        targets = np.clip(targets, self.hand.limits[:, 0], self.hand.limits[:, 1])
        self._target = np.where(np.isfinite(targets), targets, self._target)
        self._data.ctrl[self._built.controls] = self._target

    def command_arm(self, positions: Float[np.ndarray, " a"]) -> None:
        """Sets the targets of the arm's servos; does nothing without an arm.

        Args:
            positions: (a,) targets [rad]. A value that is not finite leaves its target unchanged.
        """
        if self._arm is not None:
            finite = np.isfinite(positions)
            self._arm_target = np.where(finite, positions, self._arm_target)
            self._data.ctrl[self._arm.controls] = self._arm_target

    def hold(self) -> None:
        """Makes the current positions of hand and arm the targets of their servos."""
        self.command(self.positions)
        arm = self.arm_positions
        if arm is not None:
            self.command_arm(arm)

    def advance(self, seconds: float) -> bool:
        """Simulates whole time steps; the remainder is added to the next call.

        Args:
            seconds: simulated time to add [s].

        Returns:
            False if the simulation diverged and was reset, else True.
        """
        step = self.timestep
        self._due += seconds
        count = int(self._due / step + 1e-9)
        if count <= 0:
            return True
        self._due -= count * step
        self.time += count * step
        self._step(count)
        # A NaN fails the comparison, too.
        if np.abs(self._data.qvel).max() < _RUNAWAY and np.isfinite(self._data.qpos).all():
            return True
        self.resets += 1
        self._place(self._target)
        return False

    def _step(self, count: int) -> None:
        mujoco.mj_step(self._built.model, self._data, count)

    def _place(self, target: Float[np.ndarray, " m"]) -> None:
        """Set the hand to a pose, at rest."""
        mujoco.mj_resetData(self._built.model, self._data)
        self._data.qpos[self._built.qpos] = self.hand.full_configuration(target)
        self._data.ctrl[self._built.controls] = target
        if self._arm is not None:
            self._data.qpos[self._arm.qpos] = self._arm_target
            self._data.ctrl[self._arm.controls] = self._arm_target
        mujoco.mj_forward(self._built.model, self._data)
