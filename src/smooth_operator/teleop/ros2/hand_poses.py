"""Hands in ROS 2 messages: poses of joints, JSON texts, MANUS gloves, and the wrist's pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np

from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.teleop.ros2.commands import pose_rows
from smooth_operator.teleop.ros2.messages import (
    Header,
    ManusGlove,
    Message,
    PoseArray,
    PoseStamped,
    String,
)
from smooth_operator.teleop.sources.manus_gloves import read_glove, read_manus
from smooth_operator.teleop.sources.payload import Reading, hand_frame, read_payload
from smooth_operator.types import HandFrame, Side

Kind: TypeAlias = Literal["pose_array", "json", "manus_glove"]
"""Type of the message: ``geometry_msgs/PoseArray``, ``std_msgs/String`` with JSON, or
``manus_ros2_msgs/ManusGlove``."""
Frame: TypeAlias = Literal["world", "wrist", "camera"]
"""Frame of the poses: ``world``, fixed and z up; ``wrist``, which moves with the hand; or
``camera``, anything else."""

KINDS: Final[Mapping[Kind, type[Message]]] = {
    "pose_array": PoseArray,
    "json": String,
    "manus_glove": ManusGlove,
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
        """Hands of a message; empty for the pose of a wrist.

        Raises:
            RecordingError: the message can't be read.
        """
        if isinstance(message, RecordingError):
            raise message
        if isinstance(message, PoseStamped):
            pose = pose_rows([message.pose])[0]
            side, stamp = self._wrist_topics[topic], message.header.stamp.seconds
            self._wrists[side] = _WristPose(pose, message.header.frame_id, stamp, received)
            return ()
        side_of = self._topics[topic]
        if isinstance(message, PoseArray):
            if not message.poses:  # the hand is not seen
                return ()
            reading = self._pose_array(message, side_of, received)
            return (replace(reading, frame=self._with_wrist(reading, message.header, received)),)
        if isinstance(message, String):
            data = message.data.encode()
            if any(word in data for word in _GLOVE_WORDS):
                return read_manus(data, gloves=self._gloves, side=side_of, received=received)
            return read_payload(data, side=side_of, received=received, layout=self._layout)
        assert isinstance(message, ManusGlove)
        return (read_glove(_as_json(message), self._gloves, side_of, received),)

    def _pose_array(self, message: PoseArray, side: Side | None, received: float) -> Reading:
        assert side is not None  # the source has a topic for each hand
        rows = pose_rows(message.poses)
        turned = not np.allclose(rows[:, 3:], (1.0, 0.0, 0.0, 0.0))  # all of them: none is known
        stamp = message.header.stamp.seconds
        frame = hand_frame(
            rows[:, :3],
            stamp=stamp if stamp else received,
            side=side,
            orientations=rows[:, 3:] if turned else None,
            layout=self._layout,
        )
        return Reading(frame, stamped=bool(stamp))

    def _with_wrist(self, reading: Reading, header: Header, received: float) -> HandFrame:
        """Add the pose of the wrist in the world to a frame."""
        frame = reading.frame
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
            if wrist is not None and _matches(wrist, reading, received):
                moved = wrist.pose[:3] + poses.rotate(wrist.pose[3:], points)
                pose = poses.wrist_from_landmarks(moved, frame.side)
        if world is None:
            return frame
        return replace(frame, T_world_wrist=pose, world=world)


def _matches(wrist: _WristPose, reading: Reading, received: float) -> bool:
    if reading.stamped and wrist.stamp:
        return abs(reading.frame.time - wrist.stamp) <= MATCH_S
    return abs(received - wrist.received) <= MATCH_S


def _as_json(message: ManusGlove) -> dict[str, object]:
    """A glove's message in the JSON form of bridges, without a stamp."""
    places = pose_rows([node.pose for node in message.raw_nodes])
    nodes = [
        {"id": node.node_id, "pos": row[:3].tolist(), "quat": row[3:].tolist()}
        for node, row in zip(message.raw_nodes, places, strict=True)
    ]
    return {"side": message.side, "glove_id": message.glove_id, "nodes": nodes}
