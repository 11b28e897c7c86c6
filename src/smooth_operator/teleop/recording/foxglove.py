"""Hand, robot and joints as Foxglove's own messages, so that a log opens in its 3D panel.

The schemas are those of https://github.com/foxglove/foxglove-sdk (``foxglove.SceneUpdate``,
``foxglove.JointStates``, ``foxglove.FrameTransforms``, ``foxglove.PoseInFrame``), which a viewer
knows by their names. They are written in addition to the project's own messages, at a bounded rate,
and are not read back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.landmarks import BONES, LANDMARKS, WRIST
from smooth_operator.teleop.recording.messages import points, pose
from smooth_operator.teleop.sinks.tick import WristCommand
from smooth_operator.types import HandFrame

RATE_HZ: Final = 30.0
"""Most messages a second on each of the topics; a viewer needs no more."""

HAND_SCENE: Final = "/foxglove/hand"
ROBOT_SCENE: Final = "/foxglove/robot"
JOINTS: Final = "/foxglove/joints"
FRAMES: Final = "/foxglove/frames"
HUMAN_WRIST: Final = "/foxglove/human_wrist"
WRIST_TARGET: Final = "/foxglove/wrist_target"
"""The wrist of the operator in the tracker's world, that of the robot hand in the robot's base."""

ROBOT_FRAME: Final = "robot"
"""The robot's palm; the root."""
TRACKER_FRAME: Final = "tracker"
"""That of the landmarks. Its place is arbitrary: the first wrist lies 0.25 m from the robot's
palm."""
_BESIDE: Final = np.array([0.25, 0.0, 0.0])  # [m]

Keypoints: TypeAlias = Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "21 3"]]
"""Joint positions [rad] to the robot's landmarks in its palm's frame [m]; NaN for those that it has
not."""
Message: TypeAlias = tuple[str, dict[str, Any]]

_PERIOD_NS: Final = round(1e9 / RATE_HZ)
_HUMAN: Final = {"r": 0.9, "g": 0.6, "b": 0.35, "a": 1.0}
_ROBOT: Final = {"r": 0.0, "g": 0.45, "b": 0.7, "a": 1.0}
_THICKNESS: Final = 0.004  # [m]
_ORIGIN: Final = {
    "position": {"x": 0.0, "y": 0.0, "z": 0.0},
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
}
_OTHER_SHAPES: Final = ("arrows", "cubes", "spheres", "cylinders", "triangles", "texts", "models")


class FoxgloveMessages:
    """Foxglove's messages of one hand and one robot, at most ``RATE_HZ`` a second.

    Args:
        keypoints: where the robot's landmarks are; None draws no robot.
    """

    def __init__(self, keypoints: Keypoints | None) -> None:
        self._keypoints = keypoints
        self._due: dict[str, int] = {}
        self._place: Float[np.ndarray, "3"] | None = None

    def hand(self, frame: HandFrame, at: int) -> Iterable[Message]:
        """Messages of a hand frame; none if the last ones were just now.

        Args:
            frame: the hand.
            at: its time [ns].
        """
        assert frame.valid is not None  # filled in by HandFrame
        wrist = frame.T_world_wrist
        if wrist is not None and np.isfinite(wrist).all() and self._is_due(HUMAN_WRIST, at):
            yield HUMAN_WRIST, _placed(wrist, frame.world or "world", at)
        if not frame.valid.any() or not self._is_due(HAND_SCENE, at):
            return
        if self._place is None and frame.valid[WRIST]:
            self._place = _BESIDE - frame.landmarks[WRIST]
        place = _BESIDE if self._place is None else self._place
        yield FRAMES, {"transforms": [_transform(place, at)]}
        yield (
            HAND_SCENE,
            _scene("human hand", TRACKER_FRAME, frame.landmarks, frame.valid, _HUMAN, at),
        )

    def wrist(self, wrist: WristCommand, at: int) -> Iterable[Message]:
        """The same for the commanded wrist."""
        if self._is_due(WRIST_TARGET, at):
            yield WRIST_TARGET, _placed(wrist.pose, wrist.world, at)

    def command(
        self, names: Sequence[str], positions: Float[np.ndarray, " n"], at: int
    ) -> Iterable[Message]:
        """The same for a command.

        Args:
            names: of the joints.
            positions: of the joints [rad].
            at: its time [ns].
        """
        if not self._is_due(JOINTS, at):
            return
        finite = np.isfinite(positions)
        states = [
            {"name": name, "position": q} if there else {"name": name}
            for name, q, there in zip(names, positions.tolist(), finite, strict=True)
        ]
        yield JOINTS, {"timestamp": _time(at), "joints": states}
        if self._keypoints is not None and finite.all():
            found = self._keypoints(positions)
            valid = np.asarray(np.isfinite(found).all(axis=1))
            yield ROBOT_SCENE, _scene("robot hand", ROBOT_FRAME, found, valid, _ROBOT, at)

    def _is_due(self, topic: str, at: int) -> bool:
        due = self._due.get(topic, at)
        if due - _PERIOD_NS <= at < due:
            return False
        # Kept up with on average; but stamps may leave a gap, or go back.
        late = min(max(at - due, 0), _PERIOD_NS // 2) if at >= due else 0
        self._due[topic] = at - late + _PERIOD_NS
        return True


def _scene(
    name: str,
    frame: str,
    landmarks: Float[np.ndarray, "21 3"],
    valid: Bool[np.ndarray, "21"],
    colour: dict[str, float],
    at: int,
) -> dict[str, Any]:
    """A skeleton as lines, one for each bone whose two ends are known."""
    place = np.cumsum(valid) - 1
    lines = {
        "type": 2,  # LINE_LIST
        "pose": _ORIGIN,
        "thickness": _THICKNESS,
        "scale_invariant": False,
        "points": points(landmarks[valid].round(6)),
        "color": colour,
        "colors": [],
        "indices": [int(place[i]) for bone in BONES if valid[list(bone)].all() for i in bone],
    }
    entity = {
        "timestamp": _time(at),
        "frame_id": frame,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "metadata": [],
        **{shape: [] for shape in _OTHER_SHAPES},
        "lines": [lines],
    }
    return {"deletions": [], "entities": [entity]}


def _placed(found: Float[np.ndarray, "7"], frame: str, at: int) -> dict[str, Any]:
    return {"timestamp": _time(at), "frame_id": frame, "pose": pose(found)}


def _transform(translation: Float[np.ndarray, "3"], at: int) -> dict[str, Any]:
    return {
        "timestamp": _time(at),
        "parent_frame_id": ROBOT_FRAME,
        "child_frame_id": TRACKER_FRAME,
        "translation": points(translation[None])[0],
        "rotation": _ORIGIN["orientation"],
    }


def _time(at: int) -> dict[str, int]:
    sec, nsec = divmod(at, 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


# Field names, types and what is required are those of Foxglove's schemas.


def _object(title: str, *optional: str, **fields: Any) -> dict[str, Any]:
    return {
        "title": title,
        "type": "object",
        "properties": fields,
        "required": [name for name in fields if name not in optional],
    }


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER: Final = {"type": "number"}
_TEXT: Final = {"type": "string"}
_TIME: Final = _object(
    "time",
    sec={"type": "integer", "minimum": 0},
    nsec={"type": "integer", "minimum": 0, "maximum": 999_999_999},
)
_DURATION: Final = _object("duration", sec={"type": "integer"}, nsec=_TIME["properties"]["nsec"])
_VECTOR: Final = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_POINT: Final = {**_VECTOR, "title": "foxglove.Point3"}
_QUATERNION: Final = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE: Final = _object("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_COLOUR: Final = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_LINES: Final = _object(
    "foxglove.LinePrimitive",
    type={
        "title": "foxglove.LineType",
        "oneOf": [
            {"title": "LINE_STRIP", "const": 0},
            {"title": "LINE_LOOP", "const": 1},
            {"title": "LINE_LIST", "const": 2},
        ],
    },
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant={"type": "boolean"},
    points=_list(_POINT),
    color=_COLOUR,
    colors=_list(_COLOUR),
    indices=_list({"type": "integer", "minimum": 0}),
)
_ENTITY: Final = _object(
    "foxglove.SceneEntity",
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_DURATION,
    frame_locked={"type": "boolean"},
    metadata=_list(_object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT)),
    **{shape: _list({"type": "object", "properties": {}}) for shape in _OTHER_SHAPES},
    lines=_list(_LINES),
)
_SCENE: Final = _object(
    "foxglove.SceneUpdate",
    deletions=_list(
        _object("foxglove.SceneEntityDeletion", timestamp=_TIME, type={"type": "integer"}, id=_TEXT)
    ),
    entities=_list(_ENTITY),
)
_STATE: Final = _object(
    "foxglove.JointState",
    *("position", "velocity", "acceleration", "effort"),
    name=_TEXT,
    position=_NUMBER,
    velocity=_NUMBER,
    acceleration=_NUMBER,
    effort=_NUMBER,
)
_PLACED: Final = _object("foxglove.PoseInFrame", timestamp=_TIME, frame_id=_TEXT, pose=_POSE)
_TRANSFORM: Final = _object(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)

SCHEMAS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    topic: (str(schema["title"]), schema)
    for topic, schema in (
        (FRAMES, _object("foxglove.FrameTransforms", transforms=_list(_TRANSFORM))),
        (HAND_SCENE, _SCENE),
        (ROBOT_SCENE, _SCENE),
        (JOINTS, _object("foxglove.JointStates", timestamp=_TIME, joints=_list(_STATE))),
        (HUMAN_WRIST, _PLACED),
        (WRIST_TARGET, _PLACED),
    )
}
"""Topic -> (schema name, JSON schema)."""


def landmark_keypoints(
    names: Sequence[str], positions: Callable[[Float[np.ndarray, " n"]], np.ndarray]
) -> Keypoints:
    """Keypoints by name as the 21 landmarks.

    Args:
        names: of the keypoints, some or all of the landmarks'.
        positions: joint positions [rad] to the keypoints, (k, 3) [m].
    """
    pairs = [(LANDMARKS.index(name), k) for k, name in enumerate(names) if name in LANDMARKS]
    rows, columns = (list(part) for part in zip(*pairs, strict=True))

    def keypoints(q: Float[np.ndarray, " n"]) -> Float[np.ndarray, "21 3"]:
        found = np.full((len(LANDMARKS), 3), math.nan)
        found[rows] = positions(q)[columns]
        return found

    return keypoints
