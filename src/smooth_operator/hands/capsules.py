"""The solid parts of a hand as capsules, and which pairs of them could touch.

The shapes that :mod:`smooth_operator.hands.collision` measures with are capsules already in the
built-in hands; boxes, such as palms, become a row of parallel capsules inside them. A capsule is
two points and a radius, so its distance from another is cheap, and differentiable with the points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float, Int

from smooth_operator.geometry import AnyKind, namespace
from smooth_operator.hands.collision import colliding_shapes
from smooth_operator.hands.hand import Hand, landmark_points
from smooth_operator.hands.kinematics import KinematicTree, build_tree
from smooth_operator.hands.membership import own_joints

_POSES = 4000
_SLACK = 0.004
"""Pairs that come no nearer than this in any of the random poses are left out [m]."""
_TINY = 1e-12  # [m^2]
_PARALLEL = 1e-3  # squared sine of an angle that counts as none


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a line segment, fixed to a body.

    Attributes:
        geom: the shape of the model that it stands for.
        body: the body that carries it.
        ends: (2, 3) ends of the segment in the body's frame [m].
        radius: [m].
    """

    geom: int
    body: int
    ends: Float[np.ndarray, "2 3"]
    radius: float


@dataclass(frozen=True, eq=False)
class CapsulePairs:
    """The pairs of capsules that could touch, and the kinematics of their ends.

    Attributes:
        tree: the hand's landmarks, and the ends of all capsules that a pair names.
        names: (2 C) keypoints of the ends in ``tree``: first and second end of each capsule.
        pairs: (P, 2) indices of capsules.
        reach: (P,) sum of the two radii [m].
        shapes: (P, 2) the model's geoms.
    """

    tree: KinematicTree
    names: tuple[str, ...]
    pairs: Int[np.ndarray, "P 2"]
    reach: Float[np.ndarray, " P"]
    shapes: Int[np.ndarray, "P 2"]


def capsule_pairs(hand: Hand) -> CapsulePairs:
    """The pairs that count as self-collision, but for those that no pose brings together.

    They are the pairs of :func:`smooth_operator.hands.collision.penetration_depths`: of two
    fingers, or a finger and the palm, not joined, and not touching in the neutral pose.

    Args:
        hand: the robot hand.

    Returns:
        the pairs; none for a hand without shapes.
    """
    capsules = [c for g in range(hand.model.ngeom) for c in _capsules(hand.model, g)]
    counts = colliding_shapes(hand)
    some = [
        (i, j)
        for i, one in enumerate(capsules)
        for j, other in enumerate(capsules[:i])
        if counts[one.geom, other.geom]
    ]
    pairs = np.array(some, int).reshape(-1, 2)
    if len(pairs):
        pairs = pairs[_nearest(hand, capsules, pairs) < _SLACK]
    used = sorted({int(c) for c in pairs.ravel()})
    kept = [capsules[c] for c in used]
    at = {c: i for i, c in enumerate(used)}
    return CapsulePairs(
        _tree(hand, kept),
        _names(kept),
        np.array([(at[i], at[j]) for i, j in pairs], int).reshape(-1, 2),
        np.array([capsules[i].radius + capsules[j].radius for i, j in pairs], float),
        np.array([(capsules[i].geom, capsules[j].geom) for i, j in pairs], int).reshape(-1, 2),
    )


def segment_parameters(
    first: tuple[AnyKind, AnyKind], second: tuple[AnyKind, AnyKind]
) -> tuple[AnyKind, AnyKind]:
    """Where two line segments are nearest to each other, as shares of their lengths.

    Source: Ericson, "Real-Time Collision Detection" (2005), 5.1.9, without branches.

    Args:
        first, second: (..., 3) ends of a segment; NumPy or JAX.

    Returns:
        (...) shares s, t in [0, 1].
    """
    xp = namespace(first[0])
    along, across = first[1] - first[0], second[1] - second[0]
    between = first[0] - second[0]
    a = xp.maximum((along * along).sum(-1), _TINY)
    e = xp.maximum((across * across).sum(-1), _TINY)
    b, c, f = (along * across).sum(-1), (along * between).sum(-1), (across * between).sum(-1)
    # of parallel segments, which are nearest in many places, some place
    s = xp.clip((b * f - c * e) / xp.maximum(a * e - b * b, _PARALLEL * a * e), 0.0, 1.0)
    t = xp.clip((b * s + f) / e, 0.0, 1.0)
    s = xp.clip((b * t - c) / a, 0.0, 1.0)
    return s, t


def _nearest(hand: Hand, capsules: list[Capsule], pairs: np.ndarray) -> np.ndarray:
    """(P,) smallest clearance over random poses [m]."""
    low, high = hand.limits.T
    q = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    tree = _tree(hand, capsules)
    points = np.asarray(tree.positions(hand.expand(q)))
    ends = points[:, [tree.names.index(name) for name in _names(capsules)]]
    out = np.full(len(pairs), np.inf)
    for p, (i, j) in enumerate(pairs):
        one, other = ((ends[:, 2 * c], ends[:, 2 * c + 1]) for c in (i, j))
        s, t = segment_parameters(one, other)
        apart = (
            one[0] + s[:, None] * (one[1] - one[0]) - other[0] - t[:, None] * (other[1] - other[0])
        )
        out[p] = np.linalg.norm(apart, axis=-1).min() - capsules[i].radius - capsules[j].radius
    return out


def _names(capsules: list[Capsule]) -> tuple[str, ...]:
    return tuple(f"capsule {i} {end}" for i in range(len(capsules)) for end in "ab")


def _tree(hand: Hand, capsules: list[Capsule]) -> KinematicTree:
    points = {
        name: (capsules[i // 2].body, capsules[i // 2].ends[i % 2])
        for i, name in enumerate(_names(capsules))
    }
    palm = hand.model.body(hand.spec.palm).id
    return build_tree(
        hand.model,
        palm,
        points | landmark_points(hand.model, hand.spec),
        own_joints(hand.model, palm),
    )


def _capsules(model: mujoco.MjModel, geom: int) -> Iterator[Capsule]:
    """Capsules that fill a shape from within."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), np.array(model.geom_size[geom])
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    rotation, centre = matrix.reshape(3, 3), np.array(model.geom_pos[geom])
    body = int(model.geom_bodyid[geom])

    def capsule(middle: np.ndarray, axis: np.ndarray, half: float, radius: float) -> Capsule:
        ends = np.stack([middle - half * axis, middle + half * axis])
        return Capsule(geom, body, ends @ rotation.T + centre, radius)

    unit, origin = np.eye(3), np.zeros(3)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        yield capsule(origin, unit[2], float(size[1]), float(size[0]))
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        yield capsule(origin, unit[2], 0.0, float(size[0]))
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        yield capsule(
            origin,
            unit[2],
            max(float(size[1] - size[0]), 0.0),
            float(size.min(initial=1, where=size > 0)),
        )
    elif kind in (
        mujoco.mjtGeom.mjGEOM_BOX,
        mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        mujoco.mjtGeom.mjGEOM_MESH,
    ):
        half = size
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            centre = centre + rotation @ model.geom_aabb[geom][:3]
            half = np.array(model.geom_aabb[geom][3:])
        thin, wide, long = np.argsort(half)
        radius = float(half[thin])
        if kind != mujoco.mjtGeom.mjGEOM_BOX:  # round rather than square: one, of the middle width
            radius = float(np.sqrt(half[thin] * half[wide]))
            yield capsule(origin, unit[long], max(float(half[long]) - radius, 0.0), radius)
            return
        spread = float(half[wide]) - radius
        rows = 1 + int(np.ceil(2 * spread / radius)) if spread > 0.1 * radius else 1
        for shift in np.linspace(-spread, spread, rows) if rows > 1 else (0.0,):
            yield capsule(shift * unit[wide], unit[long], float(half[long]) - radius, radius)
