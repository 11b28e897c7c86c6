"""The sink ``ros2``, which publishes commands as ROS 2 messages, whose quaternions have w last."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError, UnknownNameError
from smooth_operator.hands.hand import Hand
from smooth_operator.settings import check_range
from smooth_operator.teleop.sinks.sink import Link, ThreadedSink
from smooth_operator.teleop.sinks.tick import HandState, Tick
from smooth_operator.types import Side
from smooth_operator_devices.hands.actuator_map import BoundMap, find_table, read_table
from smooth_operator_devices.ros2.messages import (
    Duration,
    Float64MultiArray,
    Header,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    Message,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    String,
    nanoseconds_of,
    time_of,
)
from smooth_operator_devices.ros2.transport import Endpoint, Network, Transport, topic_name

Kind: TypeAlias = Literal["joint_state", "trajectory", "array"]
"""Type of the message: ``sensor_msgs/JointState``, ``trajectory_msgs/JointTrajectory`` or
``std_msgs/Float64MultiArray``."""

KINDS: Final[dict[Kind, type[Message]]] = {
    "joint_state": JointState,
    "trajectory": JointTrajectory,
    "array": Float64MultiArray,
}


def joint_message(
    kind: Kind,
    stamp: Message,
    names: Sequence[str],
    positions: list[float],
    velocities: list[float],
    duration: float,
) -> Message:
    """Makes the message for a command to joints.

    Args:
        positions: (k,) positions in the driver's unit.
        velocities: (k,) velocities of a joint state; may be empty.
        duration: time from the start to the point of a trajectory [s].

    Raises:
        SinkError: a position is not finite.
    """
    if not all(map(math.isfinite, positions)):
        raise SinkError(f"ros2: a command that is not finite is not sent: {positions}")
    if kind == "array":
        return Float64MultiArray(data=positions)
    if kind == "trajectory":
        # Without a stamp it begins on arrival, by the controller's clock. Some controllers refuse a
        # last point with a velocity.
        time = time_of(round(duration * 1e9))
        point = JointTrajectoryPoint(positions, time_from_start=Duration(time.sec, time.nanosec))
        return JointTrajectory(Header(), list(names), [point])
    return JointState(Header(stamp), list(names), positions, velocities)


@dataclass(frozen=True)
class Layout:
    """Names, order and unit of the joints in a driver.

    Attributes:
        names: (k,) names of the joints or actuators, in the order of the driver.
        values: (n,) positions of the hand's joints [rad] -> k commands.
        rates: (n,) velocities of the hand's joints [rad/s] -> k velocities. Empty for drivers with
            their own unit, which use ``velocity`` for another quantity.
    """

    names: tuple[str, ...]
    values: Callable[[Float[np.ndarray, " n"]], list[float]]
    rates: Callable[[Float[np.ndarray, " n"]], list[float]]


def table_layout(hand: Hand, table: str) -> Layout:
    """Makes the layout that a table defines for a hand, with commands within the actuators' ends.

    Args:
        table: a file, with ``{side}`` for the side; or the name of a table.

    Raises:
        ConfigError: there is no such table, it is for the other side, or it can't be read.
        UnknownNameError: the hand does not have a joint of the table.
    """
    side = hand.spec.side
    read = read_table(find_table(table.replace("{side}", side), "ros2", side))
    if read.side != side:
        raise ConfigError(
            f"ros2: {read.file} is of the {read.side} hand, but commands are for the {side} "
            f"one; put {{side}} into the name of the table"
        )
    bound = BoundMap(read, hand)

    def values(positions: Float[np.ndarray, " n"]) -> list[float]:
        commands: list[float] = bound.clip(bound.commands(bound.angles(positions))).tolist()
        return commands

    return Layout(read.names, values, lambda velocities: [])


def joint_layout(hand: Hand, joints: str, prefix: str = "") -> Layout:
    """Makes the layout for some joints of a hand.

    Args:
        joints: ``all``, ``actuated`` (joints that are not coupled to another), or names in the
            order of the message, separated by blanks, with ``*`` for any letters.

    Raises:
        UnknownNameError: the hand has no joint of that name.
    """
    if joints in ("all", "actuated"):
        indices = hand.actuated if joints == "actuated" else tuple(range(len(hand.joint_names)))
    else:
        indices = tuple(dict.fromkeys(i for word in joints.split() for i in _matching(hand, word)))

    def values(joint_values: Float[np.ndarray, " n"]) -> list[float]:
        picked: list[float] = joint_values[list(indices)].tolist()
        return picked

    return Layout(tuple(prefix + hand.joint_names[i] for i in indices), values, values)


def _matching(hand: Hand, pattern: str) -> list[int]:
    indices = [i for i, name in enumerate(hand.joint_names) if fnmatchcase(name, pattern)]
    if not indices:
        raise UnknownNameError(
            f"joint of hand {hand.name!r}:",
            pattern,
            hand.joint_names,
            "joints= must be all, actuated, or names separated by spaces.",
        )
    return indices


def pose_message(pose: Float[np.ndarray, "7"]) -> Message:
    """Converts a pose, x y z [m] and quaternion w x y z, to a message."""
    x, y, z, w, a, b, c = pose.tolist()
    return Pose(Point(x, y, z), Quaternion(a, b, c, w))


@dataclass(frozen=True)
class Ros2Sink(ThreadedSink):
    """Publishes commands on ROS 2 topics.

    ``std_msgs/String`` on ``<topic>_mode`` has the mode of the loop at each change: ``tracking``,
    ``holding``, ..., ``stalled`` (no commands), ``ended``. A driver stops its robot in these two
    modes, or without messages. All messages of a command have the time of publishing as stamp.

    Attributes:
        topic: topic of the commands, with ``{hand}`` and ``{side}`` for name and side of the hand.
        message: ``joint_state``, ``trajectory`` (one point, to be reached after ``duration``) or
            ``array`` (numbers alone, in the order of the joints).
        joints: ``all``, ``actuated``, or names of joints in their order, separated by blanks, with
            ``*`` for any letters. Default: all in a ``joint_state``, else the actuated ones, since
            controllers refuse joints that they do not have.
        table: a table of actuators, as of a real hand, with ``{side}`` for the side: names, order,
            and a map from angle to command for each. It replaces ``joints`` and ``prefix``.
        prefix: prefix of each joint's name.
        rate: largest rate of commands [Hz]; 0 for the rate of the loop.
        duration: time from the start of a ``trajectory`` to its point [s].
        wrist: topic of the wrist's target, ``geometry_msgs/PoseStamped``, if the run has one;
            ``none`` for no topic.
        human_wrist: topic of the operator's tracked wrist; ``none`` for no topic.
        arm: topic of the joints of the arm that carries the hand, if the run has one; ``none``
            for no topic.
        arm_message: message of the arm; as ``message``.
        measured: topic of the measured joints [rad], ``sensor_msgs/JointState``, if a sink
            measures them; ``none`` for no topic.
        base: name of the frame of the target; default: the one in the command.
        domain: ROS domain, 0 to 232; default: ``ROS_DOMAIN_ID``.
        network: ``localhost`` or ``subnet``; default: by the variables of ROS 2, else localhost.

    Raises:
        ConfigError: a setting is out of its range, or a name is not valid in ROS 2.
    """

    topic: str = "/{hand}/{side}/joint_commands"
    message: Kind = "joint_state"
    joints: str = "auto"
    table: str | None = None
    prefix: str = ""
    rate: float = 0.0
    duration: float = 0.05
    wrist: str | None = "/{hand}/{side}/wrist_pose"
    human_wrist: str | None = None
    arm: str | None = "/arm/{side}/joint_commands"
    arm_message: Kind = "joint_state"
    measured: str | None = "/{hand}/{side}/joint_states"
    base: str | None = None
    domain: int | None = None
    network: Network | None = None

    def __post_init__(self) -> None:
        for side in ("right", "left"):
            self._topics("hand", side)
        self._endpoint()
        if not self.joints.strip():
            raise ConfigError(
                "ros2: joints must be all, actuated or names of joints; it must not be empty"
            )
        if self.table is not None and (self.joints, self.prefix) != ("auto", ""):
            raise ConfigError(
                "ros2: the table determines names and order; remove joints and prefix"
            )
        check_range("ros2: rate", self.rate, 0.0, 10_000.0, "Hz")
        check_range("ros2: duration", self.duration, 0.0, 60.0, "s")

    @property
    def label(self) -> str:
        """The word ``ros2`` and the topic."""
        return f"ros2 {self.topic}"

    @property
    def note(self) -> str:
        """The domain of the open sink, and the machines that it reaches."""
        reach: str = getattr(self, "_reach", "")
        return reach

    def connect(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> Link:
        """Open the transport and its publishers."""
        topics = {side: self._topics(hand.name, side) for side, hand in hands.items()}
        if len({each["topic"] for each in topics.values()}) < len(topics):
            raise SinkError(f"ros2: two hands on one topic {self.topic!r}; put {{side}} into it")
        layouts = {side: self._layout(hand) for side, hand in hands.items()}
        transport = Transport(self._endpoint())
        try:
            link = _Publisher(self, transport, topics, layouts)
        except BaseException:
            transport.close()
            raise
        self._set(_reach=transport.label)
        return link

    def _endpoint(self) -> Endpoint:
        return Endpoint("the ros2 sink", SinkError, self.domain, self.network)

    def _layout(self, hand: Hand) -> Layout:
        if self.table is not None:
            return table_layout(hand, self.table)
        joints = self.joints
        if joints == "auto":
            joints = "all" if self.message == "joint_state" else "actuated"
        return joint_layout(hand, joints, self.prefix)

    def _topics(self, hand: str, side: str) -> dict[str, str]:
        """Names of the topics."""
        names = ("topic", "wrist", "human_wrist", "arm", "measured")
        return {
            name: topic_name(template, "ros2", hand=hand, side=side)
            for name in names
            if (template := getattr(self, name)) is not None
        }


class _Publisher:
    """The open publishers; only the sink's own thread uses them."""

    def __init__(
        self,
        sink: Ros2Sink,
        transport: Transport,
        topics: Mapping[Side, Mapping[str, str]],
        layouts: Mapping[Side, Layout],
    ) -> None:
        self._sink, self._transport, self._layouts = sink, transport, layouts
        self._modes: dict[Side, str] = {}
        self._due: dict[Side, float] = {}
        self._states: dict[Side, HandState] = {}
        optional: dict[str, type[Message]] = {
            "wrist": PoseStamped,
            "human_wrist": PoseStamped,
            "arm": KINDS[sink.arm_message],
            "measured": JointState,
        }
        self._publish: dict[Side, dict[str, Callable[[Any], None]]] = {
            side: {
                "topic": transport.publisher(KINDS[sink.message], each["topic"]),
                "mode": transport.publisher(String, f"{each['topic']}_mode"),
                **{
                    name: transport.publisher(kind, each[name])
                    for name, kind in optional.items()
                    if name in each
                },
            }
            for side, each in topics.items()
        }

    def deliver(self, tick: Tick) -> None:
        """Publish a command, and the mode and the measured joints if they are new."""
        new_mode = self._say(tick.side, tick.mode.value)
        stamp = self._transport.now()
        self._state(tick, stamp)
        due = self._is_due(tick)
        if not due and not new_mode:
            return
        self._publish[tick.side]["topic"](self._command(tick, stamp))
        self._arm(tick, stamp)
        self._wrists(tick, stamp)

    def stalled(self, seconds: float) -> None:
        """Publish that there are no commands."""
        for side in self._publish:
            self._say(side, "stalled")

    def close(self) -> None:
        """Publish the mode ``ended``, and close the transport."""
        try:
            for side in self._publish:
                self._say(side, "ended")
        finally:
            self._publish.clear()
            self._transport.close()

    def _command(self, tick: Tick, stamp: Message) -> Message:
        layout, sink = self._layouts[tick.side], self._sink
        values, rates = layout.values(tick.command.joint_positions), layout.rates(tick.velocity)
        return joint_message(sink.message, stamp, layout.names, values, rates, sink.duration)

    def _arm(self, tick: Tick, stamp: Message) -> None:
        """Publish the command of the arm, if any."""
        publish = self._publish[tick.side].get("arm")
        if tick.arm is not None and publish:
            positions, rates = tick.arm.positions.tolist(), tick.arm.velocity.tolist()
            names, sink = tick.arm.joint_names, self._sink
            publish(joint_message(sink.arm_message, stamp, names, positions, rates, sink.duration))

    def _state(self, tick: Tick, stamp: Message) -> None:
        """Publish new measured joints, with the time of the measurement."""
        publish, state = self._publish[tick.side].get("measured"), tick.state
        if state is None or publish is None or state is self._states.get(tick.side):
            return
        self._states[tick.side] = state
        age = max(0, round((time.perf_counter() - state.stamp) * 1e9))
        measured = np.isfinite(state.positions)
        names = [name for name, good in zip(state.names, measured, strict=True) if good]
        rates = None if state.velocities is None else state.velocities[measured]
        sent = [] if rates is None or not np.isfinite(rates).all() else rates.tolist()
        header = Header(time_of(max(0, nanoseconds_of(stamp) - age)))
        publish(JointState(header, names, state.positions[measured].tolist(), sent))

    def _wrists(self, tick: Tick, stamp: Message) -> None:
        """Publish the target of the wrist, and the operator's wrist, if any."""
        poses = []
        if tick.wrist is not None:
            poses.append(("wrist", self._sink.base or tick.wrist.world, tick.wrist.pose))
        frame = None if tick.arrival is None else tick.arrival.frame
        if frame is not None and frame.T_world_wrist is not None:
            poses.append(("human_wrist", frame.world or "world", frame.T_world_wrist))
        for name, parent, pose in poses:
            publish = self._publish[tick.side].get(name)
            if publish is not None and all(map(math.isfinite, pose.tolist())):
                publish(PoseStamped(Header(stamp, parent), pose_message(pose)))

    def _is_due(self, tick: Tick) -> bool:
        if not self._sink.rate:
            return True
        due = self._due.get(tick.side, tick.time)
        if tick.time < due:
            return False
        period = 1.0 / self._sink.rate
        on_time = tick.time - due < period  # so that late ticks do not lower the mean rate
        self._due[tick.side] = period + (due if on_time else tick.time)
        return True

    def _say(self, side: Side, mode: str) -> bool:
        """Publish a new mode; True if it is new."""
        if self._modes.get(side) == mode:
            return False
        self._modes[side] = mode
        self._publish[side]["mode"](String(mode))
        return True
