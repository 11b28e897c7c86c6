"""LeRobot camera ``smooth_hand``, which shows a simulated hand."""

import contextlib

from smooth_operator.errors import ConfigError
from smooth_operator.simulation.renderer import draw_off_screen

# before MuJoCo is imported, which chooses its OpenGL then; a machine without one has no pictures
with contextlib.suppress(ConfigError):
    draw_off_screen()

from lerobot_camera_smooth_hand.config_smooth_hand_camera import SmoothHandCameraConfig
from lerobot_camera_smooth_hand.smooth_hand_camera import SmoothHandCamera

__all__ = ["SmoothHandCamera", "SmoothHandCameraConfig"]
