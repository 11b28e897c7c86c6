"""LeRobot robot ``smooth_hand``: a robot hand, simulated or real."""

from lerobot_robot_smooth_hand.config_smooth_hand import SmoothHandConfig
from lerobot_robot_smooth_hand.robot import SmoothHand

__all__ = ["SmoothHand", "SmoothHandConfig"]
