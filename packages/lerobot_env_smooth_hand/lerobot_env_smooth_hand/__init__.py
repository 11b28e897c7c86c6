"""Gymnasium environments ``smooth_hand/card``, ``cube``, ``screwdriver``; LeRobot's plug-in."""

import importlib.util

from lerobot_env_smooth_hand.environment import HandTask, register

register()
if importlib.util.find_spec("lerobot") is not None:
    from lerobot_env_smooth_hand.config_smooth_hand import SmoothHandEnv as SmoothHandEnv

__all__ = ["HandTask"]
