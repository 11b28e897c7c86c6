"""The last word on a command: position, velocity and acceleration of every joint."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.runtime.settings import LimitsConfig

MAX_STEP_S = 0.1
"""Longest time that counts between two commands [s]: after a pause the robot does not catch up."""


class Limiter:
    """Follows a target within limits; holds what was last commanded.

    Every joint goes towards its target as fast as it may and still stop there: its speed is bounded
    by the velocity limit, by what the acceleration limit lets it brake from within the distance
    that is left, and by what takes it there in this step. A target that moves well within the
    limits is followed exactly, without lag.

    Args:
        hand: the robot hand.
        config: the limits; those of velocity and acceleration hold for coupled joints too.

    Attributes:
        q: (m,) last command of the actuated joints [rad].
        velocity: (m,) its velocity [rad/s].
    """

    def __init__(self, hand: Hand, config: LimitsConfig) -> None:
        room = (hand.limits[:, 1] - hand.limits[:, 0]).min()
        if 2 * config.margin >= room:
            raise ConfigError(
                f"limits: a margin of {config.margin} rad leaves nothing of the smallest joint "
                f"range of hand {hand.name!r}, {room:.3g} rad"
            )
        # the fastest joint that an actuated one moves, itself or one that follows it
        gearing = np.maximum(np.abs(hand.expansion[0]).max(axis=0), 1.0)
        self._velocity = config.velocity / gearing
        self._acceleration = config.acceleration / gearing
        self._low = hand.limits[:, 0] + config.margin
        self._high = hand.limits[:, 1] - config.margin
        self.q: Float[np.ndarray, " m"] = np.clip(hand.neutral, self._low, self._high)
        self.velocity: Float[np.ndarray, " m"] = np.zeros_like(self.q)

    def step(
        self,
        target: Float[np.ndarray, " m"],
        dt: float,
        max_velocity: float | None = None,
    ) -> Float[np.ndarray, " m"]:
        """The next command.

        Args:
            target: (m,) where to go [rad]; what is not finite stays where it is.
            dt: time since the last command [s].
            max_velocity: a lower limit of velocity for this step [rad/s].

        Returns:
            (m,) command [rad].
        """
        dt = _counted(dt)
        target = np.where(np.isfinite(target), target, self.q)
        error = np.clip(target, self._low, self._high) - self.q
        distance, a = np.abs(error), self._acceleration
        # The speed v from which steps v, v - a dt, v - 2 a dt, ... cover the distance, and no more:
        # n of them are whole, and (n + 1) v dt - n (n + 1) a dt^2 / 2 is the distance.
        units = distance / (a * dt**2)
        n = np.floor((np.sqrt(1 + 8 * units) - 1) / 2)
        braking = (units / (n + 1) + n / 2) * a * dt
        top = self._velocity if max_velocity is None else np.minimum(self._velocity, max_velocity)
        wanted = np.sign(error) * np.minimum(np.minimum(braking, top), distance / dt)
        velocity = np.clip(wanted, self.velocity - a * dt, self.velocity + a * dt)
        return self._go(np.clip(velocity, -self._velocity, self._velocity), dt)

    def rest(self, dt: float) -> Float[np.ndarray, " m"]:
        """Brake, and then stand.

        Args:
            dt: time since the last command [s].
        """
        dt = _counted(dt)
        slower = np.abs(self.velocity) - self._acceleration * dt
        return self._go(np.sign(self.velocity) * np.maximum(slower, 0.0), dt)

    def succeed(self, other: Limiter) -> None:
        """Go on from where another one of the same hand has brought it."""
        self.q, self.velocity = other.q, other.velocity

    def halt(self) -> Float[np.ndarray, " m"]:
        """Stand still at the last command."""
        self.velocity = np.zeros_like(self.q)
        return self.q

    def _go(self, velocity: Float[np.ndarray, " m"], dt: float) -> Float[np.ndarray, " m"]:
        # Margins may have been widened around a hand at rest: it goes inside, but doesn't jump.
        low, high = np.minimum(self._low, self.q), np.maximum(self._high, self.q)
        q = np.clip(self.q + velocity * dt, low, high)
        self.velocity = (q - self.q) / dt
        self.q = q
        return q


def _counted(dt: float) -> float:
    return min(max(dt, 1e-6), MAX_STEP_S)
