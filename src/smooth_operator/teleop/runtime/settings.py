"""Settings of the loop; light to import, since the command line shows them all in its help."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from typing import Literal

from smooth_operator.errors import ConfigError
from smooth_operator.settings import LARGEST, check_numbers, check_range


@dataclass(frozen=True)
class SafetyConfig:
    """Behaviour when the tracker fails, and when the operator comes back.

    Attributes:
        stale_s: The hand holds when its last usable frame is older than this [s].
        lost_s: The hand goes to its safe pose when its last usable frame is older than this [s].
        on_loss: Safe pose: ease to the neutral pose, or hold the last command.
        ease_velocity: Speed of the fastest joint on the way to the safe pose [rad/s].
        blend_s: Blend-in time after a tracking loss or a pause [s]; after a shorter gap it is as
            long as the gap.
        restart_s: If timestamps jump back by more than this, the tracker was restarted; frames that
            jump back by less are out of order and refused [s].
        watchdog_s: Silence of the loop after which sinks are notified [s].
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
                f"safety: lost_s must not be below stale_s, not {self.lost_s} < {self.stale_s}"
            )


@dataclass(frozen=True)
class LimitsConfig:
    """Limits on velocity, acceleration and range of the commands of every method.

    Attributes:
        velocity: Largest velocity of any joint, coupled ones included [rad/s].
        acceleration: Largest acceleration of any joint [rad/s^2].
        margin: Distance that is kept from each end of a joint's range [rad].
    """

    velocity: float = 15.0
    acceleration: float = 1500.0
    margin: float = 0.0

    def __post_init__(self) -> None:
        check_numbers(
            self, "limits: ", positive=("velocity", "acceleration"), not_negative=("margin",)
        )


@dataclass(frozen=True)
class WristConfig:
    """The clutch: how the operator's wrist moves the wrist of the robot hand, and its limits.

    Poses are in the frame of the robot's base: x forward, y left, z up.

    Attributes:
        scale: Metres of the robot for a metre of the operator's wrist; turns are never scaled.
        yaw: Direction of the operator's forward in the robot's base, counterclockwise from its
            x [rad].
        velocity: Largest speed of the wrist [m/s].
        acceleration: Largest acceleration of the wrist [m/s^2].
        turn_velocity: Largest angular velocity of the wrist [rad/s].
        turn_acceleration: Largest angular acceleration of the wrist [rad/s^2].
        low: Lowest x, y and z of the workspace [m].
        high: Highest x, y and z of the workspace [m].
        home: Start of the wrist without an arm that measures it: x y z [m], quaternion w x y z.
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
    """Pace of the loop.

    Attributes:
        rate: commands per second and hand [Hz]: the largest rate, and the rate without frames.
        safety: behaviour when the tracker fails.
        limits: limits on the commands.
        wrist: settings of the wrist's clutch.
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
