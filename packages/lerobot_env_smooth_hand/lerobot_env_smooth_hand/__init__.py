"""LeRobot plug-in with the Gymnasium environments ``smooth_hand/card``, ``cube``, ``screwdriver``,
``relocate``, ``hammer`` and ``tongs``."""

import contextlib
import importlib.util

from smooth_operator.errors import ConfigError
from smooth_operator.simulation.renderer import draw_off_screen

# before MuJoCo is imported, which chooses its OpenGL then; a machine without one has no pictures
with contextlib.suppress(ConfigError):
    draw_off_screen()

from lerobot_env_smooth_hand.environment import HandTask, register

register()
if importlib.util.find_spec("lerobot") is not None:
    from lerobot_env_smooth_hand.config_smooth_hand import SmoothHandEnv as SmoothHandEnv

__all__ = ["HandTask"]
