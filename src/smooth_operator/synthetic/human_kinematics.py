"""Forward kinematics of the synthetic hand, in the form in which a glove reports a hand.

The wrist is the origin; x is palmar, y towards the thumb of a right hand, z distal. A joint's own
frame has x along its bone and z dorsal, so flexion turns about its y. A fingertip has the
orientation of its last joint, as in a MANUS stream.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.synthetic.hand_anatomy import LOWER, UPPER, HandAnatomy

# Orientation of the hand itself (x distal, z dorsal) in the frame of the landmarks.
_HAND = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0])

# The thumb's metacarpal at zero angles, ours (see ``hand_anatomy``): its bone points 18 deg radial
# and 24 deg palmar of distal, its nail 60 deg from dorsal towards radial.
_THUMB_RADIAL, _THUMB_PALMAR, _THUMB_ROLL = np.deg2rad([18.0, 24.0, 60.0])
# Cooney 1981: 17 deg of pronation accompany the motion from extended and adducted to opposed.
_THUMB_PRONATION = np.deg2rad(17.0)


@dataclass(frozen=True, eq=False)
class HandPoses:
    """Poses of one hand over a batch of T.

    Attributes:
        landmarks: (T, 21, 3) landmarks [m].
        metacarpals: (T, 4, 3) bases of the metacarpals of index .. pinky [m].
        orientations: (T, 21, 4) quaternions wxyz.
    """

    landmarks: Float[np.ndarray, "T 21 3"]
    metacarpals: Float[np.ndarray, "T 4 3"]
    orientations: Float[np.ndarray, "T 21 4"]


def pose_hand(anatomy: HandAnatomy, angles: Float[np.ndarray, "T 20"]) -> HandPoses:
    """Poses of a right hand, wrist at the origin, at (T, 20) joint angles [rad] in the order of
    ``JOINTS``."""
    count = len(angles)
    landmarks = np.zeros((count, 21, 3))
    orientations = np.empty((count, 21, 4))
    orientations[:, 0] = _HAND

    flexion, abduction, mcp, ip = np.moveaxis(angles[:, :4], -1, 0)
    span = (UPPER - LOWER)[:2]
    opposed = ((flexion - LOWER[0]) / span[0] + (abduction - LOWER[1]) / span[1]) / 2.0
    frame = _mul(
        _mul(_HAND, _about(2, _THUMB_RADIAL - flexion)), _about(1, _THUMB_PALMAR + abduction)
    )
    frame = _mul(frame, _about(0, -(_THUMB_ROLL + _THUMB_PRONATION * opposed)))
    _chain(
        landmarks[:, 1:5],
        orientations[:, 1:5],
        anatomy.thumb_base,
        anatomy.thumb_bones,
        (frame, mcp, ip),
    )

    fan, roll = anatomy.finger_fan, anatomy.finger_roll
    base = _mul(_mul(_HAND, _about(2, fan)), _about(0, roll))
    fingers = angles[:, 4:].reshape(count, 4, 4)
    frame = _mul(_mul(base, _about(2, fingers[..., 0])), _about(1, fingers[..., 1]))
    _chain(
        landmarks[:, 5:].reshape(count, 4, 4, 3),  # views: reshape splits one axis
        orientations[:, 5:].reshape(count, 4, 4, 4),
        anatomy.knuckles,
        anatomy.phalanges,
        (frame, fingers[..., 2], fingers[..., 3]),
    )

    metacarpals = np.broadcast_to(anatomy.metacarpal_bases, (count, 4, 3)).copy()
    return HandPoses(landmarks, metacarpals, orientations)


def mirror(poses: HandPoses) -> HandPoses:
    """Mirrored poses, of the other hand: y changes sign; joint frames keep bone x and dorsal z."""
    points, quaternions = np.array([1.0, -1.0, 1.0]), np.array([1.0, -1.0, 1.0, -1.0])
    return HandPoses(
        poses.landmarks * points, poses.metacarpals * points, poses.orientations * quaternions
    )


def move(
    poses: HandPoses,
    translation: Float[np.ndarray, "T 3"],
    rotation_vector: Float[np.ndarray, "T 3"],
) -> HandPoses:
    """Move whole hands with the wrist at the origin: (T, 3) translation [m] and rotation about the
    wrist, axis times angle [rad]."""
    angle = np.linalg.norm(rotation_vector, axis=-1, keepdims=True)
    # sinc keeps the limit at no rotation: sin(a/2)/a = sinc(a/2pi)/2
    quaternion = np.concatenate(
        [np.cos(angle / 2.0), 0.5 * np.sinc(angle / (2.0 * np.pi)) * rotation_vector], -1
    )[:, None]

    def carry(points: Float[np.ndarray, "T n 3"]) -> Float[np.ndarray, "T n 3"]:
        w, v = quaternion[..., :1], quaternion[..., 1:]
        turn = 2.0 * np.cross(v, points)
        carried: np.ndarray = points + w * turn + np.cross(v, turn) + translation[:, None]
        return carried

    return HandPoses(
        carry(poses.landmarks), carry(poses.metacarpals), _mul(quaternion, poses.orientations)
    )


def _chain(
    points: Float[np.ndarray, "*batch 4 3"],
    orientations: Float[np.ndarray, "*batch 4 4"],
    base: Float[np.ndarray, "*digit 3"],
    lengths: Float[np.ndarray, "*digit 3"],
    joints: tuple[Float[np.ndarray, "*batch 4"], np.ndarray, np.ndarray],
) -> None:
    """Fill one digit's (or four digits') points and orientations from base to tip, in place."""
    frame = joints[0]
    points[..., 0, :] = base
    for k in range(3):
        if k:
            frame = _mul(frame, _about(1, joints[k]))
        orientations[..., k, :] = frame
        points[..., k + 1, :] = points[..., k, :] + lengths[..., k, None] * _bone(frame)
    orientations[..., 3, :] = frame


def _about(axis: int, angle: float | np.ndarray) -> np.ndarray:
    """Quaternion of a rotation about coordinate axis 0, 1 or 2."""
    half = np.asarray(angle) / 2.0
    quaternion = np.zeros((*half.shape, 4))
    quaternion[..., 0] = np.cos(half)
    quaternion[..., 1 + axis] = np.sin(half)
    return quaternion


def _mul(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Product of quaternions wxyz, with broadcasting."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def _bone(q: np.ndarray) -> np.ndarray:
    """The x axis of a frame."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)], -1)


def dorsal(q: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3"]:
    """The z axis of a joint frame, which points to the nail's side, away from the pad."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    return np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], -1)
