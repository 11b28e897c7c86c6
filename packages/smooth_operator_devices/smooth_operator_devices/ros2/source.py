"""The source ``ros2``, which receives hand poses from topics such as ``/hand/{side}/poses``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.errors import ConfigError, RecordingError, SourceError
from smooth_operator.io.landmark_order import layout_order
from smooth_operator.teleop.sources.inboxes import NEWEST, Inbox
from smooth_operator.teleop.sources.inboxes import Message as Received
from smooth_operator.teleop.sources.payload import (
    Forms,
    Reading,
    hand_frame,
    pose_frame,
    read_payload,
)
from smooth_operator.teleop.sources.programs import glove_sides, read_glove, read_manus
from smooth_operator.teleop.sources.stream import Hands, Reader, StreamSource, only_side
from smooth_operator.types import HandFrame, Side
from smooth_operator_devices.ros2.messages import (
    ManusGlove,
    Message,
    PoseArray,
    PoseStamped,
    String,
    seconds_of,
)
from smooth_operator_devices.ros2.transport import Endpoint, Network, Transport, topic_name

Kind: TypeAlias = Literal["pose_array", "json", "manus_glove", "pose"]
"""Type of the message: ``geometry_msgs/PoseArray``, ``std_msgs/String`` with JSON,
``manus_ros2_msgs/ManusGlove``, or ``geometry_msgs/PoseStamped`` of a tracker on a hand."""
Frame: TypeAlias = Literal["world", "wrist", "camera"]
"""Frame of the poses: ``world``, fixed and z up; ``wrist``, which moves with the hand; or
``camera``, anything else."""

KINDS: Final[Mapping[Kind, type[Message]]] = {
    "pose_array": PoseArray,
    "json": String,
    "manus_glove": ManusGlove,
    "pose": PoseStamped,
}

MATCH_S: Final = 0.1
"""Largest difference of the times of a wrist's pose and of the joints in one frame [s]."""

_GLOVE_WORDS: Final = (b'"nodes"', b'"raw_nodes"', b'"gloves"')


@dataclass(frozen=True)
class _WristPose:
    """The last pose of a wrist: (7,) in the frame ``world``, by its own stamp and as received."""

    pose: np.ndarray
    world: str
    stamp: float
    received: float


class HandPoseReader:
    """Converts messages to hand frames, and adds the poses of wrists.

    Args:
        topics: topic of hands -> side, None if each message has it.
        wrists: topic of wrist poses -> side.
        frame: frame of the poses of a ``PoseArray``.
        layout: order of the landmarks in a message of 21.
        gloves: id of a MANUS glove -> side.
    """

    def __init__(
        self,
        topics: Mapping[str, Side | None],
        wrists: Mapping[str, Side],
        frame: Frame,
        layout: str,
        gloves: Mapping[str, Side],
    ) -> None:
        self._topics, self._wrist_topics, self._frame = topics, wrists, frame
        self._layout, self._gloves = layout, gloves
        self._wrists: dict[Side, _WristPose] = {}

    def read(
        self, topic: str, message: Message | RecordingError, received: float
    ) -> Sequence[Reading]:
        """Reads the hands of a message; empty for the pose of a wrist.

        Raises:
            RecordingError: the message can't be read.
        """
        if isinstance(message, RecordingError):
            raise message
        if isinstance(message, PoseStamped):
            pose = pose_rows([message.pose])[0]
            stamp = seconds_of(message.header.stamp)
            if (tracked := self._topics.get(topic)) is not None:
                world = message.header.frame_id or "world"
                return (Reading(pose_frame(pose, stamp or None, tracked, world)),)
            side = self._wrist_topics[topic]
            self._wrists[side] = _WristPose(pose, message.header.frame_id, stamp, received)
            return ()
        side_of = self._topics[topic]
        if isinstance(message, PoseArray):
            if not message.poses:  # no hand is visible
                return ()
            frame = self._pose_array(message, side_of)
            return (Reading(self._with_wrist(frame, message.header, received)),)
        if isinstance(message, String):
            data = message.data.encode()
            if any(word in data for word in _GLOVE_WORDS):
                return read_manus(data, gloves=self._gloves, side=side_of)
            return read_payload(data, side_of, Forms(layout=self._layout))
        assert isinstance(message, ManusGlove)
        return (read_glove(_as_json(message), self._gloves, side_of),)

    def _pose_array(self, message: Message, side: Side | None) -> HandFrame:
        assert side is not None  # the source has a topic for each hand
        rows = pose_rows(message.poses)
        turned = not np.allclose(rows[:, 3:], (1.0, 0.0, 0.0, 0.0))  # else none is known
        return hand_frame(
            rows[:, :3],
            stamp=seconds_of(message.header.stamp) or None,
            side=side,
            orientations=rows[:, 3:] if turned else None,
            layout=self._layout,
        )

    def _with_wrist(self, frame: HandFrame, header: Message, received: float) -> HandFrame:
        """Add the pose of the wrist in the world to a frame."""
        assert frame.valid is not None
        points = np.where(frame.valid[:, None], frame.landmarks, np.nan)
        world: str | None = None
        pose = np.full(7, np.nan)
        if self._frame == "world":
            world = header.frame_id or "world"
            pose = poses.wrist_from_landmarks(points, frame.side)
        elif self._frame == "wrist" and frame.side in self._wrist_topics.values():
            wrist = self._wrists.get(frame.side)
            world = "world" if wrist is None else wrist.world or "world"
            if wrist is not None and _matches(wrist, frame, received):
                moved = wrist.pose[:3] + poses.rotate(wrist.pose[3:], points)
                pose = poses.wrist_from_landmarks(moved, frame.side)
        if world is None:
            return frame
        return replace(frame, T_world_wrist=pose, world=world)


def _matches(wrist: _WristPose, frame: HandFrame, received: float) -> bool:
    if frame.stamp is not None and wrist.stamp:
        return abs(frame.stamp - wrist.stamp) <= MATCH_S
    return abs(received - wrist.received) <= MATCH_S


def _as_json(message: Message) -> dict[str, object]:
    """Converts a glove's message to the JSON form of bridges, without a stamp."""
    places = pose_rows([node.pose for node in message.raw_nodes])
    nodes = [
        {"id": node.node_id, "pos": row[:3].tolist(), "quat": row[3:].tolist()}
        for node, row in zip(message.raw_nodes, places, strict=True)
    ]
    return {"side": message.side, "glove_id": message.glove_id, "nodes": nodes}


def pose_rows(poses: list[Message]) -> Float[np.ndarray, "n 7"]:
    """(n, 7) poses, x y z [m] and quaternion w x y z."""
    rows = [
        (p.position.x, p.position.y, p.position.z, q.w, q.x, q.y, q.z)
        for p in poses
        for q in (p.orientation,)
    ]
    return np.array(rows, np.float64).reshape(len(rows), 7)


@dataclass(frozen=True)
class Ros2Source(StreamSource):
    """Source of hands from ROS 2 topics, of reliable and best-effort publishers.

    Attributes:
        topic: topics of the hands, separated by blanks, with ``{side}`` for right and left.
        side: hands to use. ``both`` needs ``{side}`` in the topic, or messages with the side
            (``json``, ``manus_glove``).
        message: ``pose_array``: ``geometry_msgs/PoseArray`` of 21, 25 or 26 poses; ``json``:
            ``std_msgs/String`` with landmarks, or a MANUS glove, as ``udp`` and ``manus`` read
            them; ``manus_glove``: ``manus_ros2_msgs/ManusGlove``; ``pose``:
            ``geometry_msgs/PoseStamped``, the pose of a tracker in a fixed frame with z up, for
            ``--wrist-source``.
        frame: reference frame of the poses of a ``pose_array``. ``world``: a fixed frame with z up
            (REP 103), so the pose of the wrist follows from them; ``wrist``: the frame of the topic
            ``wrist``; ``camera``: another, so the wrist has no pose in the world.
        wrist: topic of the wrist's pose in the world, ``geometry_msgs/PoseStamped``.
        layout: order of the landmarks in a message of 21, by its name in ``LAYOUTS``.
        right_glove: id of the right MANUS glove, for messages without a side.
        left_glove: id of the left one.
        domain: ROS domain, 0 to 232; default: ``ROS_DOMAIN_ID``.
        network: ``localhost`` or ``subnet``; default: by the variables of ROS 2, else localhost.

    Raises:
        ConfigError: a setting is out of its range, or a name is not valid in ROS 2.
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
        if self.message in ("pose_array", "pose") and None in topics.values():
            raise ConfigError(
                "ros2: poses do not contain a side: put {side} into the topic, or use only "
                "one hand (side=right or side=left)"
            )
        if len(self._wrist_topics()) < len(self.sides) and self.wrist is not None:
            raise ConfigError("ros2: two hands need two wrists: put {side} into wrist")
        if (self.wrist is not None) != (self.frame == "wrist"):
            raise ConfigError(
                "ros2: wrist=TOPIC and frame=wrist belong together: set both or neither"
            )
        glove_sides(self.right_glove, self.left_glove)

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
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
        """Topic -> side of its hands; None if the messages contain it."""
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

    def receive(self, timeout: float) -> list[Received]:
        """See ``Inbox``."""
        received = self._transport.receive(timeout)
        left: dict[str, int] = {}
        newest: list[Received] = []
        for topic, message in reversed(received):
            left[topic] = left.get(topic, NEWEST) - 1
            if left[topic] >= 0:
                newest.append((topic, message))
        return newest[::-1]

    def close(self) -> None:
        """End the subscriptions."""
        self._transport.close()
