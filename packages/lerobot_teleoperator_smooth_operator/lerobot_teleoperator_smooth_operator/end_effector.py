"""Actions for an end effector with a gripper, as LeRobot's own steps for arms take them.

The keys are those of ``lerobot/robots/so_follower/robot_kinematic_processor.py`` (``ee.…``) and
``lerobot/processor/hil_processor.py`` (``delta_…``), LeRobot 0.6.1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from lerobot.processor import ProcessorStepRegistry, RobotActionProcessorStep, TransitionKey

from lerobot_teleoperator_smooth_operator.gripper import OPEN
from smooth_operator import poses

EE_KEYS = ("ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz")
"""Pose of an end effector in the robot's base: position [m] and rotation vector [rad]."""

DELTA_KEYS = ("delta_x", "delta_y", "delta_z")
"""Translation of an end effector since the last action, in steps of a set length, -1 to 1."""

_CLOSE, _STAY, _OPEN = 0.0, 1.0, 2.0
"""Commands of a gripper (``GripperAction`` in ``lerobot/teleoperators/gamepad``, 0.6.1)."""

_CLOSED_BELOW, _OPEN_ABOVE = 0.25 * OPEN, 0.75 * OPEN


def gripper_command(opening: float) -> float:
    """LeRobot's discrete command of a gripper (0 close, 1 stay, 2 open) for an opening."""
    if opening < _CLOSED_BELOW:
        return _CLOSE
    return _OPEN if opening > _OPEN_ABOVE else _STAY


class Steps:
    """Divides the motion of an end effector into steps of limited length.

    The part beyond one step follows in the next steps, so the sum of all steps is the motion.

    Args:
        length: translation for the value 1 [m].
    """

    def __init__(self, length: float) -> None:
        self._length = length
        self._sent: np.ndarray | None = None

    def next(self, position: np.ndarray) -> np.ndarray:
        """(3,) next step, each component -1 to 1, towards a position (3,) [m]."""
        sent = position if self._sent is None else self._sent
        step = np.clip((position - sent) / self._length, -1.0, 1.0)
        self._sent = sent + self._length * step
        return np.asarray(step)


@ProcessorStepRegistry.register("smooth_operator_start_at_robot")
@dataclass
class StartAtRobot(RobotActionProcessorStep):
    """Lets the end effector start at the robot's pose, and move as the operator moves.

    At the first action it stores the pose of the robot's end effector and that of the action. From
    then on, the robot's pose changes as that of the action: translation and rotation in the axes of
    the robot's base.

    Attributes:
        kinematics: LeRobot's ``RobotKinematics`` of the robot.
        motor_names: motors of the robot, in the order of its observation.
    """

    kinematics: Any
    motor_names: list[str]

    _start: np.ndarray | None = field(default=None, init=False, repr=False)
    _robot: np.ndarray | None = field(default=None, init=False, repr=False)

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Replace the pose of the end effector."""
        missing = [key for key in EE_KEYS if key not in action]
        observation = self.transition.get(TransitionKey.OBSERVATION) or {}
        missing += [n for n in self.motor_names if f"{n}.pos" not in observation]
        if missing:
            raise ValueError(
                f"expected the keys {EE_KEYS[0]} to {EE_KEYS[-1]} in the action and the motors "
                f"{', '.join(self.motor_names)} in the observation; {', '.join(missing)} are "
                "missing; set --teleop.wrist=ee"
            )
        vector = np.array([float(action[key]) for key in EE_KEYS])
        pose = np.concatenate([vector[:3], poses.from_rotation_vectors(vector[3:])])
        if self._start is None or self._robot is None:
            angles = np.array([float(observation[f"{n}.pos"]) for n in self.motor_names])
            self._start = pose
            self._robot = poses.from_matrices(np.array(self.kinematics.forward_kinematics(angles)))
        turn = poses.multiply(pose[3:], poses.conjugate(self._start[3:]))
        place = self._robot[:3] + pose[:3] - self._start[:3]
        vector = poses.rotation_vectors(poses.multiply(turn, self._robot[3:]))
        return {**action, **dict(zip(EE_KEYS, map(float, [*place, *vector]), strict=True))}

    def reset(self) -> None:
        """Start at the robot's pose again."""
        self._start = self._robot = None

    def transform_features(self, features: Any) -> Any:
        """Keep the features: the keys are the same."""
        return features
