"""Messages of the Vision Pro app Tracking Streamer: ``HandUpdate`` in Protocol Buffers.

The gRPC service ``handtracking.HandTrackingService`` has one method, ``StreamHandUpdates``: a
``HandUpdate`` as request, which may be empty, and a stream of ``HandUpdate``::

    HandUpdate   1 left_hand: Hand   2 right_hand: Hand   3 Head: Matrix4x4
    Hand         1 wristMatrix: Matrix4x4   2 skeleton: Skeleton
    Skeleton     1 jointMatrices: Matrix4x4, repeated
    Matrix4x4    1 m00: float   2 m01 ... 16 m33, row by row

A field that is zero is left out. Unknown fields are skipped. Source: ``handtracking.proto`` of
Improbable-AI/VisionProTeleop.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.formats.checks import check_palm
from smooth_operator.landmarks import NODE_LAYOUTS
from smooth_operator.poses import WORLD_AXES, WRIST_AXES, from_matrices, is_rigid, to_ours
from smooth_operator.types import HandFrame, Side

WORLD: Final = "avp"
"""Name of the world frame: where the app was started, on the floor."""
JOINTS: Final = 25
"""Joints that are used, the first of what is sent."""

_LANDMARKS: Final = np.array(NODE_LAYOUTS[27][0])
_METACARPALS: Final = np.array(NODE_LAYOUTS[27][1])
_WRISTS: Final = {side: WRIST_AXES[f"arkit_{side}"] for side in ("right", "left")}


def avp_frame(
    joints: Float[np.ndarray, "n 4 4"],
    wrist: Float[np.ndarray, "4 4"],
    side: Side,
    stamp: float | None,
) -> HandFrame | None:
    """A hand in the project's conventions.

    Args:
        joints: transforms from joint to wrist [m]; NaN where missing.
        wrist: transform from wrist to world.
        side: which hand.
        stamp: [s], or None.

    Returns:
        the hand, its landmarks in the wrist's axes; None if the headset has never seen it.

    Raises:
        RecordingError: fewer than 25 joints, or another unit than metres.
    """
    if len(joints) < JOINTS:
        raise RecordingError(f"a hand must have 25 or 27 joints, not {len(joints)}")
    axes = _WRISTS[side]
    poses = to_ours(_poses(joints[:JOINTS]), axes, axes)
    tracked: np.ndarray = np.any(
        poses[:, :3], axis=1
    )  # NaN counts as something, and is invalid anyway
    tracked[0] = True
    if not tracked[1:].any():
        return None
    poses[~tracked] = np.nan
    landmarks = poses[_LANDMARKS, :3]
    valid = np.isfinite(landmarks).all(axis=1)
    check_palm(landmarks, valid, "the joints")
    anchor = _poses(wrist[None])[0]
    if not anchor[:3].any():
        anchor[:] = np.nan
    return HandFrame(
        landmarks,
        stamp,
        side,
        valid=valid,
        metacarpals=poses[_METACARPALS, :3],
        orientations=poses[_LANDMARKS, 3:],
        T_world_wrist=to_ours(anchor, WORLD_AXES["openxr"], axes),
        world=WORLD,
    )


def _poses(matrices: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 7"]:
    """NaN where a matrix is no rigid transform."""
    good = is_rigid(matrices)
    poses = np.full((len(matrices), 7), np.nan)
    poses[good] = from_matrices(matrices[good])
    return poses


METHOD: Final = "/handtracking.HandTrackingService/StreamHandUpdates"
PORT: Final = 12_345
MOST_BYTES: Final = 65_536
"""Longest message that is read; one of the app has 4,000."""

_SIDES: Final[tuple[tuple[int, Side], ...]] = ((1, "left"), (2, "right"))
_MOST_JOINTS: Final = 64
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_FLOAT: Final = struct.Struct("<f")
# A rigid transform, whose three zeros are left out: twelve fields with a tag of one byte, and m33.
_RIGID: Final = struct.Struct("<" + "xf" * 12 + "2xf")
_RIGID_TAGS: Final = bytes((field << 3) | _FIXED32 for field in range(1, 13)) + b"\x85\x01"


def read_hands(data: bytes, stamp: float | None = None) -> tuple[HandFrame, ...]:
    """The hands of a message that the headset has seen, left first.

    Args:
        data: an encoded ``HandUpdate``.
        stamp: of the frames [s]; a message has none.

    Raises:
        RecordingError: it is damaged, or a hand has too few joints.
    """
    if len(data) > MOST_BYTES:
        raise RecordingError(f"a message of {len(data)} bytes is too long; at most {MOST_BYTES}")
    hands = {field: value for field, kind, value in _fields(data) if kind == _BYTES}
    frames = (_hand(hands[field], side, stamp) for field, side in _SIDES if field in hands)
    return tuple(frame for frame in frames if frame is not None)


def _hand(data: bytes, side: Side, stamp: float | None) -> HandFrame | None:
    wrist, skeleton = np.full((4, 4), np.nan), b""
    for field, kind, value in _fields(data):
        if kind == _BYTES and field == 1:
            wrist = _matrix(value)
        elif kind == _BYTES and field == 2:
            skeleton = value
    joints = [value for field, kind, value in _fields(skeleton) if (field, kind) == (1, _BYTES)]
    if not joints:
        return None
    if len(joints) > _MOST_JOINTS:
        raise RecordingError(f"a hand must have 25 or 27 joints, not {len(joints)}")
    return avp_frame(np.stack([_matrix(joint) for joint in joints]), wrist, side, stamp)


def _matrix(data: bytes) -> np.ndarray:
    if len(data) == _RIGID.size and data[:60:5] + data[60:62] == _RIGID_TAGS:
        values = _RIGID.unpack(data)
        return np.array([*values[:12], 0.0, 0.0, 0.0, values[12]]).reshape(4, 4)
    flat = np.zeros(16)
    for field, kind, value in _fields(data):
        if kind == _FIXED32 and 1 <= field <= 16:
            flat[field - 1] = _FLOAT.unpack(value)[0]
    return flat.reshape(4, 4)


def _fields(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """(number, wire type, content) of each field; the content of a varint is empty.

    Raises:
        RecordingError: it is cut off, or no encoded message.
    """
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        kind, field = tag & 7, tag >> 3
        if kind == _VARINT:
            size, at = 0, _varint(data, at)[1]
        elif kind == _BYTES:
            size, at = _varint(data, at)
        elif kind in (_FIXED32, _FIXED64):
            size = 4 if kind == _FIXED32 else 8
        else:
            raise RecordingError(
                f"the message is no HandUpdate of Tracking Streamer: wire type {kind} at byte {at}"
            )
        if field == 0 or at + size > len(data):
            raise RecordingError(
                f"the message is damaged or cut off: field {field} of {size} bytes at byte {at} "
                f"of {len(data)}"
            )
        yield field, kind, data[at : at + size]
        at += size


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            break
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise RecordingError(f"the message is damaged or cut off: a number does not end at byte {at}")
