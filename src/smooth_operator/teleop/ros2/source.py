"""Hand poses from ROS 2 topics: ``--source ros2:/hand/{side}/poses``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from smooth_operator.errors import ConfigError, SourceError
from smooth_operator.io.anatomy import layout_order
from smooth_operator.teleop.ros2.hand_poses import KINDS, Frame, HandPoseReader, Kind
from smooth_operator.teleop.ros2.messages import PoseStamped
from smooth_operator.teleop.ros2.transport import (
    Endpoint,
    Network,
    Transport,
    topic_name,
)
from smooth_operator.teleop.sources.inboxes import NEWEST, Inbox, Message
from smooth_operator.teleop.sources.manus_gloves import glove_sides
from smooth_operator.teleop.sources.stream import Hands, Reader, StreamSource, only_side
from smooth_operator.types import Side


@dataclass(frozen=True)
class Ros2Source(StreamSource):
    """Source of hands from ROS 2 topics, of reliable and best-effort publishers.

    Attributes:
        topic: topic of the hands, or several, separated by blanks; ``{side}`` stands for right and
            left.
        side: hands to use. ``both`` needs ``{side}`` in the topic, or messages with the side
            (``json``, ``manus_glove``).
        message: ``pose_array``: ``geometry_msgs/PoseArray`` of 21, 25 or 26 poses; ``json``:
            ``std_msgs/String`` with landmarks, or a MANUS glove, as ``udp`` and ``manus`` read
            them; ``manus_glove``: ``manus_ros2_msgs/ManusGlove``.
        frame: reference frame of the poses of a ``pose_array``. ``world``: a fixed frame with z up
            (REP 103), so the pose of the wrist follows from them; ``wrist``: the frame of the topic
            ``wrist``; ``camera``: another, so the wrist has no pose in the world.
        wrist: topic of the wrist's pose in the world, ``geometry_msgs/PoseStamped``.
        layout: order of the landmarks in a message of 21, by its name in ``LAYOUTS``.
        right_glove: id of the right MANUS glove, for messages without a side.
        left_glove: id of the left one.
        domain: ROS domain, 0 to 232; default: ``ROS_DOMAIN_ID``.
        network: ``localhost`` or ``subnet``; default: what ROS 2's variables say,
            else localhost.

    Raises:
        ConfigError: a setting is outside its range, or a name is none that ROS 2 takes.
        UnknownNameError: there is no such layout.
    """

    topic: str = "/hand/{side}/poses"
    side: Hands = "right"
    message: Kind = "pose_array"
    frame: Frame = "world"
    wrist: str | None = None
    layout: str = "mediapipe"
    right_glove: str | None = None
    left_glove: str | None = None
    domain: int | None = None
    network: Network | None = None

    def __post_init__(self) -> None:
        layout_order(self.layout)
        self._endpoint()
        topics = self._topics()
        if self.message == "pose_array" and None in topics.values():
            raise ConfigError(
                "ros2: poses do not say which hand they are of: put {side} into the topic, or take "
                "one hand only (side=right or side=left)"
            )
        if len(self._wrist_topics()) < len(self.sides) and self.wrist is not None:
            raise ConfigError("ros2: two hands need two wrists: put {side} into wrist")
        if (self.wrist is not None) != (self.frame == "wrist"):
            raise ConfigError("ros2: wrist=TOPIC and frame=wrist go together: give both or none")
        glove_sides(self.right_glove, self.left_glove)

    @property
    def label(self) -> str:
        """The source in a few words."""
        return f"ROS 2 {self.topic}"

    def connect(self) -> Inbox:
        """Open the transport and its subscriptions."""
        topics, wrists = self._topics(), self._wrist_topics()
        transport = Transport(self._endpoint())
        try:
            for topic in topics:
                transport.subscribe(KINDS[self.message], topic, NEWEST)
            for topic in wrists:
                transport.subscribe(PoseStamped, topic, NEWEST)
        except BaseException:
            transport.close()
            raise
        return Ros2Inbox(transport, f"{', '.join(topics)} ({transport.label})")

    def reader(self) -> Reader:
        """Reads the messages of the topics."""
        gloves = glove_sides(self.right_glove, self.left_glove)
        topics, wrists = self._topics(), self._wrist_topics()
        hands = HandPoseReader(topics, wrists, self.frame, self.layout, gloves)
        return lambda message, received: hands.read(message[0], message[1], received)

    def _endpoint(self) -> Endpoint:
        return Endpoint("the source 'ros2'", SourceError, self.domain, self.network)

    def _topics(self) -> dict[str, Side | None]:
        """Topic -> side of its hands, None if messages have it."""
        topics: dict[str, Side | None] = {}
        names = self.topic.split() or [self.topic]
        for name in names:
            for side in self.sides:
                topic = topic_name(name, "ros2", side=side)
                topics[topic] = side if "{side}" in name else only_side(self.side)
        return topics

    def _wrist_topics(self) -> Mapping[str, Side]:
        if self.wrist is None:
            return {}
        return {topic_name(self.wrist, "ros2", side=side): side for side in self.sides}


class Ros2Inbox(Inbox):
    """Open subscriptions: the newest messages of each topic.

    Args:
        transport: transport with the subscriptions.
        address: description of the topics, for messages.
    """

    def __init__(self, transport: Transport, address: str) -> None:
        self._transport = transport
        self.address = address

    def receive(self, timeout: float) -> list[Message]:
        """See ``Inbox``."""
        received = self._transport.receive(timeout)
        left: dict[str, int] = {}
        newest: list[Message] = []
        for topic, message in reversed(received):
            left[topic] = left.get(topic, NEWEST) - 1
            if left[topic] >= 0:
                newest.append((topic, message))
        return newest[::-1]

    def close(self) -> None:
        """End the subscriptions."""
        self._transport.close()
