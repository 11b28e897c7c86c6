"""Limiter of commands: position, velocity and acceleration of every joint."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.runtime.settings import LimitsConfig

MAX_STEP_S: Final = 0.1
"""Longest time that counts between two commands [s]: after a pause the robot does not catch up."""

SHORTEST_S: Final = 1e-9
"""Steps are not divided by less than this [s]; the clock does not resolve shorter ones."""

USUAL_S: Final = 0.005
"""Step that a joint may count on to stop at its target [s]; few are shorter. It is no guarantee:
the end of a range is kept without it."""


class JointLimiter:
    """Follows a target within limits of joints; holds what was last commanded.

    The limits hold between the stamps of consecutive commands, however uneven these are. With
    positions ``q[k]`` at times ``t[k]``, steps ``dt[k] = t[k] - t[k-1]`` and velocities
    ``v[k] = (q[k] - q[k-1]) / dt[k]``:

    - ``q[k]`` is within the joint's range;
    - ``|v[k]|`` is at most the velocity limit;
    - ``|v[k] - v[k-1]|`` is at most the acceleration limit times the shorter of two times:
      ``dt[k]``, in which the velocity changes, and ``(dt[k-1] + dt[k]) / 2``, which lies between
      the middles of the two steps.

    A joint is always slow enough to stop before the end of its range, whatever steps follow. Any
    step may change the velocity by half of the acceleration limit times its length, whatever the
    step before it was. So the square of the velocity is kept below the acceleration limit times
    the distance that is left, and braking at that rate keeps it there in short and long steps.

    A target is no limit. A speed that one step of 5 ms can stop is allowed up to the target itself,
    so that a target that moves well within the limits is followed exactly, without lag. Above that
    speed the joint brakes ahead of the target.

    Args:
        ends: (m, 2) limits of the positions [rad].
        velocity: (m,) of the velocities [rad/s].
        acceleration: (m,) of the accelerations [rad/s^2].
        start: (m,) where the joints stand [rad].
        margin: kept clear of each end of a range [rad].

    Attributes:
        q: (m,) last command [rad].
        velocity: (m,) its velocity, from the command before [rad/s].
    """

    def __init__(
        self,
        ends: Float[np.ndarray, "m 2"],
        velocity: Float[np.ndarray, " m"],
        acceleration: Float[np.ndarray, " m"],
        start: Float[np.ndarray, " m"],
        margin: float = 0.0,
    ) -> None:
        self._velocity, self._acceleration = velocity, acceleration
        self._start, self._end = ends[:, 0], ends[:, 1]
        self._low, self._high = self._start + margin, self._end - margin
        self.q: Float[np.ndarray, " m"] = np.clip(start, self._low, self._high)
        self.velocity: Float[np.ndarray, " m"] = np.zeros_like(self.q)
        self._last_dt = math.inf  # it has stood still until now

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
        dt = max(dt, SHORTEST_S)
        target = np.where(np.isfinite(target), target, self.q)
        error = np.clip(target, self._low, self._high) - self.q
        a = self._acceleration
        speed = stoppable_speed(np.abs(error), dt, a, stopped_by_one=a * USUAL_S)
        if max_velocity is not None:
            speed = np.minimum(speed, max_velocity)
        return self._go(np.sign(error) * speed, dt)

    def rest(self, dt: float) -> Float[np.ndarray, " m"]:
        """Brake as hard as the limits let it, and then stand.

        Args:
            dt: time since the last command [s].

        Returns:
            (m,) command [rad].
        """
        return self._go(np.zeros_like(self.q), max(dt, SHORTEST_S))

    def bounds(self, dt: float) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Lowest and highest velocity that ``follow`` can give the joints in a step [rad/s].

        Args:
            dt: time since the last command [s].
        """
        down, up, change = self._room(max(dt, SHORTEST_S))
        slow, fast = self.velocity - change, self.velocity + change
        return np.clip(-down, slow, fast), np.clip(up, slow, fast)

    def follow(self, velocity: Float[np.ndarray, " m"], dt: float) -> Float[np.ndarray, " m"]:
        """Take a step at the velocity within the limits that is nearest to the one wanted.

        Args:
            velocity: (m,) [rad/s]; what is not finite stands for 0.
            dt: time since the last command [s].

        Returns:
            (m,) command [rad].
        """
        return self._go(np.where(np.isfinite(velocity), velocity, 0.0), max(dt, SHORTEST_S))

    def succeed(self, other: JointLimiter) -> None:
        """Go on from where another one of the same joints has brought them."""
        self.q, self.velocity, self._last_dt = other.q, other.velocity, other._last_dt

    def _room(
        self, dt: float
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Highest speeds down and up, and the most that a velocity may change, in a step."""
        # Limits may have become stricter in mid-motion. Where the new acceleration can no longer
        # stop a joint within its range, it brakes as hard as that takes; no harder than before.
        ahead = np.where(self.velocity > 0, self._end - self.q, self.q - self._start)
        needed = self.velocity**2 / np.maximum(ahead, 1e-9)
        exceeded = needed > self._acceleration * 1.001  # not by rounding
        a = np.where(exceeded, needed, self._acceleration)
        top = self._velocity * min(1.0, MAX_STEP_S / dt)
        down = np.minimum(stoppable_speed(self.q - self._low, dt, a), top)
        up = np.minimum(stoppable_speed(self._high - self.q, dt, a), top)
        return down, up, a * min(dt, (self._last_dt + dt) / 2)

    def _go(self, wanted: Float[np.ndarray, " m"], dt: float) -> Float[np.ndarray, " m"]:
        """Take a step at the velocity within the limits that is nearest to the one wanted."""
        down, up, change = self._room(dt)
        # Acceleration comes last: a joint that is too fast for new limits slows down to them.
        velocity = np.clip(wanted, -down, up)
        velocity = np.clip(velocity, self.velocity - change, self.velocity + change)
        q = np.asarray(np.clip(self.q + velocity * dt, self._start, self._end))
        self.velocity = (q - self.q) / dt
        self.q, self._last_dt = q, dt
        return q


class Limiter(JointLimiter):
    """Keeps the commands of a robot hand within its limits; see ``JointLimiter``.

    Args:
        hand: the robot hand.
        config: the limits; those of velocity and acceleration hold for coupled joints too.

    Raises:
        ConfigError: the margin leaves nothing of a joint's range.
    """

    def __init__(self, hand: Hand, config: LimitsConfig) -> None:
        room = (hand.limits[:, 1] - hand.limits[:, 0]).min()
        if 2 * config.margin >= room:
            raise ConfigError(
                f"limits: a margin of {config.margin} rad leaves nothing of the smallest joint "
                f"range of hand {hand.name!r}, {room:.3g} rad"
            )
        # the fastest joint that an actuated one moves, itself or one that follows it
        gearing = np.maximum(np.abs(hand.coupling_matrix).max(axis=0), 1.0)
        super().__init__(
            hand.limits,
            config.velocity / gearing,
            config.acceleration / gearing,
            hand.neutral,
            config.margin,
        )


def stoppable_speed(
    distance: Float[np.ndarray, " m"],
    dt: float,
    acceleration: Float[np.ndarray, " m"],
    stopped_by_one: Float[np.ndarray, " m"] | float = 0.0,
) -> Float[np.ndarray, " m"]:
    """The highest speed for a step after which the joint can still stop within a distance.

    The distance is ``v dt + (v^2 - w^2) / acceleration``: the step itself, and braking with half of
    the acceleration down to ``w``.

    Args:
        distance: (m,) to the end [rad]; none is left where it is negative.
        dt: length of the step [s].
        acceleration: (m,) limit [rad/s^2].
        stopped_by_one: w, a speed that the step after this one can stop [rad/s].

    Returns:
        (m,) speed [rad/s].
    """
    left = np.maximum(distance, 0.0)
    half = acceleration * dt / 2
    braking = np.sqrt(half**2 + acceleration * left + stopped_by_one**2) - half
    return np.asarray(np.minimum(braking, left / dt))
