"""LeRobot robot ``smooth_hand``: a robot hand, simulated or real; a camera for a simulated one."""

from lerobot_robot_smooth_hand.camera import SmoothHandCamera
from lerobot_robot_smooth_hand.config_camera import SmoothHandCameraConfig
from lerobot_robot_smooth_hand.config_smooth_hand import SmoothHandConfig
from lerobot_robot_smooth_hand.robot import SmoothHand

__all__ = ["SmoothHand", "SmoothHandCamera", "SmoothHandCameraConfig", "SmoothHandConfig"]
