"""A wrist that moves freely: three slides and three hinges carry the hand instead of an arm.

It is the same for every hand: servos of one stiffness, force and speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.arm import (
    ARM_PREFIX,
    BANDWIDTH,
    FLANGE,
    ArmAddresses,
    CarriedHand,
    HandMount,
    Pose,
    add_servo,
    attach_to_flange,
    inverse,
    matrix_of,
)

FORCE: Final = 40.0
"""Largest force of a slide [N]."""

TORQUE: Final = 8.0
"""Largest torque of a hinge [N m]."""

SPEED: Final = 0.5
"""Largest speed of the targets [m/s]."""

TURN_SPEED: Final = 2.0
"""Largest angular speed of the targets [rad/s]."""

_CARRIAGE: Final = (1.0, 0.01)  # inertia of each slide [kg] and of each hinge [kg m^2]
_SLIDES: Final = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
_HINGES: Final = {"pitch": (0, 1, 0), "yaw": (0, 0, 1), "roll": (1, 0, 0)}


@dataclass(frozen=True, eq=False)
class FreeWrist:
    """A hand on three slides and three hinges, whose positions are 0 in the start pose.

    The slides move along the axes of the wrist frame at the start; the hinges then rotate the hand
    about its y, its z and its x. The weight of the hand is compensated, that of an object is not.

    Attributes:
        hand: the robot hand.
        start: (7,) pose of the wrist frame (see ``HandMount``) in the world at the start: position
            [m] and quaternion wxyz.
    """

    hand: Hand
    start: Pose

    @property
    def home(self) -> Float[np.ndarray, "6"]:
        """(6,) positions of the slides [m] and hinges [rad] at the start: zeros."""
        return np.zeros(6)

    def attach(self, world: mujoco.MjSpec, hand: mujoco.MjSpec, prefix: str) -> None:
        """Adds slides, hinges and servos to a world, and the hand on them.

        Args:
            world: the world; it is changed.
            hand: the hand's model, which must not be used afterwards.
        """
        body = world.worldbody.add_body(
            name=ARM_PREFIX + FLANGE, pos=self.start[:3], quat=self.start[3:], gravcomp=1.0
        )
        mount = HandMount(self.hand)
        model_to_wrist = mount.model_to_palm @ mount.palm_to_wrist
        attach_to_flange(world, hand, inverse(model_to_wrist), prefix)
        model, data = self.hand.model, mujoco.MjData(self.hand.model)
        mujoco.mj_forward(model, data)
        away = ((data.xipos - model_to_wrist[:3, 3]) ** 2).sum(axis=1)
        slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
        for kind, axes, own, moved, most in (
            (slide, _SLIDES, _CARRIAGE[0], model.body_mass.sum(), FORCE),
            (hinge, _HINGES, _CARRIAGE[1], model.body_mass @ away, TORQUE),
        ):
            for name, axis in axes.items():
                body.add_joint(name=ARM_PREFIX + name, type=kind, axis=axis, armature=own)
                add_servo(world, ARM_PREFIX + name, own + float(moved), most, BANDWIDTH)

    def addresses(self, model: mujoco.MjModel) -> ArmAddresses:
        """Addresses of the slides and hinges in a compiled world."""
        return ArmAddresses.of(model, (*_SLIDES, *_HINGES))

    def targets(
        self, pose: Pose, before: Float[np.ndarray, "6"], seconds: float
    ) -> Float[np.ndarray, "6"]:
        """Returns (6,) targets of slides [m] and hinges [rad] that move towards a wrist pose,
        within the speed limits.

        Args:
            pose: (7,) pose of the wrist frame in the world; at more than 80 degrees of yaw, pitch
                and roll are no longer independent.
            before: (6,) previous targets.
            seconds: time since the previous targets [s]; infinity for no limit.
        """
        goal = inverse(matrix_of(self.start)) @ matrix_of(pose)
        pitch = np.arctan2(-goal[2, 0], goal[0, 0])
        yaw = np.arcsin(np.clip(goal[1, 0], -1.0, 1.0))
        roll = np.arctan2(-goal[1, 2], goal[1, 1])
        step = np.array([*goal[:3, 3], pitch, yaw, roll]) - before
        step[3:] = (step[3:] + np.pi) % (2.0 * np.pi) - np.pi
        for part, speed in ((step[:3], SPEED), (step[3:], TURN_SPEED)):
            part *= min(1.0, speed * seconds / max(float(np.linalg.norm(part)), 1e-9))
        return np.asarray(before + step)

    def pose(self, positions: Float[np.ndarray, "6"]) -> Pose:
        """Returns the (7,) pose of the wrist frame in the world at given positions of slides and
        hinges."""
        turn = np.array([1.0, 0.0, 0.0, 0.0])
        for vector in positions[3:, None] * np.array([*_HINGES.values()], float):
            turn = poses.multiply(turn, poses.from_rotation_vectors(vector))
        return poses.compose(self.start, np.concatenate([positions[:3], turn]))


HandCarrier: TypeAlias = CarriedHand | FreeWrist
"""What moves the wrist of a hand in physics: an arm, or a free wrist."""
