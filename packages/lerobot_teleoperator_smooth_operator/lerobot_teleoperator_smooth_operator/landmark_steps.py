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
from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.configs.types import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.processor import ProcessorStepRegistry, RobotActionProcessorStep

import smooth_operator
from smooth_operator import poses
from smooth_operator.episode_files.lerobot.human import LANDMARK_NAMES
from smooth_operator.episode_files.lerobot.schema import pose_keys
from smooth_operator.landmarks import index
from smooth_operator.retargeting import ProgramStore
from smooth_operator.types import as_side

LANDMARK_KEYS = (*(f"landmarks.{name}" for name in LANDMARK_NAMES), "landmarks.valid")
"""Keys of the landmarks in an action, without the prefix of a side."""

_EE_KEYS = ("ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz", "ee.gripper_pos")
_INDEX = [index(f"index_{part}") for part in ("mcp", "pip", "dip", "tip")]
_THUMB_TIP = index("thumb_tip")


@dataclass
class _LandmarkStep(RobotActionProcessorStep):
    """What both steps do with the keys of the landmarks.

    Attributes:
        prefix: prefix of all keys: empty, or ``right_`` or ``left_`` with both hands.
    """

    prefix: str = ""

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

    def get_config(self) -> dict[str, Any]:
        """The settings, from which LeRobot makes the step again."""
        return {
            "prefix": self.prefix,
            "hand": self.hand,
            "side": self.side,
            "method": self.method,
        }

    def transform_features(self, features: Any) -> Any:
        """Replace the keys in the features of the action."""
        return self._replaced(features, LANDMARK_KEYS, self._keys)


@ProcessorStepRegistry.register("smooth_operator_landmarks_to_end_effector")
@dataclass
class LandmarksToEndEffector(_LandmarkStep):
    """Step that replaces wrist and landmarks by an end effector with a gripper.

    The gripper is open (100) when thumb and index finger are the length of the index finger apart,
    and closed (0) when they touch. Without a hand it keeps its last opening, first open.

    Attributes:
        touch_m: distance of the landmarks of both fingertips when they touch [m].
    """

    touch_m: float = 0.01

    def __post_init__(self) -> None:
        self._opening = 100.0

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Replace the wrist's target and the landmarks."""
        landmarks = self._landmarks(action)
        pose = self._taken(action, pose_keys(), "wrist=quaternion")
        if landmarks is not None:
            finger = landmarks[_INDEX]
            length = float(np.linalg.norm(np.diff(finger, axis=0), axis=1).sum())
            apart = float(np.linalg.norm(landmarks[_THUMB_TIP] - finger[-1]))
            room = max(length - self.touch_m, self.touch_m)
            self._opening = 100.0 * min(max((apart - self.touch_m) / room, 0.0), 1.0)
        values = [*pose[:3], *poses.rotation_vectors(pose[3:]), self._opening]
        keys = [f"{self.prefix}{key}" for key in _EE_KEYS]
        return {**action, **dict(zip(keys, map(float, values), strict=True))}

    def reset(self) -> None:
        """Open the gripper."""
        self._opening = 100.0

    def get_config(self) -> dict[str, Any]:
        """The settings, from which LeRobot makes the step again."""
        return {"prefix": self.prefix, "touch_m": self.touch_m}

    def transform_features(self, features: Any) -> Any:
        """Replace the keys in the features of the action."""
        return self._replaced(features, (*LANDMARK_KEYS, *pose_keys()), _EE_KEYS)
