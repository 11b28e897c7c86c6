"""Poses of the wrist as ROS 2 messages and back: there w of a quaternion is last, here first."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from smooth_operator.teleop.ros2.messages import (
    Header,
    Point,
    Pose,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)


def pose_message(pose: Float[np.ndarray, "7"]) -> Pose:
    """A pose x y z [m] and quaternion w x y z as a message."""
    x, y, z, w, a, b, c = pose.tolist()
    return Pose(Point(x, y, z), Quaternion(a, b, c, w))


def transform_message(header: Header, child: str, pose: Float[np.ndarray, "7"]) -> TransformStamped:
    """A pose of the frame ``child`` in the frame of the header, as on ``/tf``."""
    x, y, z, w, a, b, c = pose.tolist()
    return TransformStamped(header, child, Transform(Vector3(x, y, z), Quaternion(a, b, c, w)))


def pose_rows(poses: list[Pose]) -> Float[np.ndarray, "n 7"]:
    """(n, 7) poses, x y z [m] and quaternion w x y z."""
    rows = [
        (p.position.x, p.position.y, p.position.z, q.w, q.x, q.y, q.z)
        for p in poses
        for q in (p.orientation,)
    ]
    return np.array(rows, np.float64).reshape(len(rows), 7)
