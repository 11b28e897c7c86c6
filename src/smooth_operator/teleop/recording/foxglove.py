"""Hand, robot and joints as Foxglove's messages, so that a log opens in its 3D panel.

They are written in addition to the project's own messages, at a bounded rate, and never read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from typing import Any, Final, NamedTuple, TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand, landmark_points
from smooth_operator.landmarks import BONES, LANDMARKS, WRIST
from smooth_operator.teleop.recording.log_types import (
    FOXGLOVE,
    FRAMES,
    HAND_SCENE,
    HUMAN_WRIST,
    JOINTS,
    ROBOT_SCENE,
    WRIST_TARGET,
    message_class,
)
from smooth_operator.teleop.sinks.tick import WristCommand
from smooth_operator.types import HandFrame

RATE_HZ: Final = 30.0
"""Most messages a second on each of the topics; a viewer needs no more."""

ROBOT_FRAME: Final = "robot"
"""The robot's palm; the root."""
TRACKER_FRAME: Final = "tracker"
"""The frame of the landmarks. Its place is arbitrary: the first wrist lies 0.25 m from the robot's
palm."""
_OFFSET: Final = np.array([0.25, 0.0, 0.0])  # of the first wrist from the robot's palm [m]

Keypoints: TypeAlias = Callable[[Float[np.ndarray, "k n"]], Float[np.ndarray, "k 21 3"]]
"""Joint positions [rad] to the robot's landmarks in its palm's frame [m]; NaN for those that it has
not, which are the same at all positions."""

_PERIOD_NS: Final = round(1e9 / RATE_HZ)
_LOOKS: Final = {
    HAND_SCENE: ("human hand", TRACKER_FRAME, (0.9, 0.6, 0.35, 1.0)),
    ROBOT_SCENE: ("robot hand", ROBOT_FRAME, (0.0, 0.45, 0.7, 1.0)),
}
"""Topic -> name, frame and colour (red, green, blue, opacity) of its skeleton."""
_MOST_SCENES: Final = 64
_THICKNESS: Final = 0.004  # [m]
_LINE_LIST: Final = 2


class Message(NamedTuple):
    """A message: its topic, its time [ns] and its bytes."""

    topic: str
    at: int
    data: bytes


class FoxgloveMessages:
    """Foxglove's messages of one hand and one robot, at most ``RATE_HZ`` a second.

    They are collected, and the skeletons of many frames and commands are made in one call.

    Args:
        keypoints: computes the robot's landmarks from its joint positions; None draws no robot.
    """

    def __init__(self, keypoints: Keypoints | None) -> None:
        self._keypoints = keypoints
        self._due: dict[str, int] = {}
        self._transform: Any = None  # from the robot's frame to the tracker's
        self._joints: Any = None
        self._messages: list[Message] = []
        self._hands: list[tuple[int, np.ndarray, bytes]] = []  # times, landmarks, whether valid
        self._robot: list[tuple[int, np.ndarray]] = []  # times and joint positions
        self._scenes: dict[tuple[str, bytes], _Scene] = {}

    def hand(self, frame: HandFrame, at: int) -> None:
        """Add a hand frame, if the rate allows.

        Args:
            at: time of the frame [ns].
        """
        assert frame.valid is not None  # filled in by HandFrame
        wrist = frame.T_world_wrist
        finite = wrist is not None and all(map(math.isfinite, wrist.tolist()))
        if wrist is not None and finite and self._is_due(HUMAN_WRIST, at):
            self._add_pose(HUMAN_WRIST, at, wrist, frame.world or "world")
        if not any(frame.valid.tolist()) or not self._is_due(HAND_SCENE, at):
            return
        transform = self._transform
        if transform is None:
            wrist_known = frame.valid[WRIST]
            place = _OFFSET - frame.landmarks[WRIST] if wrist_known else _OFFSET
            transform = _frame_transform(place)
            self._transform = transform if wrist_known else None
        _set_time(transform.transforms[0].timestamp, at)
        self._add(FRAMES, at, transform)
        self._hands.append((at, frame.landmarks.copy(), frame.valid.tobytes()))

    def wrist(self, wrist: WristCommand, at: int) -> None:
        """Add a wrist command; see ``hand``."""
        if self._is_due(WRIST_TARGET, at):
            self._add_pose(WRIST_TARGET, at, wrist.pose, wrist.world)

    def command(self, names: tuple[str, ...], positions: Float[np.ndarray, " n"], at: int) -> None:
        """Add a command; see ``hand``.

        Args:
            positions: joint positions [rad].
            at: its time [ns].
        """
        if not self._is_due(JOINTS, at):
            return
        if self._joints is None:
            self._joints = message_class(FOXGLOVE[JOINTS])(joints=[{"name": n} for n in names])
        _set_time(self._joints.timestamp, at)
        values = positions.tolist()
        for joint, position in zip(self._joints.joints, values, strict=True):
            if math.isfinite(position):
                joint.position = position
            else:
                joint.ClearField("position")
        self._add(JOINTS, at, self._joints)
        if self._keypoints is not None and all(map(math.isfinite, values)):
            self._robot.append((at, positions.copy()))

    def take(self) -> list[Message]:
        """The messages since the last call, by topic in order of time."""
        hands, self._hands = self._hands, []
        robot, self._robot = self._robot, []  # first, so that an error comes once
        for valid, group in groupby(hands, lambda hand: hand[2]):
            times, points, _ = zip(*group, strict=True)
            self._messages += self._scene(HAND_SCENE, valid).messages(times, np.array(points))
        if robot and self._keypoints is not None:
            times, positions = zip(*robot, strict=True)
            landmarks = self._keypoints(np.array(positions))
            valid = np.asarray(np.isfinite(landmarks[0]).all(axis=1)).tobytes()  # same for all
            self._messages += self._scene(ROBOT_SCENE, valid).messages(times, landmarks)
        messages, self._messages = self._messages, []
        return messages

    def _scene(self, topic: str, valid: bytes) -> _Scene:
        scene = self._scenes.get((topic, valid))
        if scene is None:
            if len(self._scenes) >= _MOST_SCENES:
                self._scenes.clear()
            scene = self._scenes[topic, valid] = _Scene(topic, valid)
        return scene

    def _add(self, topic: str, at: int, message: Any) -> None:
        self._messages.append(Message(topic, at, message.SerializeToString()))

    def _add_pose(self, topic: str, at: int, pose: Float[np.ndarray, "7"], frame: str) -> None:
        message = message_class(FOXGLOVE[topic])(frame_id=frame, pose=_pose(pose))
        _set_time(message.timestamp, at)
        self._add(topic, at, message)

    def _is_due(self, topic: str, at: int) -> bool:
        due = self._due.get(topic, at)
        if due - _PERIOD_NS <= at < due:
            return False
        # Kept up with on average; but stamps may leave a gap, or go back.
        late = min(max(at - due, 0), _PERIOD_NS // 2) if at >= due else 0
        self._due[topic] = at - late + _PERIOD_NS
        return True


class _Scene:
    """A skeleton as lines, one for each bone whose two ends are known.

    The message is made once, and filled with the points and the time of each frame.
    """

    def __init__(self, topic: str, valid: bytes) -> None:
        self._topic = topic
        name, frame, colour = _LOOKS[topic]
        self._valid = np.frombuffer(valid, bool)
        place = np.cumsum(self._valid) - 1
        ends = [place[i] for bone in BONES if self._valid[list(bone)].all() for i in bone]
        line = {
            "type": _LINE_LIST,
            "pose": _pose(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])),
            "thickness": _THICKNESS,
            "points": [{}] * int(self._valid.sum()),
            "color": dict(zip("rgba", colour, strict=True)),
            "indices": ends,
        }
        entity = {"frame_id": frame, "id": name, "frame_locked": True, "lines": [line]}
        self._message = message_class(FOXGLOVE[HAND_SCENE])(entities=[entity])
        self._timestamp = self._message.entities[0].timestamp
        self._points = list(self._message.entities[0].lines[0].points)

    def messages(
        self, times: Sequence[int], landmarks: Float[np.ndarray, "k 21 3"]
    ) -> Iterator[Message]:
        """The skeleton at some times [ns]."""
        rows = landmarks[:, self._valid].astype(np.float32)  # enough to draw, and packed better
        for at, row in zip(times, rows.tolist(), strict=True):
            _set_time(self._timestamp, at)
            for point, (x, y, z) in zip(self._points, row, strict=True):
                point.x, point.y, point.z = x, y, z
            yield Message(self._topic, at, self._message.SerializeToString())


def _set_time(timestamp: Any, at: int) -> None:
    timestamp.seconds, timestamp.nanos = divmod(at, 1_000_000_000)


def _frame_transform(translation: Float[np.ndarray, "3"]) -> Any:
    transform = {
        "parent_frame_id": ROBOT_FRAME,
        "child_frame_id": TRACKER_FRAME,
        "translation": dict(zip("xyz", translation.tolist(), strict=True)),
        "rotation": {"w": 1.0},
    }
    return message_class(FOXGLOVE[FRAMES])(transforms=[transform])


def _pose(pose: Float[np.ndarray, "7"]) -> dict[str, dict[str, float]]:
    values = pose.tolist()
    return {
        "position": dict(zip("xyz", values[:3], strict=True)),
        "orientation": dict(zip("wxyz", values[3:], strict=True)),
    }


def landmark_keypoints(hand: Hand) -> Keypoints:
    """Positions of a hand's landmarks, by MuJoCo: one pose takes some 10 us.

    ``hand.tree`` gives the same, and is made for thousands of poses in one call.
    """
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

    position, xpos, xmat = data.qpos, data.xpos, data.xmat  # views, which stay

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
        # in the palm's frame, whose body comes first
        landmarks[:, columns] = (places[:, 1:] - places[:, :1]) @ matrices[:, 0]
        return landmarks

    return keypoints
