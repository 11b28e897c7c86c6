"""LeRobot teleoperator ``smooth_operator``, with which a tracked human hand drives a robot."""

from lerobot_teleoperator_smooth_operator.config_smooth_operator import SmoothOperatorConfig
from lerobot_teleoperator_smooth_operator.end_effector import StartAtRobot
from lerobot_teleoperator_smooth_operator.landmark_steps import (
    LandmarksToEndEffector,
    LandmarksToJoints,
)
from lerobot_teleoperator_smooth_operator.smooth_operator import SmoothOperator

__all__ = [
    "LandmarksToEndEffector",
    "LandmarksToJoints",
    "SmoothOperator",
    "SmoothOperatorConfig",
    "StartAtRobot",
]
