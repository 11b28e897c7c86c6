"""Single rigid transforms as 4 x 4 matrices, for the live loop.

``smooth_operator.poses`` does the same for arrays of poses; for a single pose MuJoCo's functions
take a tenth of its time.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

Matrix = Float[np.ndarray, "4 4"]
Pose = Float[np.ndarray, "7"]


def matrix_of(pose: ArrayLike) -> Matrix:
    """Matrix of a position [m] and a quaternion (w x y z, of any length but 0)."""
    values = np.asarray(pose, float)
    turn, quaternion = np.zeros(9), values[3:] / np.linalg.norm(values[3:])
    mujoco.mju_quat2Mat(turn, quaternion)
    return rigid(turn.reshape(3, 3), values[:3])


def pose_of(matrix: Matrix) -> Pose:
    """Position [m] and unit quaternion (w first, not negative) of a matrix."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(matrix[:3, :3]).ravel())
    return np.concatenate([matrix[:3, 3], quaternion if quaternion[0] >= 0 else -quaternion])


def rigid(rotation: ArrayLike, position: ArrayLike) -> Matrix:
    """Matrix of a rotation (3, 3) and a position (3,) [m]."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, position
    return out


def inverse(matrix: Matrix) -> Matrix:
    """The inverse of a rigid transform."""
    turn = matrix[:3, :3].T
    return rigid(turn, -turn @ matrix[:3, 3])


def angle_between(one: Matrix, other: Matrix) -> float:
    """Angle of the rotation from one to the other [rad]."""
    cosine = (float((one[:3, :3] * other[:3, :3]).sum()) - 1.0) / 2.0
    return math.acos(min(max(cosine, -1.0), 1.0))
