"""Hand, robot and joints as Foxglove's own messages, so that a log opens in its 3D panel.

They are written in addition to the project's own messages, at a bounded rate, and are not read
back. Their types are those of ``foxglove_types.py``, whose numbers of fields stand here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import groupby, repeat
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.landmarks import BONES, LANDMARKS, WRIST
from smooth_operator.teleop.recording.foxglove_types import (
    FRAMES,
    HAND_SCENE,
    HUMAN_WRIST,
    JOINTS,
    ROBOT_SCENE,
    WRIST_TARGET,
)
from smooth_operator.teleop.recording.wire import (
    double_key,
    head,
    pack_double,
    part,
    text,
    time,
    whole,
)
from smooth_operator.teleop.sinks.tick import WristCommand
from smooth_operator.types import HandFrame

RATE_HZ: Final = 30.0
"""Most messages a second on each of the topics; a viewer needs no more."""

ROBOT_FRAME: Final = "robot"
"""The robot's palm; the root."""
TRACKER_FRAME: Final = "tracker"
"""That of the landmarks. Its place is arbitrary: the first wrist lies 0.25 m from the robot's
palm."""
_BESIDE: Final = np.array([0.25, 0.0, 0.0])  # [m]

# A Point3 as field 5 of LinePrimitive: what stands before each number is the same in all.
_POINT: Final = np.dtype(
    [("head", "<u2"), *((f"{k}{v}", t) for v in "xyz" for k, t in (("key_", "u1"), ("", "<f8")))]
)
_POINTS: Final = np.zeros(len(LANDMARKS), _POINT)
_POINTS["head"] = int.from_bytes(head(5, 27), "little")
for _axis, _key in enumerate(("key_x", "key_y", "key_z"), 1):
    _POINTS[_key] = double_key(_axis)

Keypoints: TypeAlias = Callable[[Float[np.ndarray, "k n"]], Float[np.ndarray, "k 21 3"]]
"""Joint positions [rad] to the robot's landmarks in its palm's frame [m]; NaN for those that it has
not, which are the same at all positions."""

_PERIOD_NS: Final = round(1e9 / RATE_HZ)
_HUMAN: Final = (0.9, 0.6, 0.35, 1.0)
_ROBOT: Final = (0.0, 0.45, 0.7, 1.0)
_THICKNESS: Final = 0.004  # [m]
_LINE_LIST: Final = 2


class Message(NamedTuple):
    """A message: its topic, its time [ns] and its bytes."""

    topic: str
    at: int
    data: bytes


class FoxgloveMessages:
    """Foxglove's messages of one hand and one robot, at most ``RATE_HZ`` a second.

    They are gathered, and the skeletons of many frames and commands made in one call.

    Args:
        keypoints: where the robot's landmarks are; None draws no robot.
    """

    def __init__(self, keypoints: Keypoints | None) -> None:
        self._keypoints = keypoints
        self._due: dict[str, int] = {}
        self._place: bytes | None = None  # of the tracker's frame
        self._messages: list[Message] = []
        self._hands: list[tuple[int, np.ndarray, bytes]] = []  # times, landmarks, whether valid
        self._robot: list[tuple[int, np.ndarray]] = []  # times and joint positions

    def hand(self, frame: HandFrame, at: int) -> None:
        """Take a hand frame, unless the last one was just now.

        Args:
            frame: the hand.
            at: its time [ns].
        """
        assert frame.valid is not None  # filled in by HandFrame
        wrist = frame.T_world_wrist
        known = wrist is not None and all(map(math.isfinite, wrist.tolist()))
        if wrist is not None and known and self._is_due(HUMAN_WRIST, at):
            self._add(HUMAN_WRIST, at, _placed(wrist, frame.world or "world", at))
        if not any(frame.valid.tolist()) or not self._is_due(HAND_SCENE, at):
            return
        if self._place is None and frame.valid[WRIST]:
            self._place = _transform(_BESIDE - frame.landmarks[WRIST])
        place = self._place or _transform(_BESIDE)
        self._add(FRAMES, at, part(1, time(1, at) + place))
        self._hands.append((at, frame.landmarks.copy(), frame.valid.tobytes()))

    def wrist(self, wrist: WristCommand, at: int) -> None:
        """The same for the commanded wrist."""
        if self._is_due(WRIST_TARGET, at):
            self._add(WRIST_TARGET, at, _placed(wrist.pose, wrist.world, at))

    def command(self, names: tuple[str, ...], positions: Float[np.ndarray, " n"], at: int) -> None:
        """The same for a command.

        Args:
            names: of the joints.
            positions: of the joints [rad].
            at: its time [ns].
        """
        if not self._is_due(JOINTS, at):
            return
        values = positions.tolist()
        finite = all(map(math.isfinite, values))
        if finite:
            pairs = zip(_joint_heads(names), values, strict=True)
            joints = b"".join(before + pack_double(_POSITION, q) for before, q in pairs)
        else:
            joints = b"".join(_joint(name, q) for name, q in zip(names, values, strict=True))
        self._add(JOINTS, at, time(1, at) + joints)
        if self._keypoints is not None and finite:
            self._robot.append((at, positions.copy()))

    def take(self) -> list[Message]:
        """The messages since the last call, by topic in order of time."""
        hands, self._hands = self._hands, []
        robot, self._robot = self._robot, []  # first, so that an error comes once
        for valid, group in groupby(hands, lambda hand: hand[2]):
            times, points, _ = zip(*group, strict=True)
            scenes = _scenes("human hand", TRACKER_FRAME, times, np.array(points), valid, _HUMAN)
            self._messages += map(Message, repeat(HAND_SCENE), times, scenes)
        if robot and self._keypoints is not None:
            times, positions = zip(*robot, strict=True)
            found = self._keypoints(np.array(positions))
            valid = np.asarray(np.isfinite(found[0]).all(axis=1)).tobytes()  # the same for all
            scenes = _scenes("robot hand", ROBOT_FRAME, times, found, valid, _ROBOT)
            self._messages += map(Message, repeat(ROBOT_SCENE), times, scenes)
        messages, self._messages = self._messages, []
        return messages

    def _add(self, topic: str, at: int, data: bytes) -> None:
        self._messages.append(Message(topic, at, data))

    def _is_due(self, topic: str, at: int) -> bool:
        due = self._due.get(topic, at)
        if due - _PERIOD_NS <= at < due:
            return False
        # Kept up with on average; but stamps may leave a gap, or go back.
        late = min(max(at - due, 0), _PERIOD_NS // 2) if at >= due else 0
        self._due[topic] = at - late + _PERIOD_NS
        return True


def _scenes(
    name: str,
    frame: str,
    times: Sequence[int],
    landmarks: Float[np.ndarray, "k 21 3"],
    valid: bytes,
    colour: tuple[float, ...],
) -> Iterator[bytes]:
    """A skeleton at some times, each as lines, one for each bone whose two ends are known.

    Single precision is enough to draw, and is packed better.
    """
    before, after = _line(valid, colour)
    entity = _entity(name, frame)
    known = landmarks[:, np.frombuffer(valid, bool)].astype(np.float32)
    rows = np.tile(_POINTS[: known.shape[1]], (len(known), 1))
    rows["x"], rows["y"], rows["z"] = np.moveaxis(known, 2, 0)
    for at, points in zip(times, rows, strict=True):
        line = part(11, b"".join((before, points.tobytes(), after)))
        yield part(2, b"".join((time(1, at), entity, line)))


@lru_cache(maxsize=256)
def _line(valid: bytes, colour: tuple[float, ...]) -> tuple[bytes, bytes]:
    """What stands before and after the points of a skeleton."""
    there = np.frombuffer(valid, bool)
    place = np.cumsum(there) - 1
    ends = [place[i] for bone in BONES if there[list(bone)].all() for i in bone]
    before = b"".join(
        (
            whole(1, _LINE_LIST),
            part(2, _pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))),
            pack_double(double_key(3), _THICKNESS),
            whole(4, 0),
        )
    )
    after = part(6, _numbers(colour)) + part(8, np.array(ends, "<u4").tobytes())
    return before, after


@lru_cache(maxsize=8)
def _entity(name: str, frame: str) -> bytes:
    """Frame, name, no lifetime, and that it moves with its frame."""
    return text(2, frame) + text(3, name) + part(4, b"") + whole(5, 1)


_POSITION: Final = double_key(2)


@lru_cache(maxsize=8)
def _joint_heads(names: tuple[str, ...]) -> tuple[bytes, ...]:
    """What stands before the position of each joint, which is its last field of 9 bytes."""
    named = [text(1, name) for name in names]
    return tuple(head(2, len(one) + 9) + one for one in named)


def _joint(name: str, position: float) -> bytes:
    """A joint whose position may be unknown."""
    known = pack_double(_POSITION, position) if math.isfinite(position) else b""
    return part(2, text(1, name) + known)


def _placed(found: Float[np.ndarray, "7"], frame: str, at: int) -> bytes:
    return time(1, at) + text(2, frame) + part(3, _pose(found[:3], found[3:]))


def _transform(translation: Float[np.ndarray, "3"]) -> bytes:
    """From the robot's frame to the tracker's: a ``FrameTransform`` without its time."""
    return b"".join(
        (
            text(2, ROBOT_FRAME),
            text(3, TRACKER_FRAME),
            part(4, _numbers(translation)),
            part(5, _numbers((0.0, 0.0, 0.0, 1.0))),
        )
    )


def _pose(position: Float[np.ndarray, "3"], wxyz: Float[np.ndarray, "4"]) -> bytes:
    return part(1, _numbers(position)) + part(2, _numbers(np.roll(wxyz, -1)))


def _numbers(values: Sequence[float] | np.ndarray) -> bytes:
    """A message whose fields are numbers, from the first on."""
    return b"".join(pack_double(double_key(k), float(x)) for k, x in enumerate(values, 1))
