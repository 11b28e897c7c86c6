"""Encoders of the native headset apps, written from their formats; no code of the readers is used.

``Pose`` and landmarks are in the project's conventions: z up, x forward, y left, the wrist's x to
the fingers and z out of the back of the hand. Each encoder turns them into its app's own frame.
"""

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import Side

Pose = Sequence[float]
"""x y z [m] and unit quaternion w x y z."""


def turn(q: Sequence[float]) -> np.ndarray:
    """The rotation matrix of a unit quaternion wxyz, by the textbook."""
    w, x, y, z = (float(v) for v in q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def hand(side: Side, seed: int = 2) -> np.ndarray:
    """(25, 3) joints of a hand in its wrist's axes [m], WebXR's order; a left one is mirrored."""
    frame = next(SyntheticOperator(seed=seed).frames())
    points = np.zeros((25, 3))
    points[[0, *range(1, 5), *(5 * f + k for f in range(1, 5) for k in range(1, 5))]] = (
        frame.landmarks
    )
    points[[5, 10, 15, 20]] = frame.metacarpals
    points -= points[0]
    # x to the middle finger's base, z out of the back: from the right hand's wrist, index, pinky
    x = points[11] / np.linalg.norm(points[11])
    back = np.cross(points[21], points[6])
    z = back - (back @ x) * x
    z /= np.linalg.norm(z)
    local = points @ np.stack([x, np.cross(z, x), z], axis=1)
    return local if side == "right" else local * np.array([1.0, -1.0, 1.0])


def landmarks(joints: np.ndarray) -> np.ndarray:
    """(21, 3) of (25, 3)."""
    return joints[[0, 1, 2, 3, 4, 6, 7, 8, 9, 11, 12, 13, 14, 16, 17, 18, 19, 21, 22, 23, 24]]


# Hand Tracking Streamer: Unity's axes (x right, y up, z forward, left-handed), lines of text.


def unity_point(p: Any) -> tuple[float, float, float]:
    return (-p[1], p[2], p[0])


def unity_turn(q: Any) -> tuple[float, float, float, float]:
    """xyzw. An axis of rotation is a pseudo-vector: a mirror image turns it the other way."""
    w, x, y, z = q
    return (y, -z, -x, w)


def hts_wrist(side: Side, pose: Pose, meta: str = "") -> bytes:
    numbers = [f"{v:.4f}" for v in unity_point(pose)] + [f"{v:.3f}" for v in unity_turn(pose[3:])]
    return f"{side.title()} wrist{meta}:, {', '.join(numbers)}".encode()


def hts_landmarks(side: Side, points: np.ndarray, meta: str = "") -> bytes:
    numbers = [f"{v:.4f}" for p in points for v in unity_point(p)]
    return f"{side.title()} landmarks{meta}:, {', '.join(numbers)}".encode()


def hts_packet(side: Side, pose: Pose, points: np.ndarray, meta: str = "") -> bytes:
    """What the app sends for a hand: a datagram; over TCP a line break follows."""
    return hts_wrist(side, pose, meta) + b"\n" + hts_landmarks(side, points, meta)


# XRoboToolkit: OpenXR's axes (x right, y up, z to the wearer), packets with JSON in JSON.


def openxr_point(p: Any) -> tuple[float, float, float]:
    return (-p[1], p[2], -p[0])


def openxr_turn(q: Any) -> tuple[float, float, float, float]:
    """xyzw."""
    w, x, y, z = q
    return (-y, z, -x, w)


def pico_hand(pose: Pose, joints: np.ndarray, active: int = 1, flags: int = 15) -> dict[str, Any]:
    """26 joints: the palm, then those of WebXR, all turned as the wrist."""
    palm = (joints[10] + joints[11]) / 2
    world = np.vstack([palm, joints]) @ turn(pose[3:]).T + np.asarray(pose[:3])
    words = [
        ",".join(str(np.float32(v)) for v in (*openxr_point(p), *openxr_turn(pose[3:])))
        for p in world
    ]
    locations = [{"p": word, "s": flags, "r": 0.01} for word in words]
    return {"isActive": active, "count": 26, "scale": 1.0, "HandJointLocations": locations}


def pico_packet(command: int, body: bytes, unix_ms: int = 1_732_613_438_765) -> bytes:
    return struct.pack("<BBI", 0x3F, command, len(body)) + body + struct.pack("<qB", unix_ms, 0xA5)


def pico_tracking(hands: dict[str, Any], stamp_ns: int | None, nested: bool = True) -> bytes:
    value: Any = {"predictTime": 12.5, "appState": {"focus": True}, "Hand": hands, "Input": 2}
    if stamp_ns is not None:
        value["timeStampNs"] = stamp_ns
    value = json.dumps(value) if nested else value
    return pico_packet(0x6D, json.dumps({"functionName": "Tracking", "value": value}).encode())


# Tracking Streamer: ARKit's axes (the world as OpenXR's), 4 x 4 transforms.

_OPENXR = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
_ANCHOR: dict[Side, np.ndarray] = {
    # the wrist's x, y, z in ours: to the forearm, out of the back, to the thumb (and its mirror
    # image, turned by half a turn: to the fingers, out of the palm, to the little finger)
    "right": np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),
    "left": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}


def transform(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, position
    return out


def arkit_wrist(side: Side, pose: Pose) -> np.ndarray:
    """From the anchor to ARKit's world."""
    return transform(_OPENXR @ turn(pose[3:]) @ _ANCHOR[side].T, _OPENXR @ np.asarray(pose[:3]))


def arkit_joints(side: Side, joints: np.ndarray, forearm: bool = True) -> np.ndarray:
    """(27, 4, 4) or (25, 4, 4) from the joints to the anchor; none is turned."""
    points = joints @ _ANCHOR[side].T
    if forearm:
        points = np.vstack([points, points[0], points[0] - _ANCHOR[side] @ [0.25, 0.0, 0.0]])
    return np.stack([transform(np.eye(3), p) for p in points])


def _tag(field: int, kind: int) -> bytes:
    number = field << 3 | kind
    return bytes([number]) if number < 128 else bytes([number & 127 | 128, number >> 7])


def _nested(field: int, data: bytes) -> bytes:
    size, length = len(data), b""
    while size > 127:
        length, size = length + bytes([size & 127 | 128]), size >> 7
    return _tag(field, 2) + length + bytes([size]) + data


def avp_matrix(matrix: np.ndarray) -> bytes:
    return b"".join(
        _tag(k + 1, 5) + struct.pack("<f", v) for k, v in enumerate(matrix.ravel()) if v != 0.0
    )


def avp_hand(wrist: np.ndarray, joints: np.ndarray) -> bytes:
    skeleton = b"".join(_nested(1, avp_matrix(joint)) for joint in joints)
    return _nested(1, avp_matrix(wrist)) + _nested(2, skeleton)


def avp_update(hands: dict[Side, tuple[np.ndarray, np.ndarray]]) -> bytes:
    """A ``HandUpdate``, with a head."""
    fields = {"left": 1, "right": 2}
    update = b"".join(
        _nested(fields[side], avp_hand(*hands[side])) for side in ("left", "right") if side in hands
    )
    return update + _nested(3, avp_matrix(np.eye(4)))


_JSONL_NAMES = [
    "wrist",
    *("thumb" + part for part in ("Knuckle", "IntermediateBase", "IntermediateTip", "Tip")),
    *(
        finger + part
        for finger in ("index", "middle", "ring", "little")
        for part in ("Metacarpal", "Knuckle", "IntermediateBase", "IntermediateTip", "Tip")
    ),
]


def avp_jsonl_hand(wrist: np.ndarray, joints: np.ndarray) -> dict[str, list[float]]:
    """A hand in a line of a recording: 16 numbers each, column by column."""
    rows = [wrist, *joints[1:25]]
    return {n: m.T.ravel().tolist() for n, m in zip(_JSONL_NAMES, rows, strict=True)}
