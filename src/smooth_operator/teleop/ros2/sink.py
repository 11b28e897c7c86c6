"""Commands as ROS 2 messages: ``--sink ros2``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.ros2.backends import open_transport
from smooth_operator.teleop.ros2.joints import UNITS, Layout, Unit, joint_layout, table_layout
from smooth_operator.teleop.ros2.messages import (
    Duration,
    Float64MultiArray,
    Header,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    Message,
    PoseStamped,
    String,
    TFMessage,
    Time,
)
from smooth_operator.teleop.ros2.poses import pose_message, transform_message
from smooth_operator.teleop.ros2.transport import (
    TF_DEPTH,
    Backend,
    Endpoint,
    Network,
    Transport,
    topic_name,
)
from smooth_operator.teleop.sinks.threaded_sink import Link, ThreadedSink
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.types import Side

Kind: TypeAlias = Literal["joint_state", "trajectory", "array"]
"""The message: ``sensor_msgs/JointState``, ``trajectory_msgs/JointTrajectory`` or
``std_msgs/Float64MultiArray``."""

_KINDS: Final[dict[Kind, type[Message]]] = {
    "joint_state": JointState,
    "trajectory": JointTrajectory,
    "array": Float64MultiArray,
}


@dataclass(frozen=True)
class Ros2Sink(ThreadedSink):
    """Publishes commands on ROS 2 topics, by rclpy or, without ROS 2, by CycloneDDS.

    ``std_msgs/String`` on ``<topic>_mode`` says what the loop does, whenever that changes:
    ``tracking``, ``holding``, ..., ``stalled`` when no commands come, ``ended``. A driver stops its
    robot when either goes quiet or says so. All messages of one command have one stamp, the time of
    publishing.

    Attributes:
        topic: of the commands; ``{hand}`` and ``{side}`` stand for the hand's.
        message: ``joint_state``, ``trajectory`` (one point, to be reached after ``duration``) or
            ``array`` (numbers alone, in the order of the joints).
        joints: ``all``, ``actuated``, or names of joints separated by blanks, in their order, with
            ``*`` for any letters. Default: all in a ``joint_state``, else the actuated ones, since
            controllers refuse joints that they do not have.
        table: a table of actuators, as real hands have them: names, order, and a map from angle to
            command for each; ``{side}`` stands for the side. In place of ``joints``, ``prefix``,
            ``unit``, ``scale`` and ``offset``.
        prefix: put before each joint's name.
        unit: ``rad`` or ``deg``.
        scale: factor on each value, after the unit.
        offset: added to each value, after the scale.
        velocity: send velocities in a ``joint_state``; never with a table.
        rate: most commands in a second [Hz]; 0 for as many as the loop gives.
        duration: time from start of the point of a ``trajectory`` [s].
        wrist: topic of the wrist's target, ``geometry_msgs/PoseStamped``, where the run has one;
            ``none`` for no topic.
        human_wrist: topic of the operator's wrist, as tracked; ``none`` for no topic.
        tf: send both as transforms on ``/tf``, too.
        base: name of the frame that the target is in; default: the one that the command names.
        frame: name of the frame of the target on ``/tf``.
        node: name of the node (rclpy).
        domain: ROS domain, 0 to 232; default: ``ROS_DOMAIN_ID``.
        network: ``localhost`` or ``subnet``, for CycloneDDS; default: what ROS 2's variables say,
            else localhost.
        backend: ``rclpy``, ``cyclonedds``, or ``auto``: rclpy where it can be imported.

    Raises:
        ConfigError: a setting is outside its range, or a name is none that ROS 2 takes.
    """

    topic: str = "/{hand}/{side}/joint_commands"
    message: Kind = "joint_state"
    joints: str = "auto"
    table: str | None = None
    prefix: str = ""
    unit: Unit = "rad"
    scale: float = 1.0
    offset: float = 0.0
    velocity: bool = True
    rate: float = 0.0
    duration: float = 0.05
    wrist: str | None = "/{hand}/{side}/wrist_pose"
    human_wrist: str | None = None
    tf: bool = False
    base: str | None = None
    frame: str = "{hand}_{side}_wrist"
    node: str = "smooth_operator"
    domain: int | None = None
    network: Network | None = None
    backend: Backend = "auto"

    def __post_init__(self) -> None:
        for side in ("right", "left"):
            self._topics("hand", side)
        self._endpoint()
        if not self.joints.strip():
            raise ConfigError("ros2: joints must be all, actuated or names of joints, not nothing")
        given = (self.joints, self.prefix, self.unit, self.scale, self.offset)
        if self.table is not None and given != ("auto", "", "rad", 1.0, 0.0):
            raise ConfigError(
                "ros2: the table says names, order and unit; leave out joints, prefix, unit, scale "
                "and offset"
            )
        for name, low, high in (("rate", 0.0, 10_000.0), ("duration", 0.0, 60.0)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"ros2: {name} must be {low:g} to {high:g}, not {value:g}")
        if not (math.isfinite(self.scale) and self.scale and math.isfinite(self.offset)):
            raise ConfigError("ros2: scale and offset must be finite numbers, and scale not zero")

    @property
    def label(self) -> str:
        """``ros2`` and the topic."""
        return f"ros2 {self.topic}"

    @property
    def note(self) -> str:
        """By which library the open sink sends, and whom that reaches."""
        found: str = getattr(self, "_reach", "")
        return found

    def connect(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> Link:
        """Open the transport and its publishers."""
        topics = {side: self._topics(hand.name, side) for side, hand in hands.items()}
        if len({each["topic"] for each in topics.values()}) < len(topics):
            raise SinkError(f"ros2: two hands on one topic {self.topic!r}; put {{side}} into it")
        layouts = {side: self._layout(hand) for side, hand in hands.items()}
        transport = open_transport(self._endpoint())
        try:
            link = _Publisher(self, transport, topics, layouts)
        except BaseException:
            transport.close()
            raise
        object.__setattr__(self, "_reach", transport.label)
        return link

    def _endpoint(self) -> Endpoint:
        return Endpoint(
            "the ros2 sink", SinkError, self.node, self.domain, self.network, self.backend
        )

    def _layout(self, hand: Hand) -> Layout:
        if self.table is not None:
            return table_layout(hand, self.table)
        joints = self.joints
        if joints == "auto":
            joints = "all" if self.message == "joint_state" else "actuated"
        gain = self.scale * UNITS[self.unit]
        return joint_layout(hand, joints, prefix=self.prefix, gain=gain, offset=self.offset)

    def _topics(self, hand: str, side: str) -> dict[str, str]:
        """Names of the topics, and of the frame of the wrist."""
        names = ("topic", "wrist", "human_wrist", "frame")
        return {
            name: topic_name(template, "ros2", hand=hand, side=side)
            for name in names
            if (template := getattr(self, name)) is not None
        }


class _Publisher:
    """The open publishers; only the sink's own thread touches them."""

    def __init__(
        self,
        sink: Ros2Sink,
        transport: Transport,
        topics: Mapping[Side, Mapping[str, str]],
        layouts: Mapping[Side, Layout],
    ) -> None:
        self._sink, self._transport, self._layouts = sink, transport, layouts
        self._frames = {side: each["frame"] for side, each in topics.items()}
        self._modes: dict[Side, str] = {}
        self._due: dict[Side, float] = {}
        self._publish: dict[Side, dict[str, Callable[[Any], None]]] = {
            side: {
                "topic": transport.publisher(_KINDS[sink.message], each["topic"]),
                "mode": transport.publisher(String, f"{each['topic']}_mode"),
                **{
                    name: transport.publisher(PoseStamped, each[name])
                    for name in ("wrist", "human_wrist")
                    if name in each
                },
            }
            for side, each in topics.items()
        }
        self._tf = transport.publisher(TFMessage, "/tf", TF_DEPTH) if sink.tf else None

    def deliver(self, tick: Tick) -> None:
        """Publish a command, and the mode if it is new."""
        if not self._say(tick.side, tick.mode.value) and not self._is_due(tick):
            return
        stamp = self._transport.now()
        self._publish[tick.side]["topic"](self._command(tick, stamp))
        self._wrists(tick, stamp)

    def stalled(self, seconds: float) -> None:
        """Publish that no commands come."""
        for side in self._publish:
            self._say(side, "stalled")

    def close(self) -> None:
        """Say that it ends, and give the transport back."""
        try:
            for side in self._publish:
                self._say(side, "ended")
        finally:
            self._publish.clear()
            self._tf = None
            self._transport.close()

    def _command(self, tick: Tick, stamp: Time) -> Message:
        layout, sink = self._layouts[tick.side], self._sink
        values = layout.values(tick.command.positions)
        if not all(map(math.isfinite, values)):
            raise SinkError(f"ros2: a command that is not finite is not sent: {values}")
        if sink.message == "array":
            return Float64MultiArray(data=values)
        if sink.message == "trajectory":
            # No stamp: it begins when it comes, by the controller's clock. No velocity: some
            # controllers refuse a last point that moves.
            time = Time.of(round(sink.duration * 1e9))
            point = JointTrajectoryPoint(values, time_from_start=Duration(time.sec, time.nanosec))
            return JointTrajectory(Header(), list(layout.names), [point])
        rates = layout.rates(tick.velocity) if sink.velocity else []
        return JointState(Header(stamp), list(layout.names), values, rates)

    def _wrists(self, tick: Tick, stamp: Time) -> None:
        """Publish the wrist's target and the operator's wrist, as far as there are."""
        found = []
        if tick.wrist is not None:
            parent = self._sink.base or tick.wrist.world
            found.append(("wrist", parent, self._frames[tick.side], tick.wrist.pose))
        frame = None if tick.arrival is None else tick.arrival.frame
        if frame is not None and frame.T_world_wrist is not None:
            child = f"human_{tick.side}_wrist"
            found.append(("human_wrist", frame.world or "world", child, frame.T_world_wrist))
        found = [each for each in found if all(map(math.isfinite, each[-1].tolist()))]
        for name, parent, _, pose in found:
            if publish := self._publish[tick.side].get(name):
                publish(PoseStamped(Header(stamp, parent), pose_message(pose)))
        if self._tf is not None and found:
            transforms = [transform_message(Header(stamp, p), c, pose) for _, p, c, pose in found]
            self._tf(TFMessage(transforms))

    def _is_due(self, tick: Tick) -> bool:
        if not self._sink.rate:
            return True
        due = self._due.get(tick.side, -math.inf)
        if tick.time < due:
            return False
        period = 1.0 / self._sink.rate
        self._due[tick.side] = max(due + period, tick.time)
        return True

    def _say(self, side: Side, mode: str) -> bool:
        """Publish a mode that is new; whether it is."""
        if self._modes.get(side) == mode:
            return False
        self._modes[side] = mode
        self._publish[side]["mode"](String(mode))
        return True
