"""Settings of the environment, as LeRobot's command line shows them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGE, OBS_STATE, OBS_STR

from lerobot_env_smooth_hand.environment import WRIST_NAMES, state_names
from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.tasks import TASKS, task_named
from smooth_operator.types import as_side


@EnvConfig.register_subclass("smooth_hand")
@dataclass
class SmoothHandEnv(EnvConfig):
    """Settings of the environment; see ``HandTask`` for their meaning.

    Attributes:
        task: name of the task, such as ``card`` or ``relocate``.
        fps: steps per second, equal to the frame rate of the policy's training data [Hz].
        hand: name of the robot hand, or the path of its spec file.
        side: ``right`` or ``left``.
        seconds: time after which an episode is truncated [s]; 0 for the task's own limit.
        start: initial positions of the actuated joints [rad]; empty for the neutral pose.
        variation: factor by which the ranges of the object's variation are scaled.
        tactile: True if observations contain ``observation.tactile``, the force on each finger [N].
        pictures: True if observations contain ``observation.image``.
        width: width of a picture [px].
        height: height of a picture [px].
        render_mode: ``rgb_array``, which lets LeRobot write videos of evaluations.
        features: filled in from the hand.
        features_map: names of the features in data sets.
    """

    task: str | None = "card"
    fps: int = 25
    hand: str = "mimic_p050"
    side: str = "right"
    seconds: float = 0.0
    start: list[float] = field(default_factory=list)
    variation: float = 1.0
    tactile: bool = False
    pictures: bool = False
    width: int = 320
    height: int = 240
    render_mode: str = "rgb_array"
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(
        default_factory=lambda: {
            ACTION: ACTION,
            "agent_pos": OBS_STATE,
            "environment_state": OBS_ENV_STATE,
            "tactile": f"{OBS_STR}.tactile",
            "pixels": OBS_IMAGE,
        }
    )

    def __post_init__(self) -> None:
        """Fill in the features from the hand.

        Raises:
            SmoothOperatorError: there is no such hand or task.
        """
        task = task_named(self.task or "card")
        hand = load_hand(self.hand, as_side(self.side))
        joints = (len(hand.actuated) + (len(WRIST_NAMES) if task.moves_wrist else 0),)
        self.features = {
            ACTION: PolicyFeature(type=FeatureType.ACTION, shape=joints),
            "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=joints),
            "environment_state": PolicyFeature(
                type=FeatureType.ENV, shape=(len(state_names(task)),)
            ),
        }
        if self.tactile:
            fingers = (len(hand.fingers),)
            self.features["tactile"] = PolicyFeature(type=FeatureType.STATE, shape=fingers)
        if self.pictures:
            shape = (self.height, self.width, 3)
            self.features["pixels"] = PolicyFeature(type=FeatureType.VISUAL, shape=shape)

    @property
    def package_name(self) -> str:
        """Name of the module that registers the environments."""
        return "lerobot_env_smooth_hand"

    @property
    def gym_id(self) -> str:
        """Name of the environment in Gymnasium."""
        return f"smooth_hand/{self.task}"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of ``HandTask``."""
        return {
            "hand": self.hand,
            "side": self.side,
            "fps": self.fps,
            "seconds": self.seconds or None,
            "start": self.start or None,
            "variation": self.variation,
            "tactile": self.tactile,
            "pictures": self.pictures,
            "width": self.width,
            "height": self.height,
            "render_mode": self.render_mode,
        }


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: SmoothHandEnv | None = None
) -> dict[str, dict[int, Any]]:
    """Make the vectorised environments of all tasks, for LeRobot's EnvHub.

    Args:
        n_envs: number of environments of each task.
        use_async_envs: True to run them in processes of their own.
        cfg: settings of the only task; None for the defaults of all tasks.

    Returns:
        ``smooth_hand`` -> number of the task, in the order of ``TASKS`` -> environment.
    """
    configs = [SmoothHandEnv(task=name) for name in TASKS] if cfg is None else [cfg]
    environments = [each.create_envs(n_envs, use_async_envs)["smooth_hand"][0] for each in configs]
    return {"smooth_hand": dict(enumerate(environments))}
