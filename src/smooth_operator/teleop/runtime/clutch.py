"""Clutch of the wrist: while engaged, the robot's wrist follows the motion of the operator's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.teleop.runtime.limiter import PoseLimiter
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.tick import Mode, WristCommand
from smooth_operator.teleop.sources.live import Arrival

JUMP_M: Final = 0.08
JUMP_RAD: Final = 0.8
"""Change between two frames that, if faster than ``FASTEST``, is a jump of the tracker."""
FASTEST_MPS: Final = 4.0
FASTEST_RPS: Final = 25.0

NEAR_M: Final = 0.02
NEAR_RAD: Final = 0.1
"""Distance of the measured arm from its last command at which the clutch still engages."""
_APPROACH: Final = 0.2
"""Share of the velocity limits with which the command goes to an arm that is farther away."""
_AHEAD_S: Final = 0.05
"""Longest time for which the motion of the wrist is extrapolated between two frames [s]."""
_SHORTEST_GAP_S: Final = 1e-3
"""Shortest difference of two stamps that gives a velocity [s]."""
_SMOOTH: Final = 0.5
"""Share of the newest difference in the velocity of the wrist."""


@dataclass(frozen=True, eq=False)
class _Wrist:
    """A valid wrist: pose in the robot's axes, times and velocity."""

    pose: Float[np.ndarray, "7"]
    stamp: float
    received: float
    gap: float
    moving: Float[np.ndarray, "6"]
    session: int
    world: str | None


class Clutch:
    """Wrist command of one robot hand, from the wrists of frames and the loop's modes.

    While engaged, the target is ``home`` moved like the operator's wrist since then, both in axes
    that are fixed to the room (x forward, y left, z up): the translation times ``scale``, the
    rotation unchanged. The clutch engages when the operator moves the robot, the wrist is valid and
    the robot's wrist is at rest. It then latches both poses, so the command does not change. It
    disengages and holds on a pause, a stop, a loss of tracker or wrist, a jump of the wrist, a
    restart of the tracker, and when it is released. It has no clock of its own.

    Args:
        config: limits, scale, and the time for which a wrist is valid.

    Attributes:
        limiter: limiter with the last command.
        measured: returns the current pose of the hand's wrist in the base of the arm, or None if
            unknown. Called on the loop's thread, so it must be quick. The first command is this
            pose; before the clutch engages, the command approaches it slowly.
        released: True if the operator released the wrist while the fingers go on.
    """

    def __init__(self, config: LoopConfig) -> None:
        self.config = config
        self.limiter = PoseLimiter(config.wrist)
        self.measured: Callable[[], Float[np.ndarray, "7"] | None] = lambda: None
        self.released = False
        self._engaged = self._begun = False
        self._last: _Wrist | None = None
        self._anchor = self._home = poses.IDENTITY
        self._events: list[str] = []

    @property
    def engaged(self) -> bool:
        """True while the operator's wrist moves the robot's; safe from any thread."""
        return self._engaged

    def follow(self, on: bool) -> None:
        """Let the operator's wrist move the robot's, or hold the robot's wrist."""
        self.released = not on

    def events(self) -> list[str]:
        """Events since the last call, one sentence each."""
        events_now, self._events = self._events, []
        return events_now

    def step(
        self, mode: Mode, at: float, dt: float, arrival: Arrival | None
    ) -> WristCommand | None:
        """The next command.

        Args:
            at: time of the command [s].
            dt: time since the last one [s].
            arrival: the frame that the command answers, if any.

        Returns:
            the command; None until there is a wrist, or an arm that is measured.
        """
        if arrival is not None and poses.is_valid(arrival.frame.T_world_wrist):
            self._see(arrival)
        wrist, limiter = self._last, self.limiter
        if not self._begun:
            place = self._measured()
            if wrist is None and place is None:
                return None
            limiter.put(np.array(self.config.wrist.home) if place is None else place)
            self._begun = True
        valid = wrist is not None and at - wrist.received <= self.config.safety.stale_s
        if wrist is None or not valid or not mode.moves or self.released:
            self._let_go("" if valid else "no valid wrist")
            limiter.rest(dt)
        elif self._engaged:
            target, moving = self._target(wrist, at)
            limiter.step(target, dt, moving)
        elif (place := self._measured()) is not None and not _near(place, limiter.pose):
            limiter.step(place, dt, share=_APPROACH)
        else:
            stood = limiter.at_rest
            limiter.rest(dt)
            if stood:
                self._engaged, self._anchor, self._home = True, wrist.pose, limiter.pose
                self._events.append("wrist engaged")
        return WristCommand(limiter.pose, self._engaged, valid)

    def _see(self, arrival: Arrival) -> None:
        """Store a valid wrist; disengage if it does not continue the previous one."""
        frame, yaw, last = arrival.frame, self.config.wrist.yaw, self._last
        assert frame.T_world_wrist is not None
        turn = np.array([0, 0, 0, math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)])
        pose, moving, gap = poses.compose(turn, frame.T_world_wrist), np.zeros(6), 0.0
        if last is not None and (last.session, last.world) != (arrival.session, frame.world):
            self._let_go("the tracker was started again")
        elif last is not None:
            gap = max((arrival.stamp - last.stamp) / arrival.speed, 0.0)
            moved = np.concatenate([pose[:3] - last.pose[:3], _arc(last.pose, pose)])
            way, angle = math.hypot(*moved[:3]), math.hypot(*moved[3:])
            if way > max(JUMP_M, FASTEST_MPS * gap) or angle > max(JUMP_RAD, FASTEST_RPS * gap):
                self._let_go("the wrist jumped")
            elif _SHORTEST_GAP_S < gap <= self.config.safety.stale_s:
                moving = last.moving + _SMOOTH * (moved / gap - last.moving)
        self._last = _Wrist(
            pose, arrival.stamp, arrival.received, gap, moving, arrival.session, frame.world
        )

    def _target(
        self, arrival: _Wrist, at: float
    ) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "6"] | None]:
        """Target of the robot's wrist at a time, and its velocity."""
        scale, since = self.config.wrist.scale, max(at - arrival.received, 0.0)
        lead = min(arrival.gap, _AHEAD_S)
        ahead = arrival.moving * min(since, lead)
        moved = arrival.pose[:3] + ahead[:3] - self._anchor[:3]
        turned = poses.multiply(arrival.pose[3:], poses.conjugate(self._anchor[3:]))
        turned = poses.multiply(poses.from_rotation_vectors(ahead[3:]), turned)
        target = np.concatenate(
            [self._home[:3] + scale * moved, poses.multiply(turned, self._home[3:])]
        )
        if since > 1.5 * lead:  # the next frame is late: stop extrapolating
            return target, None
        return target, arrival.moving * np.array([scale, scale, scale, 1, 1, 1])

    def _measured(self) -> Float[np.ndarray, "7"] | None:
        place = self.measured()
        return place if poses.is_valid(place) else None

    def _let_go(self, why: str) -> None:
        if self._engaged:
            self._engaged = False
            self._events.append(f"wrist released: {why}" if why else "wrist released")


def _arc(a: Float[np.ndarray, "7"], b: Float[np.ndarray, "7"]) -> Float[np.ndarray, "3"]:
    """Rotation vector from one orientation to another, in the frame of both [rad]."""
    return poses.rotation_vectors(poses.multiply(b[3:], poses.conjugate(a[3:])))


def _near(a: Float[np.ndarray, "7"], b: Float[np.ndarray, "7"]) -> bool:
    return math.dist(a[:3], b[:3]) <= NEAR_M and math.hypot(*_arc(a, b)) <= NEAR_RAD
