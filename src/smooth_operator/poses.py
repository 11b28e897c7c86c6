"""Rigid wrist poses: operations on them, and conversion from trackers' frames to the project's.

A pose is seven numbers, x y z [m] and a unit quaternion w x y z; ``T_a_b`` maps points of frame b
to frame a. All functions take (..., 7) arrays, return float64, and give NaN for a row with NaN,
which means "not valid".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from smooth_operator.errors import ConfigError, brief
from smooth_operator.types import Side, unit_poses

IDENTITY: Final[Float[np.ndarray, "7"]] = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
"""The identity."""

_TINY: Final = 1e-12
_RIGID: Final = 0.02  # tolerance of an entry of a matrix
_NEXT: Final = np.array([1, 2, 0])
_AFTER: Final = np.array([2, 0, 1])


def axes(x: str, y: str, z: str) -> Float[np.ndarray, "3 3"]:
    """Returns the matrix that converts a tracker's axes to ours, given our axes in the tracker's
    frame.

    Args:
        x: axis of the tracker along our x: ``x``, ``y`` or ``z``, with a minus sign if reversed.

    Returns:
        (3, 3) matrix M with ours = M @ theirs; its determinant is -1 for a left-handed tracker.

    Raises:
        ConfigError: these are not three different axes.
    """
    rows = np.zeros((3, 3))
    for row, name in zip(rows, (x, y, z), strict=True):
        if name[-1:] not in ("x", "y", "z") or name[:-1] not in ("", "+", "-"):
            raise ConfigError(
                f"an axis must be x, y or z, with or without a minus sign, not {brief(name)}"
            )
        row["xyz".index(name[-1])] = -1.0 if name[0] == "-" else 1.0
    if not np.abs(rows).any(axis=0).all():
        raise ConfigError(f"expected three different axes, not {x}, {y}, {z}")
    return rows


WORLD_AXES: Final[Mapping[str, Float[np.ndarray, "3 3"]]] = MappingProxyType(
    {
        "z_up": np.eye(3),
        "openxr": axes("-z", "-x", "y"),
        "unity": axes("z", "-x", "y"),
        "z_up_y_forward": axes("y", "-x", "z"),
    }
)
"""World axes of trackers: our x (forward), y (left) and z (up), in the axes of each tracker.

``openxr`` is right-handed, y up, -z forward: OpenXR, WebXR, ARKit (visionOS), OpenVR (Vive
trackers). ``unity`` is left-handed, y up, z forward. ``z_up_y_forward`` is right-handed, x right:
libsurvive (Vive trackers) and ``avp_stream``. ``z_up`` is ours.
"""

WRIST_AXES: Final[Mapping[str, Float[np.ndarray, "3 3"]]] = MappingProxyType(
    {
        "ours": np.eye(3),
        "openxr": axes("-z", "-x", "y"),
        "unity": axes("z", "-x", "y"),
        "arkit_right": axes("-x", "z", "y"),
        "arkit_left": axes("x", "z", "-y"),
    }
)
"""Wrist axes of trackers: our x (to the middle finger), y (z cross x) and z (out of the back of the
hand), in the axes of each tracker.

``openxr`` (XR_EXT_hand_tracking, WebXR): -z to the fingers, y out of the back, on both hands.
``unity`` (XR Hands): the same with z to the fingers, left-handed. ``arkit_right``, ``arkit_left``
(hand anchors of visionOS, EgoDex): the right hand's x points to the forearm, y out of its back; the
left hand's x to the fingers, y out of its palm. A tracker with other axes names them with ``axes``.
"""


def to_ours(
    poses: ArrayLike,
    world: Float[np.ndarray, "3 3"] = WORLD_AXES["openxr"],
    wrist: Float[np.ndarray, "3 3"] = WRIST_AXES["openxr"],
) -> Float[np.ndarray, "*n 7"]:
    """Converts poses of a tracker's wrist in the tracker's world to poses of our wrist in our z-up
    world.

    Args:
        poses: (..., 7) x y z [m], quaternion w x y z of any length, as the tracker reports them.
        world: the tracker's world axes, from ``WORLD_AXES`` or ``axes``.
        wrist: its wrist axes, from ``WRIST_AXES`` or ``axes``.

    Raises:
        ConfigError: only one of the two is left-handed, so that no rotation maps one to the other.
    """
    if np.linalg.det(world) * np.linalg.det(wrist) < 0:
        raise ConfigError(
            "the world axes and wrist axes of a tracker must have the same handedness"
        )
    unit = unit_poses(np.asarray(poses, np.float64))
    rotation = world @ rotation_matrices(unit[..., 3:]) @ wrist.T
    return np.concatenate([unit[..., :3] @ world.T, quaternions(rotation)], axis=-1)


def points_to_ours(
    points: ArrayLike, world: Float[np.ndarray, "3 3"] = WORLD_AXES["openxr"]
) -> Float[np.ndarray, "*n 3"]:
    """Converts (..., 3) points from a tracker's world to our z-up, right-handed world, in the same
    unit."""
    moved: np.ndarray = np.asarray(points, np.float64) @ world.T
    return moved


def wrist_from_landmarks(
    landmarks: Float[np.ndarray, "*n 21 3"], side: Side
) -> Float[np.ndarray, "*n 7"]:
    """Computes (..., 7) wrist poses from the palm's landmarks, for trackers that give only points.

    The landmarks are in a z-up, right-handed world [m]. A pose is NaN if the wrist or the index,
    middle or pinky MCP is missing, or if they are collinear.
    """
    points = np.asarray(landmarks, np.float64)
    distal = _unit(points[..., 9, :] - points[..., 0, :])
    dorsal = _unit(np.cross(distal, points[..., 5, :] - points[..., 17, :]))
    dorsal = dorsal if side == "right" else -dorsal
    rotation = np.stack([distal, np.cross(dorsal, distal), dorsal], axis=-1)
    flat = np.linalg.norm(dorsal, axis=-1) < 0.5  # collinear points
    rotation = np.where(flat[..., None, None], np.nan, rotation)
    return np.concatenate([points[..., 0, :], quaternions(rotation)], axis=-1)


def forearm(elbow: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Unit vectors from elbow to wrist in the wrist's frame, computed from a point of the forearm
    in that frame [m]; NaN if the point is missing or less than 5 cm from the wrist."""
    distance = np.linalg.norm(elbow, axis=-1, keepdims=True)
    return np.where(distance > _SHORTEST_FOREARM, -_unit(elbow), np.nan)


_SHORTEST_FOREARM: Final = 0.05


def forearm_in_world(
    wrist: Float[np.ndarray, "*n 7"], elbow: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Computes ``forearm`` from the wrist pose and a point of the forearm, both in the same world
    frame [m]."""
    return forearm(rotate(conjugate(wrist[..., 3:]), elbow - wrist[..., :3]))


def _unit(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    unit: np.ndarray = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
    return unit


def is_valid(poses: Float[np.ndarray, "*n 7"] | None) -> Bool[np.ndarray, "*n"]:
    """True for each valid pose; False for None, which stands for the pose of a tracker without
    wrists."""
    return np.asarray(np.isfinite(np.full(7, np.nan) if poses is None else poses).all(axis=-1))


def compose(a: Float[np.ndarray, "*n 7"], b: Float[np.ndarray, "*n 7"]) -> np.ndarray:
    """Computes the pose ``T_x_z`` from ``T_x_y`` and ``T_y_z``."""
    return np.concatenate(
        [a[..., :3] + rotate(a[..., 3:], b[..., :3]), multiply(a[..., 3:], b[..., 3:])], axis=-1
    )


def invert(pose: Float[np.ndarray, "*n 7"]) -> np.ndarray:
    """Computes the pose ``T_y_x`` from ``T_x_y``."""
    back = conjugate(pose[..., 3:])
    return np.concatenate([-rotate(back, pose[..., :3]), back], axis=-1)


def relative(a: Float[np.ndarray, "*n 7"], b: Float[np.ndarray, "*n 7"]) -> np.ndarray:
    """Computes the pose ``T_a_b`` from the poses of a and b in one frame."""
    return compose(invert(a), b)


def separation(a: Float[np.ndarray, "*n 7"], b: Float[np.ndarray, "*n 7"]) -> np.ndarray:
    """(..., 2) distance [m] and angle [rad], from 0 to pi, between two poses."""
    distance = np.linalg.norm(b[..., :3] - a[..., :3], axis=-1)
    angle = np.linalg.norm(rotation_vectors(multiply(conjugate(a[..., 3:]), b[..., 3:])), axis=-1)
    return np.stack([distance, angle], axis=-1)


def matrices(poses: Float[np.ndarray, "*n 7"]) -> Float[np.ndarray, "*n 4 4"]:
    """Converts poses to homogeneous matrices."""
    out = np.zeros((*poses.shape[:-1], 4, 4))
    out[..., :3, :3] = rotation_matrices(poses[..., 3:])
    out[..., :3, 3] = poses[..., :3]
    out[..., 3, 3] = 1.0
    return out


def is_rigid(matrix: Float[np.ndarray, "*n 4 4"]) -> Bool[np.ndarray, "*n"]:
    """True for each matrix that is a proper rotation and a position, up to rounding of float32."""
    rotation = matrix[..., :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # huge numbers are not rigid
        gram = rotation @ np.swapaxes(rotation, -1, -2)
        good = (np.abs(gram - np.eye(3)) < _RIGID).all(axis=(-2, -1))
        good &= np.linalg.det(rotation) > 0
        last = np.abs(matrix[..., 3, :] - np.array([0.0, 0.0, 0.0, 1.0])) < _RIGID
    whole: np.ndarray = good & last.all(axis=-1) & np.isfinite(matrix).all(axis=(-2, -1))
    return whole


def from_matrices(matrix: Float[np.ndarray, "*n 4 4"]) -> Float[np.ndarray, "*n 7"]:
    """Converts homogeneous matrices with a proper rotation to poses."""
    return np.concatenate([matrix[..., :3, 3], quaternions(matrix[..., :3, :3])], axis=-1)


def multiply(a: Float[np.ndarray, "*n 4"], b: Float[np.ndarray, "*n 4"]) -> np.ndarray:
    """Multiplies quaternions: the product rotates by b, then by a."""
    if a.ndim == b.ndim == 1:  # in the live loop; arrays take five times as long for one pair
        w, x, y, z = a.tolist()
        e, f, g, h = b.tolist()
        return np.array(
            [
                w * e - (x * f + y * g + z * h),
                w * f + e * x + (y * h - z * g),
                w * g + e * y + (z * f - x * h),
                w * h + e * z + (x * g - y * f),
            ]
        )
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    real = aw * bw - (av * bv).sum(axis=-1, keepdims=True)
    return np.concatenate([real, aw * bv + bw * av + _cross(av, bv)], axis=-1)


def conjugate(q: Float[np.ndarray, "*n 4"]) -> np.ndarray:
    """Inverts unit quaternions."""
    inverse: np.ndarray = q * np.array([1.0, -1.0, -1.0, -1.0])
    return inverse


def rotate(q: Float[np.ndarray, "*n 4"], points: Float[np.ndarray, "*n 3"]) -> np.ndarray:
    """Rotates points by unit quaternions."""
    turn = 2.0 * _cross(q[..., 1:], points)
    turned: np.ndarray = points + q[..., :1] * turn + _cross(q[..., 1:], turn)
    return turned


def _cross(a: Float[np.ndarray, "*n 3"], b: Float[np.ndarray, "*n 3"]) -> np.ndarray:
    """Cross product; for a single pair it is five times as fast as NumPy's."""
    product: np.ndarray = a[..., _NEXT] * b[..., _AFTER] - a[..., _AFTER] * b[..., _NEXT]
    return product


def rotation_vectors(q: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 3"]:
    """Converts unit quaternions to axis times angle (0 to pi) [rad]; q and -q give the same
    result."""
    if q.ndim == 1:
        w, x, y, z = q.tolist()
        length = math.sqrt(x * x + y * y + z * z)
        length = -length if w < 0 else length
        factor = (
            2.0 * math.atan2(abs(length), abs(w)) / length
            if abs(length) > _TINY
            else math.copysign(2.0, w)
        )
        return np.array([factor * x, factor * y, factor * z])
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    vectors: np.ndarray = q[..., 1:] * np.where(sine > _TINY, angle / np.maximum(sine, _TINY), 2.0)
    return vectors


def from_rotation_vectors(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 4"]:
    """Converts axis times angle [rad] to unit quaternions."""
    if vectors.ndim == 1:
        x, y, z = vectors.tolist()
        half = math.sqrt(x * x + y * y + z * z) / 2.0
        if not math.isfinite(half):
            return np.full(4, np.nan)
        factor = 0.5 * (math.sin(half) / half if half > _TINY else 1.0)
        return np.array([math.cos(half), factor * x, factor * y, factor * z])
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    # sinc is defined without rotation: sin(a / 2) / a = sinc(a / 2 pi) / 2
    return np.concatenate(
        [np.cos(angle / 2.0), 0.5 * np.sinc(angle / (2.0 * np.pi)) * vectors], axis=-1
    )


def rotation_matrices(q: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 3 3"]:
    """Converts unit quaternions to rotation matrices."""
    columns = [rotate(q, np.broadcast_to(e, (*q.shape[:-1], 3))) for e in np.eye(3)]
    return np.stack(columns, axis=-1)


def quaternions(rotation: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 4"]:
    """Converts proper rotation matrices to unit quaternions with w >= 0."""
    m = np.moveaxis(np.asarray(rotation, np.float64), (-2, -1), (0, 1))
    (a, b, c), (d, e, f), (g, h, i) = m
    # 4 q q^T; the row of its largest diagonal entry loses no digits (Shepperd 1978)
    rows = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    best = np.einsum("kk...->k...", rows).argmax(axis=0)
    picked = np.take_along_axis(np.moveaxis(rows, 0, -1), best[None, ..., None], axis=-1)
    q = np.moveaxis(picked[..., 0], 0, -1)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    positive: np.ndarray = np.where(q[..., :1] < 0, -q, q)
    return positive
