"""Limits commands (position, velocity, acceleration, rate); also the wrist clutch."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.runtime.settings import LimitsConfig, LoopConfig, WristConfig
from smooth_operator.teleop.sinks.tick import Mode, WristCommand
from smooth_operator.teleop.sources.live import Arrival

_SAMPLES: Final = 201  # positions of a leader at which the slope of a polynomial is measured

MAX_STEP_S: Final = 0.1
"""Upper bound on the time step used between two commands [s], so that the robot does not make a
large move after a pause."""

SHORTEST_S: Final = 1e-9
"""Smallest divisor for time steps [s]; the clock does not resolve shorter ones."""

USUAL_S: Final = 0.005
"""Time step that is assumed when stopping at a target [s]; few steps are shorter. The limits do not
depend on it."""


class JointLimiter:
    """Moves towards a target within the limits of the joints, and holds the last command.

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
    previous step was. Therefore the square of the velocity is kept below the acceleration limit
    times the remaining distance, and braking at that rate keeps it there in short and long steps.

    A target, unlike a limit, may be overshot. A speed that can be stopped in one step of 5 ms is
    allowed up to the target itself, so that a target that moves well within the limits is followed
    exactly, without lag. Above that speed the joint brakes ahead of the target.

    Args:
        ends: (m, 2) limits of the positions [rad].
        velocity: (m,) limits of the velocities [rad/s].
        acceleration: (m,) limits of the accelerations [rad/s^2].
        start: (m,) initial positions [rad].
        margin: distance to keep from each end of a range [rad].

    Attributes:
        q: (m,) last command [rad].
        velocity: (m,) velocity of the last command, relative to the one before [rad/s].
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
        self.put(np.clip(start, self._low, self._high))

    def put(self, positions: Float[np.ndarray, " m"]) -> None:
        """Sets the positions [rad], at rest, before the first command and after a pause."""
        self.q: Float[np.ndarray, " m"] = np.clip(positions, self._start, self._end)
        self.velocity: Float[np.ndarray, " m"] = np.zeros_like(self.q)
        self._last_dt = math.inf

    def step(
        self,
        target: Float[np.ndarray, " m"],
        dt: float,
        max_velocity: float | None = None,
    ) -> Float[np.ndarray, " m"]:
        """Computes the next command.

        Args:
            target: (m,) target [rad]; a joint whose target is not finite stays where it is.
            dt: time since the last command [s].
            max_velocity: an additional velocity limit for this step [rad/s].

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
        """Brakes as hard as the limits allow, then stays at rest.

        Args:
            dt: time since the last command [s].

        Returns:
            (m,) command [rad].
        """
        return self._go(np.zeros_like(self.q), max(dt, SHORTEST_S))

    def bounds(self, dt: float) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Lowest and highest velocity of each joint that ``follow`` allows in a step [rad/s].

        Args:
            dt: time since the last command [s].
        """
        down, up, change = self._room(max(dt, SHORTEST_S))
        slow, fast = self.velocity - change, self.velocity + change
        return np.clip(-down, slow, fast), np.clip(up, slow, fast)

    def follow(self, velocity: Float[np.ndarray, " m"], dt: float) -> Float[np.ndarray, " m"]:
        """Takes a step at the allowed velocity that is closest to the requested one.

        Args:
            velocity: (m,) requested velocity [rad/s]; values that are not finite count as 0.
            dt: time since the last command [s].

        Returns:
            (m,) command [rad].
        """
        return self._go(np.where(np.isfinite(velocity), velocity, 0.0), max(dt, SHORTEST_S))

    def _room(
        self, dt: float
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Largest speed in each direction, and largest change of velocity, in a step."""
        a = self._acceleration
        top = self._velocity * min(1.0, MAX_STEP_S / dt)
        down = np.minimum(stoppable_speed(self.q - self._low, dt, a), top)
        up = np.minimum(stoppable_speed(self._high - self.q, dt, a), top)
        return down, up, a * min(dt, (self._last_dt + dt) / 2)

    def _go(self, target: Float[np.ndarray, " m"], dt: float) -> Float[np.ndarray, " m"]:
        """Take a step at the velocity within the limits that is closest to the requested one."""
        down, up, change = self._room(dt)
        # Acceleration comes last: a joint that is too fast for `max_velocity` slows down to it.
        velocity = np.clip(target, -down, up)
        velocity = np.clip(velocity, self.velocity - change, self.velocity + change)
        q = np.asarray(np.clip(self.q + velocity * dt, self._start, self._end))
        self.velocity = (q - self.q) / dt
        self.q, self._last_dt = q, dt
        return q


class Limiter(JointLimiter):
    """Keeps the commands of a robot hand within its limits; see ``JointLimiter``.

    Args:
        hand: the robot hand.
        config: the limits. Velocity and acceleration limits also apply to coupled joints.

    Raises:
        ConfigError: the margin leaves no range for a joint.
    """

    def __init__(self, hand: Hand, config: LimitsConfig) -> None:
        room = (hand.limits[:, 1] - hand.limits[:, 0]).min()
        if 2 * config.margin >= room:
            raise ConfigError(
                f"limits: a margin of {config.margin} rad is too large for hand {hand.name!r}, "
                f"whose smallest joint range is {room:.3g} rad"
            )
        # of the fastest joint that an actuated one moves, itself or one that follows it
        slopes, curvature = _steepest(hand)
        gearing = np.maximum(slopes, 1.0)
        # a polynomial adds p'' v^2 to its follower's acceleration: at most half of the limit
        velocity = np.full(len(gearing), config.velocity) / gearing
        wrist = [hand.joint_names[i] in hand.spec.wrist_joints for i in hand.actuated]
        velocity[wrist] = np.minimum(velocity[wrist], config.wrist_velocity)
        bent = curvature > 0
        top = np.sqrt(config.acceleration / (2 * curvature[bent]))
        velocity[bent] = np.minimum(velocity[bent], top)
        super().__init__(
            hand.limits,
            velocity,
            (config.acceleration - curvature * velocity**2) / gearing,
            hand.neutral,
            config.margin,
        )


def _steepest(hand: Hand) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Largest |dq_i/dq_k| and |d2q_i/dq_k^2| of any joint i over the range of actuated joint k."""
    transmission = hand.transmission
    first, second = np.abs(transmission.matrix), np.zeros_like(transmission.matrix)
    for i in transmission.curves:
        (k,) = np.flatnonzero(transmission.matrix[i])
        linear = np.zeros((_SAMPLES, len(first)))
        linear[:, i] = np.linspace(hand.limits[k, 0], hand.limits[k, 1], _SAMPLES)
        first[i, k], second[i, k] = (
            np.abs(transmission.curved(linear, order)[:, i]).max() for order in (1, 2)
        )
    return first.max(axis=0), second.max(axis=0)


def stoppable_speed(
    distance: Float[np.ndarray, " m"],
    dt: float,
    acceleration: Float[np.ndarray, " m"],
    stopped_by_one: Float[np.ndarray, " m"] | float = 0.0,
) -> Float[np.ndarray, " m"]:
    """Highest speed of a step from which the joint can still stop within a distance.

    The distance is ``v dt + (v^2 - w^2) / acceleration``: the step itself, and braking with half of
    the acceleration down to ``w``.

    Args:
        distance: (m,) distance to the end [rad]; a negative one counts as 0.
        dt: length of the step [s].
        acceleration: (m,) limit [rad/s^2].
        stopped_by_one: w, the speed that the next step can stop completely [rad/s].

    Returns:
        (m,) speed [rad/s].
    """
    left = np.maximum(distance, 0.0)
    half = acceleration * dt / 2
    braking = np.sqrt(half**2 + acceleration * left + stopped_by_one**2) - half
    return np.asarray(np.minimum(braking, left / dt))


_STILL: Final = np.zeros(3)
_AXIS_SHARE: Final = 1 / math.sqrt(3.0)
"""Share of the acceleration for each axis, so that all three can brake at the same time."""


class PoseLimiter:
    """Moves a pose towards a target within limits, and holds the last command.

    The limits hold between the stamps of consecutive poses, however uneven these are. The
    velocities ``v[k] = (p[k] - p[k-1]) / dt[k]`` and ``w[k]`` (the rotation vector between two
    consecutive orientations, divided by ``dt[k]``) are at most as long as the velocity limits.
    Their changes, divided by the shorter of ``dt[k]`` and ``(dt[k-1] + dt[k]) / 2``, are at most as
    long as the acceleration limits. The position stays within the workspace; a position that starts
    outside may only move closer. The wrist is always slow enough to stop before the end of its
    workspace, whatever steps follow.

    Args:
        config: the limits.

    Attributes:
        pose: (7,) last command.
        velocity: (3,) velocity of the last command, relative to the one before [m/s].
        turn: (3,) angular velocity of the last command in the base frame [rad/s].
    """

    def __init__(self, config: WristConfig) -> None:
        self.config = config
        self.put(np.array(config.home))

    @property
    def at_rest(self) -> bool:
        """True if the pose is at rest."""
        return not (self.velocity.any() or self.turn.any())

    def put(self, pose: Float[np.ndarray, "7"]) -> None:
        """Sets the pose, at rest, before the first command."""
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
        """Computes the next command.

        Args:
            target: pose to reach at the end of the step.
            dt: time since the last command [s].
            moving: velocity [m/s] and angular velocity [rad/s] of the target; None if it is at
                rest. A moving target is followed without lag if the limits allow.

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
        """Brakes as hard as the limits allow, then stays at rest.

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
        target: Float[np.ndarray, "3"],
        turn: Float[np.ndarray, "3"],
        dt: float,
        share: float,
    ) -> Float[np.ndarray, "7"]:
        """Take a step with the allowed velocities that are closest to the requested ones."""
        config, place = self.config, self.pose[:3]
        low, high = np.minimum(config.low, place), np.maximum(config.high, place)
        shorter = min(dt, (self._last_dt + dt) / 2)
        brief = min(1.0, MAX_STEP_S / dt)  # after a pause the robot does not catch up

        each = np.full(3, config.acceleration * _AXIS_SHARE)
        velocity = _nearest(
            self.velocity,
            target,
            config.velocity * share * brief,
            config.acceleration * shorter,
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
    """Velocity that follows a moving target and closes the remaining distance ``way`` to it."""
    behind = way - going * dt
    left = float(np.sqrt(behind @ behind))
    if left < 1e-12:
        return going
    speed = stoppable_speed(np.array(left), dt, np.array(acceleration), acceleration * USUAL_S)
    return going + behind * (float(speed) / left)


def _nearest(
    before: Float[np.ndarray, "3"],
    target: Float[np.ndarray, "3"],
    top: float,
    change: float,
    down: Float[np.ndarray, "3"] | float = math.inf,
    up: Float[np.ndarray, "3"] | float = math.inf,
) -> Float[np.ndarray, "3"]:
    """Allowed velocity that is closest to the requested one.

    ``top`` limits the speed, ``change`` its change, ``down`` and ``up`` the speed along each axis.
    The velocities that the workspace and the speed limit allow are convex sets, so the segment
    between two allowed velocities is allowed. The path leads from the last velocity, braked as far
    as the workspace requires, to its projection within the speed limit, and on to the requested
    velocity. It ends where the acceleration limit is reached.
    """
    braked = np.clip(before, -down, up)
    slow = _cut(braked, top)
    if math.dist(slow, before) >= change:
        return _reach(before, braked, slow, change)
    return _reach(before, slow, _cut(np.clip(target, -down, up), top), change)


def _reach(
    before: Float[np.ndarray, "3"],
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
    change: float,
) -> Float[np.ndarray, "3"]:
    """Last point of the segment from ``start`` to ``end`` within ``change`` of ``before``."""
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
    """Shortens a vector to a maximum length."""
    size = math.sqrt(vector @ vector)
    return vector * (length / size) if size > length else vector


SHORTEST: Final = 0.25
"""Shortest time between two commands, in periods."""
BORROWED: Final = 1.0 - SHORTEST
"""Time by which the command for a frame may be sent before its turn, in periods. Later commands
are delayed accordingly. Frames that arrive between two turns then do not wait."""
KEPT: Final = 0.5
"""Delay of a late command that may be made up for, in periods, so that a late frame does not delay
the following frames."""
WAITS: Final = 0.1
"""Longest time that a frame waits for its turn, in periods. A frame that would wait longer is
replaced by the next one, if no turn is lost. A tracker at the same rate that has lost its phase,
for example after a stall, thus regains it at the cost of one frame, instead of keeping the wait for
the rest of the run.
"""
LONGEST: Final = 2.0
"""Longest time between two commands, in periods."""
EXTRA: Final = 1 + BORROWED + KEPT
"""Number of extra commands: within any time t there are at most rate x t + 2.25."""


class RateLimiter:
    """Decides when commands of one hand may be sent, so that the rate is limited.

    Commands have turns that are one period apart. The command for a frame may be sent before its
    turn, and any command may be sent late, within bounds that don't accumulate: in any time t there
    are at most ``t / period + EXTRA`` commands, two commands are at least ``SHORTEST`` periods
    apart, and over a run the rate is never exceeded. This is the generic cell rate algorithm (ITU-T
    I.371), except that only commands that answer a frame may be early.

    All times are from one clock [s]. This class neither reads a clock nor sleeps.

    Args:
        period: time between two commands [s]; may be changed at any time.
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self._last = -math.inf  # time of the last command
        self._turn = -math.inf  # time of the next command at an even pace

    def begin(self, now: float) -> None:
        """Starts the schedule: a command may be sent now."""
        self._turn = now + BORROWED * self.period

    @property
    def opens(self) -> float:
        """Earliest time at which a command other than an emergency stop may be sent [s]."""
        period = self.period
        return max(self._turn - BORROWED * period, self._last + SHORTEST * period)

    def answers(self, received: float, following: float | None) -> float:
        """Time at which to send the command for a frame, if no newer frame arrives before [s].

        The command for a frame that arrives after its turn has begun is sent at once. A frame that
        arrived before its turn by more than ``WAITS`` is replaced by the next frame, if that
        arrives early enough that no turn is lost. With a tracker that is faster than the loop,
        commands are therefore made from fresh frames.

        Args:
            received: time of arrival [s].
            following: expected arrival of the next frame [s]; None if unknown.
        """
        opens, latest = self.opens, self._last + LONGEST * self.period
        if received >= opens:
            return received
        waits = opens - received > WAITS * self.period
        if (
            following is None
            or not 0 <= following - opens <= (1.0 if waits else KEPT) * self.period
        ):
            return opens
        patience = SHORTEST * (following - received)  # trackers are uneven
        return min(following + patience, latest) if following <= latest else opens

    def keeps(self, following: float | None) -> float:
        """Time at which a command is due if no frame arrives [s].

        Args:
            following: expected arrival of the next frame [s]; None if unknown. The command waits
                briefly for a frame that is expected about now.
        """
        period, at = self.period, self._turn
        if following is not None and at - SHORTEST * period <= following <= at + KEPT * period:
            latest = max(at, self._last + LONGEST * period)
            at = min(following + SHORTEST * period, latest)
        return max(at, self.opens)

    def take(self, now: float) -> None:
        """Registers that a command was sent at a time [s]."""
        period = self.period
        turn = max(self._turn, now - KEPT * period) + period
        # An emergency stop, which waits for no turn, delays what comes after it only so far.
        self._turn, self._last = min(turn, now + LONGEST * period), now


JUMP_M: Final = 0.08
JUMP_RAD: Final = 0.8
"""Motion between two frames that counts as a tracker jump if it is also faster than the ``FASTEST``
values."""
FASTEST_MPS: Final = 4.0
FASTEST_RPS: Final = 25.0

NEAR_M: Final = 0.02
NEAR_RAD: Final = 0.1
"""Largest distance of the measured arm from its last command at which the clutch can engage."""
_APPROACH: Final = 0.2
"""Fraction of the velocity limits used to approach an arm that is farther away than that."""
_AHEAD_S: Final = 0.05
"""Longest time for which the motion of the wrist is extrapolated between two frames [s]."""
_SHORTEST_GAP_S: Final = 1e-3
"""Smallest difference of two timestamps from which a velocity is computed [s]."""
_SMOOTH: Final = 0.5
"""Weight of the newest difference in the velocity of the wrist."""


@dataclass(frozen=True, eq=False)
class _Wrist:
    """A valid wrist measurement: pose in the robot's axes, times and velocity."""

    pose: Float[np.ndarray, "7"]
    stamp: float
    received: float
    gap: float
    moving: Float[np.ndarray, "6"]
    session: int
    world: str | None


class Clutch:
    """Wrist clutch: computes the robot's wrist command from the operator's wrist, for one hand.

    The clutch engages when the operator moves the robot, the wrist is valid and the robot's wrist
    is at rest. It then latches the poses of both wrists, so the command does not jump. While it is
    engaged, the robot's wrist moves from its latched pose as the operator's wrist does from theirs,
    in axes that are fixed to the room (x forward, y left, z up): the translation is multiplied by
    ``scale``, and the rotation is copied. The clutch disengages, and the wrist holds, on a pause, a
    stop, a loss of the tracker or the wrist, a jump of the wrist, a restart of the tracker, and
    when the operator releases it. It has no clock of its own.

    Args:
        config: limits, scale, and the time for which a wrist is valid.

    Attributes:
        limiter: limiter with the last command.
        measured: returns the current pose of the hand's wrist in the base of the arm, or None if
            unknown. Called on the loop's thread, so it must be quick. The first command is this
            pose; before the clutch engages, the command approaches it slowly.
        released: True if the operator released the wrist while the fingers continue to follow.
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
        """Lets the operator's wrist move the robot's (True), or holds the robot's wrist (False)."""
        self.released = not on

    def events(self) -> list[str]:
        """Events since the last call, one sentence each."""
        events_now, self._events = self._events, []
        return events_now

    def step(
        self, mode: Mode, at: float, dt: float, arrival: Arrival | None
    ) -> WristCommand | None:
        """Computes the next command.

        Args:
            at: time of the command [s].
            dt: time since the last one [s].
            arrival: the frame from which the command is made, if any.

        Returns:
            the command; None until a wrist or an arm pose has been measured.
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
        """Store a valid wrist; disengage if it jumped or the tracker was restarted."""
        frame, yaw, last = arrival.frame, self.config.wrist.yaw, self._last
        assert frame.T_world_wrist is not None
        turn = np.array([0, 0, 0, math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)])
        pose, moving, gap = poses.compose(turn, frame.T_world_wrist), np.zeros(6), 0.0
        if last is not None and (last.session, last.world) != (arrival.session, frame.world):
            self._let_go("the tracker was restarted")
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
    """Rotation vector from one orientation to another, in their common frame [rad]."""
    return poses.rotation_vectors(poses.multiply(b[3:], poses.conjugate(a[3:])))


def _near(a: Float[np.ndarray, "7"], b: Float[np.ndarray, "7"]) -> bool:
    return math.dist(a[:3], b[:3]) <= NEAR_M and math.hypot(*_arc(a, b)) <= NEAR_RAD
