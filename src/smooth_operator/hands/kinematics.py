"""Computes keypoint positions of a tree of joints for many poses, unrolled at trace time.

For every keypoint the chain of joints above it is written out as straight-line arithmetic over
arrays whose *last* axis is the batch, so that a compiler can fuse the forward kinematics of
thousands of hands into one loop of vector instructions.

The constants between joints have the form of Denavit and Hartenberg: every joint turns about its
own z axis, and the z parts of the rotation Rz(a) Rx(b) Rz(c) between two joints are added to the
joint angles on either side, which leaves Rx(b) with four products.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import HandModelError
from smooth_operator.geometry import AnyArray, AnyKind, array_namespace

Number: TypeAlias = AnyArray | float
"""An array over the batch, or a plain number if it does not depend on a joint."""
Vector: TypeAlias = tuple[Number, Number, Number]
"""x, y, z."""

_TINY = 1e-12
_MAX_POLYNOMIAL_RANGE = 2 * np.pi  # [rad]; above, float32 loses digits to cancellation


@dataclass(frozen=True)
class Joint:
    """One hinge or slide of the tree, about or along its own z axis.

    Attributes:
        parent: index of the next joint toward the palm, or -1 for the palm.
        rotation: (3, 3) constant rotation from the frame above to this joint's frame.
        translation: (3,) position of the joint in the frame above [m].
        offset: constant that is added to the joint angle [rad]; 0 for a slide.
        source: index into the vector of all joint positions.
        slide: True for a prismatic joint.
    """

    parent: int
    rotation: np.ndarray
    translation: np.ndarray
    offset: float
    source: int
    slide: bool


@dataclass(frozen=True)
class Keypoint:
    """A point fixed to the frame of a joint (or of the palm, joint -1)."""

    joint: int
    position: np.ndarray


@dataclass(frozen=True, eq=False)
class KinematicTree:
    """Keypoints of a model as a function of its joint positions.

    Attributes:
        joints: joints that move some keypoint, parents first.
        keypoints: name -> point.
        num_joints: length n of the vector of all joint positions.
        limits: (n, 2) joint limits [rad or m]; infinite for a joint without limits.
    """

    joints: tuple[Joint, ...]
    keypoints: Mapping[str, Keypoint]
    num_joints: int
    limits: Float[np.ndarray, "n 2"]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Keypoint names, in the order of ``positions``."""
        return tuple(self.keypoints)

    def positions(self, q: Float[AnyKind, "*batch n"]) -> Float[AnyKind, "*batch k 3"]:
        """(..., k, 3) positions of all keypoints in the palm frame [m], in the order of ``names``,
        at (..., n) positions of *all* joints [rad]; NumPy or JAX, differentiable."""
        xp = array_namespace(q)
        batch = q.shape[:-1]
        flat = q.reshape(-1, self.num_joints).T
        points = self.forward_kinematics(list(flat), self.names)
        stacked = xp.stack(
            [xp.stack([xp.broadcast_to(c, flat.shape[1:]) for c in p], axis=-1) for p in points],
            axis=-2,
        )
        return stacked.reshape(*batch, len(points), 3)  # type: ignore[no-any-return]

    def forward_kinematics(
        self, q: Sequence[AnyArray], names: Sequence[str], *, within_limits: bool = False
    ) -> list[Vector]:
        """Forward kinematics, unrolled: positions of some keypoints, batch last.

        Args:
            q: n arrays of one common shape, the positions of all joints [rad].
            within_limits: promise that q respects the limits; sine and cosine are then polynomials
                over each joint's range (to 1e-6), several times cheaper than the general
                functions.

        Returns:
            one (x, y, z) per name; a coordinate that no joint moves is a plain float.
        """
        xp = array_namespace(*q)
        trig: dict[int, tuple[AnyArray, AnyArray]] = {}

        def sin_cos(i: int) -> tuple[AnyArray, AnyArray]:
            if i not in trig:
                joint = self.joints[i]
                angle = q[joint.source]
                low, high = self.limits[joint.source]
                if within_limits and high - low <= _MAX_POLYNOMIAL_RANGE:
                    trig[i] = _bounded_sin_cos(angle, float(low), float(high), joint.offset)
                else:
                    angle = angle + joint.offset if joint.offset else angle
                    trig[i] = (xp.sin(angle), xp.cos(angle))
            return trig[i]

        points = []
        for name in names:
            keypoint = self.keypoints[name]
            x, y, z = (float(c) for c in keypoint.position)
            p: Vector = (x, y, z)
            i = keypoint.joint
            while i >= 0:
                joint = self.joints[i]
                if joint.slide:
                    p = (p[0], p[1], p[2] + q[joint.source])
                else:
                    s, c = sin_cos(i)
                    p = (
                        _sum(_mul(c, p[0]), _mul(s, -p[1])),
                        _sum(_mul(s, p[0]), _mul(c, p[1])),
                        p[2],
                    )
                p = _affine(joint.rotation, joint.translation, p)
                i = joint.parent
            points.append(p)
        return points


def build_tree(
    model: mujoco.MjModel,
    palm: int,
    keypoints: Mapping[str, tuple[int, np.ndarray]],
    own: Sequence[int] | None = None,
) -> KinematicTree:
    """Converts a MuJoCo model to a ``KinematicTree``.

    Args:
        palm: body in whose frame positions are computed; joints at or above it are held at zero.
        keypoints: name -> (body id, (3,) position in that body's frame [m]).
        own: all joints of the hand in the model, including those between palm and keypoints; by
            default every joint of the model.

    Raises:
        HandModelError: there is a ball or free joint between the palm and a keypoint, or a keypoint
            on a body that does not hang from the palm.
    """
    own = range(model.njnt) if own is None else own
    above_palm = set()
    body = palm
    while body > 0:
        above_palm.add(body)
        body = int(model.body_parentid[body])

    joints: list[Joint] = []
    frames: dict[int, tuple[int, np.ndarray, np.ndarray]] = {palm: (-1, np.eye(3), np.zeros(3))}

    def frame(body: int) -> tuple[int, np.ndarray, np.ndarray]:
        """(last joint above, rotation, translation) of a body's frame in that joint's frame."""
        if body in frames:
            return frames[body]
        if body in above_palm or body == 0:
            raise HandModelError(
                f"body '{model.body(body).name or body}' does not hang from the palm "
                f"'{model.body(palm).name}': choose a palm further up the tree"
            )
        parent, rotation, translation = frame(int(model.body_parentid[body]))
        translation = translation + rotation @ model.body_pos[body]
        rotation = rotation @ _matrix(model.body_quat[body])
        for j in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            kind = mujoco.mjtJoint(int(model.jnt_type[j]))
            if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                raise HandModelError(
                    f"joint '{model.joint(j).name}' is a ball or free joint; "
                    "a hand's joints must be hinges or slides"
                )
            slide = kind == mujoco.mjtJoint.mjJNT_SLIDE
            # MuJoCo's joint at anchor a turns p to a + R (p - a): split into before, turn, after.
            to_axis = _frame_with_z(model.jnt_axis[j])
            anchor = np.zeros(3) if slide else model.jnt_pos[j]
            # MuJoCo counts a joint's position from its reference qpos0
            zero = float(model.qpos0[model.jnt_qposadr[j]])
            joints.append(
                Joint(
                    parent,
                    rotation @ to_axis,
                    translation + rotation @ anchor,
                    -zero,
                    own.index(j),
                    slide,
                )
            )
            parent = len(joints) - 1
            rotation, translation = to_axis.T, -to_axis.T @ anchor
            if slide and zero:
                translation = translation - np.array([0, 0, zero])
        frames[body] = (parent, rotation, translation)
        return frames[body]

    points = {}
    for name, (body, position) in keypoints.items():
        parent, rotation, translation = frame(int(body))
        points[name] = Keypoint(parent, rotation @ np.asarray(position, float) + translation)

    limits = np.where(
        model.jnt_limited.astype(bool)[:, None], model.jnt_range, np.array([-np.inf, np.inf])
    )
    reduced, points = _denavit_hartenberg(joints, points)
    return KinematicTree(tuple(reduced), points, len(own), limits[list(own)])


def _denavit_hartenberg(
    joints: list[Joint], points: dict[str, Keypoint]
) -> tuple[list[Joint], dict[str, Keypoint]]:
    """Move the z parts of the constant rotations into the joint angles."""
    turn = np.zeros(len(joints))  # angle by which each hinge's moving frame is turned about its z
    decided = [joint.slide for joint in joints]
    out: list[Joint] = []
    for joint in joints:
        rotation, translation, offset = joint.rotation, joint.translation, joint.offset
        p = joint.parent
        alpha, gamma = _zxz(rotation)
        if p >= 0 and not decided[p]:  # only the first child can have its z part moved to p
            turn[p], decided[p] = alpha, True
            out[p] = replace(out[p], offset=out[p].offset + alpha)
        if p >= 0:
            unturn = _rz(-turn[p])
            rotation, translation = unturn @ rotation, unturn @ translation
        if not joint.slide:
            rotation = rotation @ _rz(-gamma)
            offset += gamma
        rotation = np.where(abs(rotation) < _TINY, 0.0, rotation)
        out.append(Joint(p, rotation, translation, offset, joint.source, joint.slide))
    moved = {
        name: Keypoint(k.joint, _rz(-turn[k.joint]) @ k.position if k.joint >= 0 else k.position)
        for name, k in points.items()
    }
    return out, moved


def _zxz(rotation: np.ndarray) -> tuple[float, float]:
    """Angles a and c of R = Rz(a) Rx(b) Rz(c); a is 0 for parallel axes."""
    if np.hypot(rotation[0, 2], rotation[1, 2]) < 1e-9:
        if rotation[2, 2] > 0:
            return 0.0, float(np.arctan2(rotation[1, 0], rotation[0, 0]))
        return 0.0, float(np.arctan2(-rotation[1, 0], rotation[0, 0]))
    return (
        float(np.arctan2(rotation[0, 2], -rotation[1, 2])),
        float(np.arctan2(rotation[2, 0], rotation[2, 1])),
    )


def _rz(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _matrix(quat: np.ndarray) -> np.ndarray:
    out = np.empty(9)
    mujoco.mju_quat2Mat(out, quat)
    return out.reshape(3, 3)


def _frame_with_z(axis: np.ndarray) -> np.ndarray:
    """A rotation whose third column is the axis."""
    quat = np.empty(4)
    mujoco.mju_quatZ2Vec(quat, axis / np.linalg.norm(axis))
    return _matrix(quat)


def _bounded_sin_cos(
    angle: AnyArray, low: float, high: float, offset: float
) -> tuple[AnyArray, AnyArray]:
    """Chebyshev polynomials of sin and cos of (angle + offset) for angle in [low, high]."""
    middle, half = (low + high) / 2, max((high - low) / 2, 1e-3)
    # Remainder of Chebyshev interpolation: 2 (half / 2)^(n + 1) / (n + 1)!
    degree, error = 1, (half / 2) ** 2
    while error > 1e-6 or degree < 2:
        degree += 1
        error *= (half / 2) / (degree + 1)
    x = angle - middle
    out: list[AnyArray] = []
    for f in (np.sin, np.cos):
        nodes = np.polynomial.chebyshev.chebpts1(degree + 1)
        values = f(nodes * half + middle + offset)
        fit = np.polynomial.Chebyshev.fit(nodes * half, values, degree, domain=[-half, half])
        coefficients = fit.convert(kind=np.polynomial.Polynomial).coef
        value = float(coefficients[-2]) + float(coefficients[-1]) * x  # Horner; degree >= 2
        for c in coefficients[-3::-1]:
            value = value * x + float(c)
        out.append(value)
    return out[0], out[1]


# Arithmetic that drops constant zeros and ones while tracing, so that the compiler never gets them.


def _mul(a: Number, b: Number) -> Number:
    for x, y in ((a, b), (b, a)):
        if isinstance(x, float):
            if abs(x) < _TINY:
                return 0.0
            if abs(x - 1) < _TINY:
                return y
            if abs(x + 1) < _TINY:
                return -y
    return a * b


def _sum(*terms: Number) -> Number:
    nonzero = [t for t in terms if not (isinstance(t, float) and abs(t) < _TINY)]
    if not nonzero:
        return 0.0
    total = nonzero[0]
    for term in nonzero[1:]:
        total = total + term
    return total


def _affine(rotation: np.ndarray, translation: np.ndarray, p: Vector) -> Vector:
    x, y, z = (
        _sum(*(_mul(float(rotation[r, k]), p[k]) for k in range(3)), float(translation[r]))
        for r in range(3)
    )
    return x, y, z
