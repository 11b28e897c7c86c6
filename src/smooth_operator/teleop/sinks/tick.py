"""A tick of the loop: a command, and the data that led to it."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.types import HandFrame, JointCommand, Side, Status


@dataclass(frozen=True)
class Driver:
    """The method that drives a hand, and its settings.

    Attributes:
        method: name of the method.
        preset: name of its preset.
        config: its configuration, with all changes and the operator.
    """

    method: str
    preset: str
    config: Any


class Mode(enum.Enum):
    """What the loop currently does with a hand."""

    WAITING = "waiting"
    """No frame has come yet: the robot stays where it starts."""
    TRACKING = "tracking"
    """The robot follows the operator."""
    BLENDING = "blending"
    """The operator returns or takes over: the robot moves to them smoothly."""
    HOLDING = "holding"
    """The tracker is late, or its frames are unusable: the robot holds the last command."""
    EASING = "easing"
    """The tracker is lost: the robot goes to its safe pose, and stays there."""
    PAUSED = "paused"
    """The operator released the clutch: the robot holds the last command."""
    STOPPED = "stopped"
    """Emergency stop: the robot brakes and stays stopped until the operator releases it."""

    @property
    def moves(self) -> bool:
        """True if the operator moves the robot."""
        return self in (Mode.TRACKING, Mode.BLENDING)


@dataclass(frozen=True, eq=False)
class WristCommand:
    """Target pose of a robot hand's wrist, after the clutch.

    Attributes:
        pose: (7,) pose of the robot hand's wrist frame in ``world``: x y z [m], unit quaternion
            w x y z; within all limits, and held while not engaged.
        engaged: True while the operator's wrist moves the robot's.
        valid: True if the frame of this command had a valid wrist.
        world: name of the frame of ``pose``, the base of the robot.
    """

    pose: Float[np.ndarray, "7"]
    engaged: bool
    valid: bool
    world: str = "base"


@dataclass(frozen=True, eq=False)
class ArmCommand:
    """A command to the arm that carries a hand.

    Attributes:
        name: name of the arm.
        joint_names: (n,) names of the joints, from the base.
        positions: (n,) positions within all limits [rad].
        velocity: (n,) velocities since the previous command [rad/s].
        pose: (7,) pose of the hand's wrist at these positions, in the arm's base frame: x y z [m]
            and a unit quaternion w x y z.
        position_error: distance from ``pose`` to the target pose [m]; NaN without a target.
        rotation_error: angle from ``pose`` to the target pose [rad]; NaN without a target.
        clearance: smallest distance between parts, or to table and wall, except between fingers and
            table [m].
        state: ``following``, ``holding``, ``braking`` (no motion keeps all distances) or
            ``stopped``.
        measured: (n,) positions of the joints at the last measurement by a sink [rad]; None without
            a measurement.
    """

    name: str
    joint_names: tuple[str, ...]
    positions: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "7"]
    position_error: float = float("nan")
    rotation_error: float = float("nan")
    clearance: float = float("inf")
    state: str = "following"
    measured: Float[np.ndarray, " n"] | None = None


@dataclass(frozen=True, eq=False)
class Tick:
    """One command to one robot hand, with the data that led to it.

    Attributes:
        side: side of the hand.
        hand: name of the robot hand.
        command: joint positions within all limits. Its stamp is that of the frame that it was
            computed from, by the tracker's clock, or, without a frame, the time of the tick.
        velocity: (n,) velocity of all joints [rad/s], for feedforward in drivers.
        mode: mode of the loop.
        time: time of the command, by the loop's clock [s]. The limits apply between these times.
        number: number of the tick, counted from 0 for each hand.
        status: status of the frame that the command was computed from; None without a frame.
        arrival: the frame that the command was computed from.
        stages: name of a stage -> its duration [ms], in order; empty without a frame.
        tracking_loss: loss of the method for the frame; NaN without a frame.
        scale: ratio of robot size to human size in the frame; NaN without a frame.
        events: events of this tick, one sentence each, such as a change of mode or refused frames.
        driver: method that drives the hand, if known; the same object until it changes.
        state: last measured state of the hand, if a sink measures it; the same object until there
            is a newer one.
        wrist: target of the hand's wrist, with the same stamp; None if the loop moves fingers only.
        arm: the command to the arm that carries the hand, with the same stamp; None without an
            arm.
    """

    side: Side
    hand: str
    command: JointCommand
    velocity: Float[np.ndarray, " n"]
    mode: Mode
    time: float
    number: int
    status: Status | None = None
    arrival: Arrival | None = None
    stages: Mapping[str, float] = field(default_factory=dict)
    tracking_loss: float = float("nan")
    scale: float = float("nan")
    events: tuple[str, ...] = ()
    driver: Driver | None = None
    wrist: WristCommand | None = None
    state: HandState | None = None
    arm: ArmCommand | None = None


@dataclass(frozen=True, eq=False)
class Contact:
    """Contact of a robot hand's fingers, measured or simulated.

    Attributes:
        levels: (f,) contact of each finger of the hand, thumb first: 0 for none, 1 for full contact
            by the scale of the hand's driver; NaN if unknown.
        newtons: (f,) force on each finger [N]; NaN if unknown.
    """

    levels: Float[np.ndarray, " f"]
    newtons: Float[np.ndarray, " f"]


@dataclass(frozen=True, eq=False)
class HandState:
    """Measured state of a robot hand, real or simulated.

    Attributes:
        side: side of the hand.
        hand: name of the robot hand.
        stamp: time of the measurement, by the loop's clock [s].
        names: (n,) joint names, in the model's own order, coupled ones included.
        positions: (n,) measured joint positions [rad]; NaN for a joint without a measurement.
        velocities: (n,) measured joint velocities [rad/s], or None.
        actuators: (a,) names of the actuators; empty if they have no names.
        currents: (a,) current or force of the actuators, in the driver's unit; NaN if unknown; None
            if the hand measures neither.
        temperatures: (a,) temperatures of the actuators [degrees Celsius], or None.
        touch: (k,) touch or force sensors, in the driver's unit and order, or None.
        contact: contact of the fingers, or None.
    """

    side: Side
    hand: str
    stamp: float
    names: tuple[str, ...]
    positions: Float[np.ndarray, " n"]
    velocities: Float[np.ndarray, " n"] | None = None
    actuators: tuple[str, ...] = ()
    currents: Float[np.ndarray, " a"] | None = None
    temperatures: Float[np.ndarray, " a"] | None = None
    touch: Float[np.ndarray, " k"] | None = None
    contact: Contact | None = None

    @property
    def time(self) -> float:
        """The timestamp, under the name that simulations use."""
        return self.stamp


_STEP: Final = 2e-6
"""Smallest difference of consecutive stamps [s]."""

_FORGET: Final = 0.9995
"""Factor by which the stored largest delay decays from one frame to the next."""


class StampMap:
    """Computes strictly increasing timestamps on the loop's clock, for the log of one hand.

    Frames have stamps of the tracker's clock, which restarts with every start of the tracker.
    Commands without a frame have the loop's time. After each start, all stamps are shifted by one
    constant, the first frame's time of reception minus its stamp, so that their differences are
    those of the tracker. A jump of the stamps (``JUMP_S``) counts as a start, so that one bad stamp
    does not shift the others. Commands without a frame are stamped earlier by the delay of the last
    frames, so that their stamps are not later than that of the next frame.
    """

    def __init__(self) -> None:
        self._session: int | None = None
        self._shift = self._late = 0.0
        self._last = -math.inf

    def __call__(self, tick: Tick) -> tuple[float, HandFrame | None]:
        """Stamp of a tick's command, and the frame with the same stamp."""
        arrival = tick.arrival
        stamp = math.nan if arrival is None else arrival.stamp
        if arrival is None or not math.isfinite(stamp):
            return self._next(tick.time - self._late), None
        if arrival.session != self._session:
            self._session = arrival.session
            self._shift, self._late = arrival.received - stamp, 0.0
        stamp += self._shift
        self._late = max(arrival.received - stamp, _FORGET * self._late)
        return self._next(stamp), arrival.frame

    def _next(self, stamp: float) -> float:
        self._last = max(stamp, self._last + _STEP)
        return self._last
