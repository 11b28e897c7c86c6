"""A configuration for recordings: with the future known, all frames are solved at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NoReturn

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.methods.method import MethodConfig
from smooth_operator.solvers.trajectory import TrajectoryConfig


@dataclass(frozen=True)
class WholeConfig:
    """Settings of a method that needs the whole recording.

    Attributes:
        causal: the method that answers frame by frame. Its answer is where the solution begins, and
            its objective, but for the terms about the last frame, is what every frame is asked.
        future: what motion between the frames costs.
        bridge: gaps that are no longer are bridged [s]; over longer ones the last pose is held.
        leap: step of a landmark in one frame of which half is followed, the rest before and after
            it [m]: a tracker's jumps dominate the acceleration of a recording; 0 follows all.
        noise: by how many times the tracker's noise that step is longer.
    """

    causal: MethodConfig
    future: TrajectoryConfig
    bridge: float = 0.25
    leap: float = 0.0
    noise: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.leap < float("inf"):
            raise ConfigError(f"leap must be a step of 0 m or more, not {self.leap}")
        if not 0 <= self.noise < float("inf"):
            raise ConfigError(f"noise must be a factor of 0 or more, not {self.noise}")
        if not 0 <= self.bridge < float("inf"):
            raise ConfigError(f"bridge must be a time of 0 s or more, not {self.bridge}")

    @property
    def alignment(self) -> AlignmentConfig:
        """How landmarks reach the palm frame."""
        return self.causal.alignment

    @property
    def objective(self) -> Any:
        """That of the frame-by-frame method, where it has one."""
        return getattr(self.causal, "objective", None)

    def build(self, hand: Hand) -> NoReturn:
        """Refuses: there is no answer to a single frame.

        Raises:
            ConfigError: always.
        """
        raise ConfigError(
            "this preset looks at the whole recording, the future included, so it can't answer "
            "frame by frame: use it with `smooth-operator retarget`, and choose another preset for "
            "live use"
        )
