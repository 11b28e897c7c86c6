"""Entry of a repository on the Hugging Face Hub: LeRobot's EnvHub loads this file by its name."""

from lerobot_env_smooth_hand.config_smooth_hand import make_env

__all__ = ["make_env"]
