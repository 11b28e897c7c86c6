"""Settings of the loop; light to import, since the command line shows them all in its help."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from smooth_operator.errors import ConfigError


@dataclass(frozen=True)
class SafetyConfig:
    """What happens when the tracker fails, and how the operator comes back.

    Attributes:
        stale_s: A hand whose last usable frame is older than this is held [s].
        lost_s: After this long without one it goes to its safe pose [s].
        on_loss: What then: ease to the neutral pose, or hold the last command for ever.
        ease_velocity: Speed of the fastest joint on the way to the safe pose [rad/s].
        blend_s: Time to go over to the operator after a loss or a pause [s]; after a gap that is
            shorter than this, as long as the gap.
        restart_s: Stamps that go back by more than this are a tracker that was started again; by
            less, frames out of order, which are refused [s].
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
        for name in ("stale_s", "ease_velocity", "watchdog_s"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"safety: {name} must be positive, not {getattr(self, name)}")
        for name in ("blend_s", "restart_s"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"safety: {name} must not be negative, not {getattr(self, name)}")
        if not self.lost_s >= self.stale_s:
            raise ConfigError(
                f"safety: lost_s must not be below stale_s, not {self.lost_s} < {self.stale_s}"
            )


@dataclass(frozen=True)
class LimitsConfig:
    """Limits of what leaves the loop, whatever the method asks for.

    Attributes:
        velocity: Largest velocity of any joint, coupled ones included [rad/s].
        acceleration: Largest acceleration of any joint [rad/s^2].
        margin: Kept clear of each end of a joint's range [rad].
    """

    velocity: float = 15.0
    acceleration: float = 1500.0
    margin: float = 0.0

    def __post_init__(self) -> None:
        if not (self.velocity > 0 and self.acceleration > 0 and self.margin >= 0):
            raise ConfigError(
                "limits: velocity and acceleration must be positive and margin not negative, not "
                f"{self.velocity}, {self.acceleration} and {self.margin}"
            )


@dataclass(frozen=True)
class LoopConfig:
    """Pace of the loop.

    Attributes:
        rate: commands per second and hand; never more, and that many where frames come too slowly
            or not at all [Hz].
        safety: what happens when the tracker fails.
        limits: of what leaves the loop.
    """

    rate: float = 100.0
    safety: SafetyConfig = SafetyConfig()
    limits: LimitsConfig = LimitsConfig()

    def __post_init__(self) -> None:
        if not 1.0 <= self.rate <= 1000.0:
            raise ConfigError(f"rate must be between 1 and 1000 Hz, not {self.rate}")

    @property
    def period(self) -> float:
        """[s]."""
        return 1.0 / self.rate
