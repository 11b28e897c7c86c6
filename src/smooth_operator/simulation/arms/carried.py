"""A hand on an arm: place of the arm, MuJoCo models of both, kinematics of the wrist."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from smooth_operator.simulation.arms.arm import (
    ARM_PREFIX,
    FLANGE,
    ArmSpec,
    add_servo,
    arm_spec,
    attach_to_flange,
    inertia_matrix,
)
from smooth_operator.simulation.arms.hand_mount import HandMount
from smooth_operator.simulation.arms.rigid import Matrix, Pose, pose_of, rigid

BANDWIDTH: Final = 20
"""Bandwidth of the servos of a simulated arm [Hz]. With that of the hand's servos, the reaction to
a pressing finger moves the arm by at most 2 mm."""


@dataclass(frozen=True, eq=False)
class CarriedHand:
    """An arm at its place in the room, with a hand.

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
        """A copy with the base at another place (3,) [m], facing along x."""
        return replace(self, base=rigid(np.eye(3), base))

    def attach(self, world: mujoco.MjSpec, hand: mujoco.MjSpec, prefix: str) -> None:
        """Put the arm into a world, with servos, and the hand on its flange.

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
        names = [ARM_PREFIX + name for name in self.arm.joint_names]
        return ArmAddresses(
            np.array([int(model.joint(name).qposadr[0]) for name in names]),
            np.array([int(model.joint(name).dofadr[0]) for name in names]),
            np.array([int(model.actuator(name).id) for name in names]),
        )

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
    """Addresses of an arm in a compiled world.

    Attributes:
        qpos: (n,) addresses of its joints among the positions.
        dofs: (n,) addresses of its joints among the velocities.
        controls: (n,) addresses of its servos among the controls.
    """

    qpos: Int[np.ndarray, " n"]
    dofs: Int[np.ndarray, " n"]
    controls: Int[np.ndarray, " n"]


class WristKinematics:
    """Forward kinematics from an arm's joints to palm and wrist of its hand. Not thread-safe.

    Args:
        carried: the arm with its hand.
    """

    def __init__(self, carried: CarriedHand) -> None:
        self._carried = carried
        self._model = arm_spec(carried.arm).compile()
        self._data = mujoco.MjData(self._model)
        self._flange = self._model.body(FLANGE).id

    def wrist(self, positions: Float[np.ndarray, " n"]) -> Pose:
        """Pose of the hand's wrist in the arm's base frame at (n,) joint positions [rad]."""
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
