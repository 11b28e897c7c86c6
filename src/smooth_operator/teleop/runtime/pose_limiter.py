"""Limiter of a pose: speed, acceleration and workspace of the wrist of a robot hand."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.teleop.runtime.limiter import (
    MAX_STEP_S,
    SHORTEST_S,
    USUAL_S,
    stoppable_speed,
)
from smooth_operator.teleop.runtime.settings import WristConfig

_STILL: Final = np.zeros(3)
_AXIS_SHARE: Final = 1 / math.sqrt(3.0)
"""Share of the acceleration that each axis may count on when all three brake together."""


class PoseLimiter:
    """Follows a pose within limits; holds what was last commanded.

    The limits hold between the stamps of consecutive poses, however uneven these are. Velocities
    ``v[k] = (p[k] - p[k-1]) / dt[k]`` and ``w[k]``, the rotation vector from the one orientation to
    the other over ``dt[k]``, have the lengths of the velocity limits at most, and so have their
    changes over the shorter of ``dt[k]`` and ``(dt[k-1] + dt[k]) / 2`` those of the acceleration
    limits. The position stays within the workspace; one that starts outside may only come closer.
    The wrist is always slow enough to stop before the end of its workspace, whatever steps follow.

    Args:
        config: the limits.

    Attributes:
        pose: (7,) last command.
        velocity: (3,) its velocity, from the command before [m/s].
        turn: (3,) its angular velocity in the frame of the base [rad/s].
    """

    def __init__(self, config: WristConfig) -> None:
        self.config = config
        self.put(np.array(config.home))

    @property
    def at_rest(self) -> bool:
        """Whether it stands."""
        return not (self.velocity.any() or self.turn.any())

    def put(self, pose: Float[np.ndarray, "7"]) -> None:
        """Begin here, at rest: for the first command, which has none before it."""
        self.pose = np.asarray(pose, np.float64)
        self.velocity = self.turn = _STILL
        self._last_dt = math.inf

    def step(
        self,
        target: Float[np.ndarray, "7"],
        dt: float,
        moving: Float[np.ndarray, "6"] | None = None,
        share: float = 1.0,
    ) -> Float[np.ndarray, "7"]:
        """The next command.

        Args:
            target: where to be after the step.
            dt: time since the last command [s].
            moving: velocity [m/s] and angular velocity [rad/s] of the target; None if it stands. It
                is followed without lag where the limits allow.
            share: of the velocity limits.

        Returns:
            (7,) command.
        """
        dt, config = max(dt, SHORTEST_S), self.config
        going, turning = (_STILL, _STILL) if moving is None else (moving[:3], moving[3:])
        way = target[:3] - self.pose[:3]
        arc = poses.rotation_vectors(poses.multiply(target[3:], poses.conjugate(self.pose[3:])))
        return self._go(
            _towards(way, going, dt, config.acceleration),
            _towards(arc, turning, dt, config.turn_acceleration),
            dt,
            share,
        )

    def rest(self, dt: float) -> Float[np.ndarray, "7"]:
        """Brake as hard as the limits let it, and then stand.

        Args:
            dt: time since the last command [s].

        Returns:
            (7,) command.
        """
        if self.at_rest:
            self._last_dt = max(dt, SHORTEST_S)
            return self.pose
        return self._go(_STILL, _STILL, max(dt, SHORTEST_S), 1.0)

    def _go(
        self,
        wanted: Float[np.ndarray, "3"],
        turn: Float[np.ndarray, "3"],
        dt: float,
        share: float,
    ) -> Float[np.ndarray, "7"]:
        """Take a step with the velocities within the limits that are nearest to those wanted."""
        config, place = self.config, self.pose[:3]
        low, high = np.minimum(config.low, place), np.maximum(config.high, place)
        shorter = min(dt, (self._last_dt + dt) / 2)
        brief = min(1.0, MAX_STEP_S / dt)  # after a pause the robot does not catch up

        # Limits may have become stricter in mid-motion: then it brakes as hard as the workspace
        # takes, no harder than before.
        ahead = np.where(self.velocity > 0, high - place, place - low)
        usual = config.acceleration * _AXIS_SHARE
        needed = self.velocity**2 / np.maximum(ahead, 1e-9)
        each = np.where(needed > usual * 1.001, needed, usual)
        velocity = _nearest(
            self.velocity,
            wanted,
            config.velocity * share * brief,
            max(config.acceleration, math.sqrt(each @ each)) * shorter,
            stoppable_speed(place - low, dt, each),
            stoppable_speed(high - place, dt, each),
        )
        self.turn = _nearest(
            self.turn,
            turn,
            config.turn_velocity * share * brief,
            config.turn_acceleration * shorter,
        )
        moved = np.clip(place + velocity * dt, low, high)
        self.velocity = (moved - place) / dt
        turned = poses.multiply(poses.from_rotation_vectors(self.turn * dt), self.pose[3:])
        self.pose = np.concatenate([moved, turned / np.sqrt(turned @ turned)])
        self._last_dt = dt
        return self.pose


def _towards(
    way: Float[np.ndarray, "3"], going: Float[np.ndarray, "3"], dt: float, acceleration: float
) -> Float[np.ndarray, "3"]:
    """Velocity that goes with a target, and makes up for what is left of the way to it.

    Args:
        way: to where the target is after the step.
        going: velocity of the target.
        dt: length of the step [s].
        acceleration: limit.
    """
    behind = way - going * dt
    left = float(np.sqrt(behind @ behind))
    if left < 1e-12:
        return going
    speed = stoppable_speed(np.array(left), dt, np.array(acceleration), acceleration * USUAL_S)
    return going + behind * (float(speed) / left)


def _nearest(
    before: Float[np.ndarray, "3"],
    wanted: Float[np.ndarray, "3"],
    top: float,
    change: float,
    down: Float[np.ndarray, "3"] | float = math.inf,
    up: Float[np.ndarray, "3"] | float = math.inf,
) -> Float[np.ndarray, "3"]:
    """The velocity next to the one wanted that the limits allow.

    What the workspace and the speed allow are convex sets, so the way between two velocities in
    them is within them. It leads from the last velocity, braked as far as the workspace asks for,
    to the same within the speed limit, and on to the one wanted; as far as the acceleration goes.

    Args:
        before: the last velocity.
        wanted: the one that is asked for.
        top: largest speed; it may have become lower.
        change: largest length of the change.
        down: largest speed against each axis.
        up: largest speed along each axis.
    """
    braked = np.clip(before, -down, up)
    slow = _cut(braked, top)
    if math.dist(slow, before) >= change:
        return _reach(before, braked, slow, change)
    return _reach(before, slow, _cut(np.clip(wanted, -down, up), top), change)


def _reach(
    before: Float[np.ndarray, "3"],
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
    change: float,
) -> Float[np.ndarray, "3"]:
    """The farthest point on the way from ``start`` to ``end`` that is a change away at most."""
    must, way = start - before, end - start
    left, length = change * change - float(must @ must), float(way @ way)
    if left <= 0:
        return np.asarray(before + _cut(must, change))
    if length < 1e-24:
        return end
    along = float(must @ way)
    share = (math.sqrt(along * along + length * left) - along) / length
    return end if share >= 1 else np.asarray(start + share * way)


def _cut(vector: Float[np.ndarray, "3"], length: float) -> Float[np.ndarray, "3"]:
    """A vector, shortened to a length."""
    size = math.sqrt(vector @ vector)
    return vector * (length / size) if size > length else vector
