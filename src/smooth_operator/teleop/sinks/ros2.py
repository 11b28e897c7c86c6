"""Commands as ROS 2 messages, where ROS 2 is: rclpy comes with it, not from a package index."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.sinks.threaded_sink import Link, ThreadedSink
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.types import Side

_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")


@dataclass(frozen=True)
class Ros2Sink(ThreadedSink):
    """Publishes ``sensor_msgs/JointState`` commands, and the mode.

    The message has names, positions [rad] and velocities [rad/s] of all joints; its header has the
    time of publishing, by the node's clock. ``std_msgs/String`` on ``<topic>_mode`` says what the
    loop does, whenever that changes: ``tracking``, ``holding``, ..., ``stalled`` when no commands
    come, ``ended``. A driver stops its robot when either goes quiet or says so.

    Attributes:
        topic: name of the topic; ``{hand}`` and ``{side}`` stand for the hand's.
        node: name of the node.

    Raises:
        ConfigError: the topic or node name is none that ROS 2 takes.
    """

    topic: str = "/{hand}/{side}/joint_commands"
    node: str = "smooth_operator"

    def __post_init__(self) -> None:
        for side in ("right", "left"):
            self._topic("hand", side)
        if not re.fullmatch(r"[A-Za-z_]\w*", self.node):
            raise ConfigError(f"ros2: {self.node!r} can't be the name of a node")

    @property
    def label(self) -> str:
        """``ros2`` and the topic."""
        return f"ros2 {self.topic}"

    def connect(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> Link:
        """Make the node and its publishers."""
        topics = {side: self._topic(hand.name, side) for side, hand in hands.items()}
        if len(set(topics.values())) < len(topics):
            raise SinkError(f"ros2: two hands on one topic {self.topic!r}; put {{side}} into it")
        rclpy, sensors, texts = map(_import, ("rclpy", "sensor_msgs.msg", "std_msgs.msg"))
        contexts = _import("rclpy.context")
        # A context of our own: the default one would take over Ctrl-C, and may be in use.
        context = contexts.Context()
        try:
            rclpy.init(context=context)
            node = rclpy.create_node(self.node, context=context)
            publishers = {
                side: (
                    node.create_publisher(sensors.JointState, topic, 1),
                    node.create_publisher(texts.String, f"{topic}_mode", 10),
                )
                for side, topic in topics.items()
            }
        except Exception as error:  # rclpy's own errors have no common base
            raise SinkError(
                f"ROS 2 does not start: {type(error).__name__}: {error}; check its setup and "
                "ROS_DOMAIN_ID"
            ) from error
        return _Node(rclpy, context, node, publishers, sensors.JointState, texts.String)

    def _topic(self, hand: str, side: str) -> str:
        try:
            topic = self.topic.format(hand=re.sub(r"\W", "_", hand), side=side)
        except (KeyError, IndexError, ValueError):
            topic = ""
        if not _TOPIC.fullmatch(topic):
            raise ConfigError(
                f"ros2: {self.topic!r} can't be a topic; expected words of letters, digits and _ "
                "with / between, in which {hand} and {side} may stand"
            )
        return topic


def _import(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        raise SinkError(
            f"the ros2 sink needs ROS 2's {name}, which pip can't install: run 'source "
            f"/opt/ros/DISTRO/setup.bash' first, with a ROS 2 whose Python is this one, {version} "
            f"({error})"
        ) from error


class _Node:
    """The node; only the sink's own thread touches it."""

    def __init__(
        self,
        rclpy: Any,
        context: Any,
        node: Any,
        publishers: Mapping[Side, tuple[Any, Any]],
        joint_state: Any,
        text: Any,
    ) -> None:
        self._rclpy, self._context, self._node = rclpy, context, node
        self._publishers = publishers
        self._joint_state, self._text = joint_state, text
        self._modes: dict[Side, str] = {}

    def deliver(self, tick: Tick) -> None:
        """Publish a command, and the mode if it is new."""
        self._say(tick.side, tick.mode.value)
        message = self._joint_state()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.name = list(tick.command.names)
        message.position = tick.command.positions.tolist()
        message.velocity = tick.velocity.tolist()
        self._publishers[tick.side][0].publish(message)

    def stalled(self, seconds: float) -> None:
        """Publish that no commands come."""
        for side in self._publishers:
            self._say(side, "stalled")

    def close(self) -> None:
        """Say that it ends, and give the node back."""
        try:
            for side in self._publishers:
                self._say(side, "ended")
        finally:
            self._node.destroy_node()
            self._rclpy.shutdown(context=self._context)

    def _say(self, side: Side, mode: str) -> None:
        if self._modes.get(side) != mode:
            self._modes[side] = mode
            self._publishers[side][1].publish(self._text(data=mode))
