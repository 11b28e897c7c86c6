"""Settings of trajectory optimisation: all frames of a recording are solved together."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final, NoReturn

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.settings import LARGEST, check_numbers

SPEEDING: Final = 500.0
"""Cost of a joint's change beyond the speed limit [1/rad^2]; a frame costs a few units."""


@dataclass(frozen=True)
class TrajectoryConfig:
    """Weights of the costs of motion, relative to the cost of a single frame.

    Attributes:
        acceleration_weight: weight of squared joint acceleration [s^4/rad^2].
        motion_weight: weight of the difference of fingertip velocities to the human's [s^2], in
            units of a keyvector's weight.
        motion_speed: human fingertip speed at which that weight is halved [m/s]; the weight falls
            with the square of the speed. 0 keeps it constant.
        speed_limit: largest speed of joints [rad/s]; a faster change between frames at the median
            rate costs half of ``SPEEDING`` times the squared excess.
        iterations: maximum number of Newton steps.
        tolerance: the optimisation ends after a step that moves no joint further than this [rad].
    """

    acceleration_weight: float
    motion_weight: float = 0.0
    motion_speed: float = 0.0
    speed_limit: float = LARGEST
    iterations: int = 40
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        positive = ("acceleration_weight", "speed_limit", "iterations", "tolerance")
        check_numbers(self, positive=positive)


FUTURE: Final = TrajectoryConfig(
    acceleration_weight=2e-8, motion_weight=0.07, motion_speed=0.6, speed_limit=28.0
)
"""Costs of motion in the presets ``offline``."""


@dataclass(frozen=True)
class TrajectoryMethodConfig(MethodConfig):
    """Settings of trajectory optimisation, which solves all frames of a recording together.

    Attributes:
        causal: the frame-by-frame method. The optimisation starts from its result, and its
            objective without the terms about the last frame is the cost of each frame.
        future: costs of motion between the frames.
        bridge: longest gap that is bridged [s]; during a longer gap the last pose is held.
        jump: length of a landmark's step of which the filter follows half at once, and the rest
            before and after it [m]. 0 follows every step completely.
        noise: multiple of the tracker's noise that is added to ``jump``.
    """

    causal: MethodConfig
    future: TrajectoryConfig
    bridge: float = 0.25
    jump: float = 0.0
    noise: float = 0.0

    def __post_init__(self) -> None:
        check_numbers(self)

    @property
    def alignment(self) -> AlignmentConfig:  # type: ignore[override]
        """The alignment of landmarks that the frame-by-frame method uses."""
        return self.causal.alignment

    def build(self, hand: Hand) -> NoReturn:
        """Always raises ConfigError, because single frames can't be solved."""
        raise ConfigError(
            "this preset uses the whole recording, including future frames, so it can't run "
            "frame by frame: use it with `smooth-operator retarget`, and choose another "
            "preset for live use"
        )

    def with_alignment(self, **changes: Any) -> TrajectoryMethodConfig:
        """Returns these settings with another alignment of landmarks."""
        return dataclasses.replace(self, causal=self.causal.with_alignment(**changes))

    def notes(self, hand: Hand) -> tuple[str, ...]:
        """Notes on what a hand lacks for the frame-by-frame method."""
        return self.causal.notes(hand)
