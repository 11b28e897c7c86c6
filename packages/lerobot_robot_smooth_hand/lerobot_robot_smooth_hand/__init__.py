"""LeRobot robot ``smooth_hand``, a simulated or real robot hand."""

from lerobot_robot_smooth_hand.config_smooth_hand import SmoothHandConfig
from lerobot_robot_smooth_hand.smooth_hand import SmoothHand

__all__ = ["SmoothHand", "SmoothHandConfig"]
