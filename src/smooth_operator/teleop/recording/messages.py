"""Messages of a log as Protocol Buffers: this project's own, and those for Foxglove's 3D panel.

The types are in ``proto/*.proto``, their descriptors in ``proto/messages.binpb``. Unknown numbers
are NaN, unknown lists and texts are empty, and lists of points are flat. Foxglove's messages are
written in addition to the project's own, at a limited rate, and are never read back.

Raises:
MissingExtraError: on import, if a library of the ``teleop`` extra is missing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Final, TypeAlias

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.errors import MissingExtraError
from smooth_operator.hands.hand import Hand, landmark_points
from smooth_operator.landmarks import BONES, LANDMARKS
from smooth_operator.landmarks import WRIST as WRIST_POINT
from smooth_operator.teleop.sinks.tick import WristCommand
from smooth_operator.types import HandFrame

try:
    import lz4.frame as lz4_frame
    import zstandard as zstandard
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message import DecodeError as DecodeError
    from google.protobuf.message_factory import GetMessageClass
    from mcap import reader as mcap_reader
    from mcap import records as mcap_records
    from mcap import stream_reader as mcap_stream
    from mcap import writer as mcap_writer
    from mcap.exceptions import McapError as McapError
except ModuleNotFoundError as error:
    raise MissingExtraError("an MCAP log", "teleop") from error

__all__ = ["lz4_frame", "mcap_reader", "mcap_records", "mcap_stream", "mcap_writer"]

VERSION: Final = "3"
"""Version of the messages, in the metadata of every channel. It is raised by changes that readers
must know about."""

HAND: Final = "/hand"
COMMAND: Final = "/command"
STATUS: Final = "/status"
TIMING: Final = "/timing"
LOOP: Final = "/loop"
"""Topic of the loop's states; only in logs of a live loop."""
STATE: Final = "/state"
"""Topic of measured states; only in logs of a live loop whose hand is measured."""
ARM: Final = "/arm"
"""Topic of arm commands; only if an arm carries the robot hand."""
WRIST: Final = "/wrist"
"""Topic of wrist commands; only if the wrist of the robot hand was commanded."""
CONFIG: Final = "/config"

HAND_SCENE: Final = "/foxglove/hand"
ROBOT_SCENE: Final = "/foxglove/robot"
JOINTS: Final = "/foxglove/joints"
FRAMES: Final = "/foxglove/frames"
HUMAN_WRIST: Final = "/foxglove/human_wrist"
WRIST_TARGET: Final = "/foxglove/wrist_target"
"""Topic with the robot's target wrist pose in the frame of the robot's base, for Foxglove."""

ORIGIN: Final = "smooth_operator.origin"
"""Name of the metadata record that states the log's origin: ``name``, ``task``, ``meta``."""

METHOD: Final = "smooth_operator.method"
"""Name of the metadata record for each method: ``stamp`` of its first command, ``method``,
``preset``, ``config`` (JSON)."""

LIVE: Final = (ARM, LOOP, STATE, WRIST)
"""Topics that only the logs of a live loop have."""

OF_COMMANDS: Final = frozenset((TIMING, STATUS, LOOP, WRIST, ARM))
"""Topics with at most one message for each command, with its sequence number."""

SCHEMAS: Final = {
    topic: f"smooth_operator.{topic[1:].capitalize()}"
    for topic in (HAND, COMMAND, STATUS, TIMING, LOOP, STATE, WRIST, ARM, CONFIG)
}
"""Topic -> full name of its message type."""

FOXGLOVE: Final = {
    FRAMES: "foxglove.FrameTransforms",
    HAND_SCENE: "foxglove.SceneUpdate",
    ROBOT_SCENE: "foxglove.SceneUpdate",
    JOINTS: "foxglove.JointStates",
    HUMAN_WRIST: "foxglove.PoseInFrame",
    WRIST_TARGET: "foxglove.PoseInFrame",
}
"""Topic that Foxglove draws -> full name of its message type. Nothing reads them back."""

_FILES: Final = FileDescriptorSet.FromString(
    files("smooth_operator.teleop.recording").joinpath("proto/messages.binpb").read_bytes()
)
_POOL: Final = DescriptorPool()  # another package may have Foxglove's types in the common pool
for _file in _FILES.file:
    _POOL.AddSerializedFile(_file.SerializeToString())


@cache
def message_class(name: str) -> Any:
    """Returns the class of a message, given its full name."""
    return GetMessageClass(_POOL.FindMessageTypeByName(name))


def schema_data(name: str) -> bytes:
    """Definition of a message and of the messages that it contains, as a ``FileDescriptorSet``."""
    by_name = {file.name: file for file in _FILES.file}
    needed = [by_name[message_class(name).DESCRIPTOR.file.name]]
    for file in needed:  # the list grows
        needed += [by_name[other] for other in file.dependency]
    return bytes(FileDescriptorSet(file=reversed(needed)).SerializeToString(deterministic=True))


@dataclass(frozen=True)
class LoopState:
    """State of the loop at the time of one command.

    Attributes:
        number: number of the tick, counted from 0.
        mode: mode of the loop, such as ``tracking`` or ``holding``.
        time: time of the command, by the loop's clock [s].
        received: time of arrival of the command's frame, by the loop's clock [s]; None without one.
        tracker_stamp: stamp of that frame, by the tracker's clock [s]; None without a frame.
        session: number of the tracker's session; None without a frame.
        tracking_loss: loss of the method for that frame; NaN without a frame.
        scale: ratio of robot size to human size; NaN without a frame.
        events: events of the tick, one sentence each.
    """

    number: int
    mode: str
    time: float
    received: float | None = None
    tracker_stamp: float | None = None
    session: int | None = None
    tracking_loss: float = math.nan
    scale: float = math.nan
    events: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class LoopTrack:
    """States of the loop at the T commands of a log.

    Attributes:
        numbers: (T,) numbers of the ticks; -1 if unknown.
        modes: (T,) modes of the loop; empty if unknown.
        times: (T,) times of the commands, by the loop's clock [s].
        received: (T,) times of arrival of the commands' frames [s]; NaN without a frame.
        tracker_stamps: (T,) stamps of the frames by the tracker's clock [s], or NaN.
        tracking_loss: (T,) losses of the method for the frames, or NaN.
        scale: (T,) ratios of robot size to human size, or NaN.
        events: index of a command -> its events.
    """

    numbers: Int[np.ndarray, " T"]
    modes: tuple[str, ...]
    times: Float[np.ndarray, " T"]
    received: Float[np.ndarray, " T"]
    tracker_stamps: Float[np.ndarray, " T"]
    tracking_loss: Float[np.ndarray, " T"]
    scale: Float[np.ndarray, " T"]
    events: Mapping[int, tuple[str, ...]]

    @property
    def answers(self) -> Bool[np.ndarray, " T"]:
        """(T,) True for commands that were computed from a frame."""
        return np.asarray(np.isfinite(self.received))


RATE_HZ: Final = 30.0
"""Maximum rate of messages on each Foxglove topic [Hz]; a viewer needs no more."""

ROBOT_FRAME: Final = "robot"
"""Root frame: the robot's palm."""
TRACKER_FRAME: Final = "tracker"
"""Frame of the landmarks, placed so that the first wrist is 0.25 m from the robot's palm."""
_OFFSET: Final = np.array([0.25, 0.0, 0.0])  # first wrist in the robot's palm frame [m]

Keypoints: TypeAlias = Callable[[Float[np.ndarray, "k n"]], Float[np.ndarray, "k 21 3"]]
"""Function from joint positions [rad] to the robot's landmarks in its palm frame [m]. Landmarks
that the robot does not have are NaN at all positions."""

_PERIOD_NS: Final = round(1e9 / RATE_HZ)
_LOOKS: Final = {
    HAND_SCENE: ("human hand", TRACKER_FRAME, (0.9, 0.6, 0.35, 1.0)),
    ROBOT_SCENE: ("robot hand", ROBOT_FRAME, (0.0, 0.45, 0.7, 1.0)),
}
"""Topic -> name, frame and colour (red, green, blue, opacity) of the skeleton that it draws."""
_THICKNESS: Final = 0.004  # [m]
_LINE_LIST: Final = 2


class FoxgloveMessages:
    """Builds Foxglove's messages for one hand and one robot, at most ``RATE_HZ`` per second.

    Each method returns the topics and messages for one moment.

    Args:
        keypoints: computes the robot's landmarks from its joint positions; None draws no robot.
    """

    def __init__(self, keypoints: Keypoints | None) -> None:
        self._keypoints = keypoints
        self._due: dict[str, int] = {}
        self._place: Float[np.ndarray, "3"] | None = None  # of the tracker in the robot's frame

    def hand(self, frame: HandFrame, at: int) -> list[tuple[str, Any]]:
        """Returns the messages for a hand frame.

        Args:
            at: time of the frame [ns].
        """
        assert frame.valid is not None  # filled in by HandFrame
        messages, wrist = [], frame.T_world_wrist
        finite = wrist is not None and all(map(math.isfinite, wrist.tolist()))
        if wrist is not None and finite and self._is_due(HUMAN_WRIST, at):
            messages.append(_pose_message(HUMAN_WRIST, at, wrist, frame.world or "world"))
        if any(frame.valid.tolist()) and self._is_due(HAND_SCENE, at):
            place = self._place
            if place is None and frame.valid[WRIST_POINT]:
                place = self._place = _OFFSET - frame.landmarks[WRIST_POINT]
            messages.append(_frame_message(at, _OFFSET if place is None else place))
            messages.append(_scene_message(HAND_SCENE, at, frame.landmarks, frame.valid))
        return messages

    def wrist(self, wrist: WristCommand, at: int) -> list[tuple[str, Any]]:
        """Returns the messages for a wrist command."""
        if not self._is_due(WRIST_TARGET, at):
            return []
        return [_pose_message(WRIST_TARGET, at, wrist.pose, wrist.world)]

    def command(
        self, names: tuple[str, ...], positions: Float[np.ndarray, " n"], at: int
    ) -> list[tuple[str, Any]]:
        """Returns the messages for a command.

        Args:
            positions: joint positions [rad].
            at: its time [ns].
        """
        if not self._is_due(JOINTS, at):
            return []
        joints = [
            {"name": name, **({"position": q} if math.isfinite(q) else {})}
            for name, q in zip(names, positions.tolist(), strict=True)
        ]
        messages = [_message(JOINTS, timestamp=_time(at), joints=joints)]
        if self._keypoints is not None and np.isfinite(positions).all():
            (landmarks,) = self._keypoints(positions[None])
            valid = np.isfinite(landmarks).all(axis=1)
            messages.append(_scene_message(ROBOT_SCENE, at, landmarks, valid))
        return messages

    def _is_due(self, topic: str, at: int) -> bool:
        due = self._due.get(topic, at)
        if due - _PERIOD_NS <= at < due:
            return False
        # Keeps the mean rate, although stamps may have gaps or go back.
        late = min(max(at - due, 0), _PERIOD_NS // 2) if at >= due else 0
        self._due[topic] = at - late + _PERIOD_NS
        return True


def _message(topic: str, **fields: Any) -> tuple[str, Any]:
    return topic, message_class(FOXGLOVE[topic])(**fields)


def _time(at: int) -> dict[str, int]:
    return dict(zip(("seconds", "nanos"), divmod(at, 1_000_000_000), strict=True))


def _pose_message(topic: str, at: int, pose: Float[np.ndarray, "7"], frame: str) -> tuple[str, Any]:
    return _message(topic, timestamp=_time(at), frame_id=frame, pose=_pose(pose))


def _frame_message(at: int, translation: Float[np.ndarray, "3"]) -> tuple[str, Any]:
    transform = {
        "timestamp": _time(at),
        "parent_frame_id": ROBOT_FRAME,
        "child_frame_id": TRACKER_FRAME,
        "translation": dict(zip("xyz", translation.tolist(), strict=True)),
        "rotation": {"w": 1.0},
    }
    return _message(FRAMES, transforms=[transform])


def _scene_message(
    topic: str, at: int, landmarks: Float[np.ndarray, "21 3"], valid: Bool[np.ndarray, "21"]
) -> tuple[str, Any]:
    """Skeleton with a line for each bone whose two ends are valid."""
    name, frame, colour = _LOOKS[topic]
    place = np.cumsum(valid) - 1
    rows = landmarks[valid].astype(np.float32)  # exact enough, and compresses better
    line = {
        "type": _LINE_LIST,
        "pose": _pose(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])),
        "thickness": _THICKNESS,
        "points": [dict(zip("xyz", row, strict=True)) for row in rows.tolist()],
        "color": dict(zip("rgba", colour, strict=True)),
        "indices": [place[i] for bone in BONES if valid[list(bone)].all() for i in bone],
    }
    head = {"timestamp": _time(at), "frame_id": frame, "id": name, "frame_locked": True}
    return _message(topic, entities=[{**head, "lines": [line]}])


def _pose(pose: Float[np.ndarray, "7"]) -> dict[str, dict[str, float]]:
    values = pose.tolist()
    return {
        "position": dict(zip("xyz", values[:3], strict=True)),
        "orientation": dict(zip("wxyz", values[3:], strict=True)),
    }


def landmark_keypoints(hand: Hand) -> Keypoints:
    """Returns a function from joint positions to landmarks, which takes 10 us with MuJoCo."""
    model, data = hand.model, mujoco.MjData(hand.model)
    points = {
        LANDMARKS.index(name): point
        for name, point in landmark_points(model, hand.spec).items()
        if name in LANDMARKS
    }
    columns = list(points)
    palm = model.body(hand.spec.palm).id
    bodies = np.array([palm, *(body for body, _ in points.values())])
    local = np.array([np.zeros(3), *(place for _, place in points.values())])

    position, xpos, xmat = data.qpos, data.xpos, data.xmat  # views

    def keypoints(q: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k 21 3"]:
        places = np.empty((len(q), len(bodies), 3))
        turns = np.empty((len(q), len(bodies), 9))
        for qpos, place, turn in zip(hand.qpos(q), places, turns, strict=True):
            position[:] = qpos
            mujoco.mj_kinematics(model, data)
            xpos.take(bodies, 0, place)
            xmat.take(bodies, 0, turn)
        matrices = turns.reshape(*turns.shape[:2], 3, 3)
        places += (matrices @ local[:, :, None])[..., 0]
        landmarks = np.full((len(q), len(LANDMARKS), 3), math.nan)
        # In the frame of the palm, which is the first body.
        landmarks[:, columns] = (places[:, 1:] - places[:, :1]) @ matrices[:, 0]
        return landmarks

    return keypoints
