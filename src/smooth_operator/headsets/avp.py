"""Decodes hands from messages of the Vision Pro app Tracking Streamer (``avp_stream``).

A hand is 25 joints, or 27 with two of the forearm, in WebXR's order: 4 x 4 transforms from the
joint to the hand's anchor, which is the wrist; and the anchor's transform to the world, in ARKit's
axes (right-handed, y up). The app sends the identity for a joint that it has never seen, and the
last transform for one that it has lost.

The gRPC service ``handtracking.HandTrackingService`` has one method, ``StreamHandUpdates``: a
``HandUpdate`` as request, which may be empty, and a stream of ``HandUpdate``::

    HandUpdate   1 left_hand: Hand   2 right_hand: Hand   3 Head: Matrix4x4
    Hand         1 wristMatrix: Matrix4x4   2 skeleton: Skeleton
    Skeleton     1 jointMatrices: Matrix4x4, repeated
    Matrix4x4    1 m00: float   2 m01 ... 16 m33, row by row

A field that is zero is left out.

Source: ``AppModel.swift``, ``RecordingManager.swift`` and ``handtracking.proto`` of
Improbable-AI/VisionProTeleop; the axes of the wrist from its issue 12.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import MissingExtraError, RecordingError
from smooth_operator.formats.checks import check_palm
from smooth_operator.landmarks import NODE_LAYOUTS
from smooth_operator.poses import WORLD_AXES, WRIST_AXES, forearm, from_matrices, is_rigid, to_ours
from smooth_operator.types import HandFrame, Side

WORLD: Final = "avp"
"""Name of the world frame: the place where the app was started, on the floor."""
JOINTS: Final = 25
"""Number of joints in use, the first of those in a message."""

_LANDMARKS: Final = np.array(NODE_LAYOUTS[27][0])
_METACARPALS: Final = np.array(NODE_LAYOUTS[27][1])
_WRISTS: Final = {side: WRIST_AXES[f"arkit_{side}"] for side in ("right", "left")}


def avp_frame(
    joints: Float[np.ndarray, "n 4 4"],
    wrist: Float[np.ndarray, "4 4"],
    side: Side,
    stamp: float | None,
) -> HandFrame | None:
    """Converts a hand of the app to a frame in this project's conventions.

    Args:
        joints: transforms from joint to wrist [m]; NaN if missing.
        wrist: transform from wrist to world.
        stamp: stamp of the frame [s], or None.

    Returns:
        the hand with landmarks in the wrist's axes; None if the headset has never seen it.

    Raises:
        RecordingError: fewer than 25 joints, or another unit than metres.
    """
    if len(joints) < JOINTS:
        raise RecordingError(f"a hand must have 25 or 27 joints, not {len(joints)}")
    axes = _WRISTS[side]
    poses = to_ours(_poses(joints[:JOINTS]), axes, axes)
    tracked: np.ndarray = np.any(poses[:, :3], axis=1)  # also for NaN, which is invalid anyway
    tracked[0] = True
    if not tracked[1:].any():
        return None
    poses[~tracked] = np.nan
    landmarks = poses[_LANDMARKS, :3]
    valid = np.isfinite(landmarks).all(axis=1)
    check_palm(landmarks, valid, "the joints")
    # Of the two joints of the forearm, one is at the wrist.
    elbow = to_ours(_poses(joints[JOINTS : JOINTS + 2]), axes, axes)[:, :3]
    away = np.nan_to_num(np.linalg.norm(elbow, axis=1))
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
        forearm=forearm(elbow[int(away.argmax())]) if len(elbow) else None,
    )


def _poses(matrices: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 7"]:
    """Poses of matrices; NaN for a matrix that is not a rigid transform."""
    good = is_rigid(matrices)
    poses = np.full((len(matrices), 7), np.nan)
    poses[good] = from_matrices(matrices[good])
    return poses


METHOD: Final = "/handtracking.HandTrackingService/StreamHandUpdates"
PORT: Final = 12_345
MOST_BYTES: Final = 65_536
"""Size of the longest accepted message; the app's have 4,000 bytes."""

_MOST_JOINTS: Final = 64
_CELLS: Final = [f"m{row}{column}" for row in range(4) for column in range(4)]
_MESSAGES: Final[dict[str, dict[str, str | None]]] = {
    "Matrix4x4": dict.fromkeys(_CELLS),
    "Skeleton": {"jointMatrices": ".Matrix4x4"},
    "Hand": {"wristMatrix": ".Matrix4x4", "skeleton": ".Skeleton"},
    "HandUpdate": {"left_hand": ".Hand", "right_hand": ".Hand", "Head": ".Matrix4x4"},
}


@cache
def _message_class() -> tuple[Any, type[Exception]]:
    """The class of a ``HandUpdate``, and its error for another message."""
    try:
        from google.protobuf import descriptor_pb2, descriptor_pool, message, message_factory
    except ModuleNotFoundError as error:
        raise MissingExtraError("a message of Tracking Streamer", "avp") from error
    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="handtracking.proto", syntax="proto3")
    for name, members in _MESSAGES.items():
        message_type = file.message_type.add(name=name)
        for number, (member, kind) in enumerate(members.items(), 1):
            field = message_type.field.add(name=member, number=number, type_name=kind)
            field.type = kinds.TYPE_MESSAGE if kind else kinds.TYPE_FLOAT
            many = member == "jointMatrices"
            field.label = kinds.LABEL_REPEATED if many else kinds.LABEL_OPTIONAL
    pool = descriptor_pool.DescriptorPool()  # the common one may have the messages of avp_stream
    pool.Add(file)
    update = pool.FindMessageTypeByName("HandUpdate")
    return message_factory.GetMessageClass(update), message.DecodeError


def read_hands(data: bytes) -> tuple[HandFrame, ...]:
    """Decodes a ``HandUpdate`` and returns the hands that the headset saw, left hand first, without
    stamps. Raises RecordingError if the message is damaged, or if a hand has too few joints."""
    if len(data) > MOST_BYTES:
        raise RecordingError(f"a message of {len(data)} bytes is too long; at most {MOST_BYTES}")
    update, damaged = _message_class()
    try:
        read = update.FromString(data)
    except damaged as error:
        raise RecordingError(
            "the message is not a HandUpdate of Tracking Streamer, or is damaged or "
            f"truncated: {error}"
        ) from error
    frames = (_hand(read.left_hand, "left"), _hand(read.right_hand, "right"))
    return tuple(frame for frame in frames if frame is not None)


def _hand(hand: Any, side: Side) -> HandFrame | None:
    joints = hand.skeleton.jointMatrices
    if not joints:
        return None
    if len(joints) > _MOST_JOINTS:
        raise RecordingError(f"a hand must have 25 or 27 joints, not {len(joints)}")
    wrist = _matrix(hand.wristMatrix) if hand.HasField("wristMatrix") else np.full((4, 4), np.nan)
    return avp_frame(np.stack([_matrix(joint) for joint in joints]), wrist, side, None)


def _matrix(message: Any) -> np.ndarray:
    return np.array([getattr(message, cell) for cell in _CELLS]).reshape(4, 4)
