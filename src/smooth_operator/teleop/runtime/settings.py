"""Settings of the teleoperation loop. This module is quick to import, because the command line
shows them in its help."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from typing import Literal

from smooth_operator.errors import ConfigError
from smooth_operator.settings import LARGEST, check_numbers, check_range


@dataclass(frozen=True)
class SafetyConfig:
    """What happens when the tracker fails, and when the operator comes back.

    Attributes:
        stale_s: Age of the last usable frame after which the hand holds its pose [s].
        lost_s: Age of the last usable frame after which the hand moves to its safe pose [s].
        on_loss: Safe pose: ease moves slowly to the neutral pose, hold keeps the last command.
        ease_velocity: Speed of the fastest joint while the hand moves to its safe pose [rad/s].
        blend_s: Time of the smooth return after a tracking loss or a pause [s]. After a gap shorter
            than this, the return takes as long as the gap.
        restart_s: Timestamps that jump back by more than this [s] mean that the tracker was
            restarted. Frames that jump back by less are out of order and are refused.
        watchdog_s: Time without commands after which the sinks are told that the loop hangs [s].
    """

    stale_s: float = 0.1
    lost_s: float = 2.0
    on_loss: Literal["ease", "hold"] = "ease"
    ease_velocity: float = 1.0
    blend_s: float = 0.5
    restart_s: float = 1.0
    watchdog_s: float = 0.2

    def __post_init__(self) -> None:
        check_numbers(
            self,
            "safety: ",
            positive=("stale_s", "lost_s", "ease_velocity", "watchdog_s"),
            not_negative=("blend_s", "restart_s"),
        )
        if not self.lost_s >= self.stale_s:
            raise ConfigError(
                f"safety: lost_s must be at least stale_s ({self.stale_s}), not {self.lost_s}"
            )


@dataclass(frozen=True)
class LimitsConfig:
    """Velocity, acceleration and range limits on the commands of every method.

    Attributes:
        velocity: Largest velocity of any joint, coupled ones included [rad/s].
        acceleration: Largest acceleration of any joint [rad/s^2].
        margin: Distance that joints keep from each end of their range [rad].
        wrist_velocity: Largest velocity of a wrist joint [rad/s]; the default is that of the URDF
            of the Shadow hand.
    """

    velocity: float = 15.0
    acceleration: float = 1500.0
    margin: float = 0.0
    wrist_velocity: float = 2.0

    def __post_init__(self) -> None:
        positive = ("velocity", "acceleration", "wrist_velocity")
        check_numbers(self, "limits: ", positive=positive, not_negative=("margin",))


@dataclass(frozen=True)
class WristConfig:
    """Settings of the clutch between the operator's wrist and the robot's wrist, and limits on the
    robot wrist's motion.

    Poses are in the frame of the robot's base: x forward, y left, z up.

    Attributes:
        scale: Ratio of the robot's wrist translation to the operator's. Rotations are not scaled.
        yaw: Direction of the operator's forward axis in the robot's base frame, counterclockwise
            from x [rad].
        velocity: Largest speed of the wrist [m/s].
        acceleration: Largest acceleration of the wrist [m/s^2].
        turn_velocity: Largest angular velocity of the wrist [rad/s].
        turn_acceleration: Largest angular acceleration of the wrist [rad/s^2].
        low: Minimum x, y and z of the workspace [m].
        high: Maximum x, y and z of the workspace [m].
        home: Initial wrist pose if no arm measures it: x y z [m], quaternion w x y z.
    """

    scale: float = 1.0
    yaw: float = 0.0
    velocity: float = 1.0
    acceleration: float = 10.0
    turn_velocity: float = 2.5
    turn_acceleration: float = 25.0
    low: tuple[float, float, float] = (-1.0, -1.0, 0.0)
    high: tuple[float, float, float] = (1.0, 1.0, 1.5)
    home: tuple[float, float, float, float, float, float, float] = (0.4, 0, 0.4, 1, 0, 0, 0)

    def __post_init__(self) -> None:
        check_numbers(
            self,
            "wrist: ",
            positive=("scale", "velocity", "acceleration", "turn_velocity", "turn_acceleration"),
            finite=("yaw",),
        )
        for corner in (self.low, self.high):
            for value in corner:
                check_range("wrist: x, y and z of low and high", value, -LARGEST, LARGEST, "m")
        corners = len(self.low) == len(self.high) == 3
        if not (corners and all(map(operator.lt, self.low, self.high))):
            raise ConfigError(
                "wrist: low and high must be x y z [m], low below high, not "
                f"{self.low} and {self.high}"
            )
        unit = abs(math.hypot(*self.home[3:]) - 1) < 1e-3
        if not (len(self.home) == 7 and unit and all(map(math.isfinite, self.home))):
            raise ConfigError(
                f"wrist: home must be x y z [m] and a unit quaternion w x y z, not {self.home}"
            )


@dataclass(frozen=True)
class LoopConfig:
    """Rate, safety and limits of the loop.

    Attributes:
        rate: commands per second for each hand [Hz]. This is the maximum rate, and the rate without
            frames.
        safety: behaviour when the tracker fails.
        limits: limits on the commands.
        wrist: settings of the wrist clutch.
    """

    rate: float = 100.0
    safety: SafetyConfig = SafetyConfig()
    limits: LimitsConfig = LimitsConfig()
    wrist: WristConfig = WristConfig()

    def __post_init__(self) -> None:
        check_range("rate", self.rate, 1.0, 1000.0, "Hz")

    @property
    def period(self) -> float:
        """Time between two commands [s]."""
        return 1.0 / self.rate
