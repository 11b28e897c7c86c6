"""Processor steps for LeRobot's pipelines, which turn the landmarks of a human hand into an action.

With ``landmarks=true``, the teleoperator's action also has the keys ``landmarks.wrist.x``, …
``landmarks.pinky_tip.z`` [m] and ``landmarks.valid`` (1, or 0 without a hand). A step replaces
them, and leaves all other keys:

- ``LandmarksToJoints`` by the joints of a robot hand, ``JOINT.pos`` [rad];
- ``LandmarksToEndEffector``, with ``wrist=quaternion``, by the keys of LeRobot's own steps for arms
  (``EEBoundsAndSafety`` and ``InverseKinematicsEEToJoints`` in
  ``lerobot/robots/so_follower/robot_kinematic_processor.py``, LeRobot 0.6.1): ``ee.x``, ``ee.y``,
  ``ee.z`` [m], ``ee.wx``, ``ee.wy``, ``ee.wz`` (rotation vector [rad]) and ``ee.gripper_pos``
  (0 closed, 100 open).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from lerobot.configs.types import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.processor import ProcessorStepRegistry, RobotActionProcessorStep

import smooth_operator
from lerobot_teleoperator_smooth_operator.end_effector import EE_KEYS
from lerobot_teleoperator_smooth_operator.gripper import Gripper
from smooth_operator import poses
from smooth_operator.episode_files.lerobot.human import LANDMARK_NAMES
from smooth_operator.episode_files.lerobot.schema import pose_keys
from smooth_operator.retargeting import ProgramStore
from smooth_operator.types import as_side

LANDMARK_KEYS = (*(f"landmarks.{name}" for name in LANDMARK_NAMES), "landmarks.valid")
"""Keys of the landmarks in an action, without the prefix of a side."""

_EE_KEYS = (*EE_KEYS, "ee.gripper_pos")


@dataclass
class _LandmarkStep(RobotActionProcessorStep):
    """What both steps do with the keys of the landmarks.

    Attributes:
        prefix: prefix of all keys: empty, or ``right_`` or ``left_`` with both hands.
    """

    prefix: str = ""

    def get_config(self) -> dict[str, Any]:
        """The settings, from which LeRobot makes the step again."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def _taken(self, action: dict[str, Any], keys: Sequence[str], setting: str) -> np.ndarray:
        """Removes values from an action; ValueError if one is missing."""
        names = [f"{self.prefix}{key}" for key in keys]
        missing = [name for name in names if name not in action]
        if missing:
            raise ValueError(
                f"expected the keys {names[0]} to {names[-1]} in the action, found "
                f"{', '.join(action) or 'none'}; set --teleop.{setting}, and the step's prefix"
            )
        return np.array([float(action.pop(name)) for name in names])

    def _landmarks(self, action: dict[str, Any]) -> np.ndarray | None:
        """Removes the landmarks from an action; None without a hand."""
        values = self._taken(action, LANDMARK_KEYS, "landmarks=true")
        return values[:-1].reshape(21, 3) if values[-1] else None

    def _replaced(self, features: Any, gone: Sequence[str], new: Sequence[str]) -> Any:
        """Features with other keys of the action."""
        action = dict(features.get(PipelineFeatureType.ACTION, {}))
        for key in gone:
            action.pop(f"{self.prefix}{key}", None)
        for key in new:
            action[f"{self.prefix}{key}"] = PolicyFeature(type=FeatureType.ACTION, shape=(1,))
        return {**features, PipelineFeatureType.ACTION: action}


@ProcessorStepRegistry.register("smooth_operator_landmarks_to_joints")
@dataclass
class LandmarksToJoints(_LandmarkStep):
    """Step that retargets the landmarks to a robot hand, frame by frame.

    Without a hand it repeats its last command; before the first one, the neutral pose.

    Attributes:
        hand: name of the robot hand.
        side: side of both hands.
        method: retargeting method.
    """

    hand: str = "mimic_p050"
    side: str = "right"
    method: str = "smooth"

    def __post_init__(self) -> None:
        self._retargeter = smooth_operator.Retargeter(
            self.hand, side=self.side, method=self.method, cache=ProgramStore.of_user()
        )
        model = self._retargeter.hand
        self._keys = [f"{name}.pos" for name in model.joint_names]
        self._neutral = model.full_configuration(model.neutral)
        self._angles = self._neutral

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Replace the landmarks by joints."""
        landmarks = self._landmarks(action)
        if landmarks is not None:
            frame = smooth_operator.HandFrame(landmarks, side=as_side(self.side))
            self._angles = self._retargeter(frame).command.joint_positions
        keys = [f"{self.prefix}{key}" for key in self._keys]
        return {**action, **dict(zip(keys, map(float, self._angles), strict=True))}

    def reset(self) -> None:
        """Start from the neutral pose."""
        self._retargeter.reset()
        self._angles = self._neutral

    def transform_features(self, features: Any) -> Any:
        """Replace the keys in the features of the action."""
        return self._replaced(features, LANDMARK_KEYS, self._keys)


@ProcessorStepRegistry.register("smooth_operator_landmarks_to_end_effector")
@dataclass
class LandmarksToEndEffector(_LandmarkStep):
    """Step that replaces wrist and landmarks by an end effector with a gripper.

    Without a hand the gripper keeps its last opening, first open.

    Attributes:
        gripper: what closes the gripper: ``pinch`` or ``hand``; see ``Gripper``.
        touch_m: distance of the landmarks of both fingertips when they touch [m].
    """

    gripper: str = "pinch"
    touch_m: float = 0.01

    def __post_init__(self) -> None:
        self._gripper = Gripper(self.gripper, self.touch_m)

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Replace the wrist's target and the landmarks."""
        landmarks = self._landmarks(action)
        pose = self._taken(action, pose_keys(), "wrist=quaternion")
        if landmarks is not None:
            self._gripper.follow(landmarks)
        values = [*pose[:3], *poses.rotation_vectors(pose[3:]), self._gripper.opening]
        keys = [f"{self.prefix}{key}" for key in _EE_KEYS]
        return {**action, **dict(zip(keys, map(float, values), strict=True))}

    def reset(self) -> None:
        """Open the gripper."""
        self._gripper.reset()

    def transform_features(self, features: Any) -> Any:
        """Replace the keys in the features of the action."""
        return self._replaced(features, (*LANDMARK_KEYS, *pose_keys()), _EE_KEYS)
