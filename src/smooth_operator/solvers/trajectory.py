"""Settings of trajectory optimisation; the solver is ``smooth_operator.lab.offline``'s."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from smooth_operator.errors import ConfigError

SPEEDING: Final = 500.0
"""Cost of a joint's change beyond the speed limit [1/rad^2]; what a frame asks is worth a few."""


@dataclass(frozen=True)
class TrajectoryConfig:
    """Weights of the motion's cost, against a frame's cost of one.

    Attributes:
        acceleration_weight: weight of squared joint acceleration [s^4/rad^2].
        motion_weight: weight of the difference of fingertip velocities to the human's [s^2], in
            units of a keyvector's weight.
        motion_speed: human fingertip speed at which that weight is halved [m/s]; it goes on to fall
            with the square of the speed. 0 leaves it constant.
        speed_limit: largest speed of joints [rad/s]; a faster change between frames at the median
            rate costs half of ``SPEEDING`` times the square of what is too much. After a lost
            frame a command must not jump further than after any other.
        iterations: Newton steps at most.
        tolerance: a step that moves no joint further ends it [rad].
    """

    acceleration_weight: float
    motion_weight: float = 0.0
    motion_speed: float = 0.0
    speed_limit: float = math.inf
    iterations: int = 40
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        if not 0 < self.acceleration_weight < math.inf:
            raise ConfigError(
                f"acceleration_weight must be positive, not {self.acceleration_weight}"
            )
        for name in ("motion_weight", "motion_speed"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ConfigError(f"{name} must not be negative, not {getattr(self, name)}")
        if not self.speed_limit > 0:
            raise ConfigError(f"speed_limit must be positive [rad/s], not {self.speed_limit}")
        if self.iterations < 1 or not self.tolerance > 0:
            raise ConfigError(
                "a trajectory needs iterations >= 1 and tolerance > 0, not "
                f"iterations={self.iterations}, tolerance={self.tolerance}"
            )


FUTURE: Final = TrajectoryConfig(
    acceleration_weight=2e-8, motion_weight=0.07, motion_speed=0.6, speed_limit=28.0
)
"""Costs of motion in the presets ``offline``."""
