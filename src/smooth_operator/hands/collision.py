"""Collision shapes of a hand: which pairs of them count, and capsules that fill the shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS

PALM: Final = -1
"""Value of ``owners`` for the palm and all else that belongs to no finger."""


def colliding_shapes(hand: Hand) -> Bool[np.ndarray, "g g"]:
    """(g, g) mask of the pairs of the model's shapes that count in ``penetration_depths``."""
    counts = counting_pairs(hand)
    if counts.any():
        neutral, depth = shape_overlaps(
            hand, mujoco.MjData(hand.model), hand.full_configuration(hand.neutral)
        )
        touching = neutral[depth > 0]
        counts[touching[:, 0], touching[:, 1]] = counts[touching[:, 1], touching[:, 0]] = False
    return counts


def shape_overlaps(
    hand: Hand, data: mujoco.MjData, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(c, 2) pairs of shapes in contact, and (c,) their depths [m]."""
    model = hand.model
    data.qpos[:] = hand.qpos(pose)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    # copies: the next pose reuses the memory
    return np.array(data.contact.geom).reshape(-1, 2), -np.array(data.contact.dist)


def counting_pairs(hand: Hand) -> Bool[np.ndarray, "g g"]:
    """(g, g) mask of the pairs of shapes on different parts of the hand that are not joined."""
    model = hand.model
    owner = owners(hand)[model.geom_bodyid]
    # bodies without a joint between them are one part
    part = model.body_weldid[model.geom_bodyid]
    above = model.body_weldid[model.body_parentid[part]]
    joined = (part[:, None] == above[None]) | (above[:, None] == part[None])
    solid = solid_shapes(hand)
    different = owner[:, None] != owner[None]
    return np.asarray(different & ~joined & solid[:, None] & solid[None])


def solid_shapes(hand: Hand) -> Bool[np.ndarray, " g"]:
    """(g,) mask of the hand's colliding shapes, without those of an arm or a second hand."""
    model = hand.model
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return np.asarray(solid & hand.bodies[model.geom_bodyid])


def lacking_parts(hand: Hand) -> set[int]:
    """Parts that lost shapes; all parts of a hand without any colliding shape."""
    model = hand.model
    part = np.asarray(model.body_weldid)
    if solid_shapes(hand).any():
        return {int(part[model.body(name).id]) for name in hand.unreadable}
    return {int(p) for p in part[hand.bodies]}


def owners(hand: Hand) -> Int[np.ndarray, " bodies"]:
    """Index of each body's finger in ``FINGERS``, or ``PALM``.

    A finger consists of the bodies between palm and fingertip that it shares with no other finger,
    and of all bodies that hang from them.
    """
    model = hand.model
    palm = model.body(hand.spec.palm).id
    chains = []
    for finger in hand.spec.fingers:
        chain, body = set(), model.body(finger.tip.body).id
        while body not in (palm, 0):
            chain.add(int(body))
            body = model.body_parentid[body]
        chains.append(chain)
    owner = np.full(model.nbody, PALM)
    for body in range(1, model.nbody):  # parents come first
        of = [
            FINGERS.index(f.name)
            for f, c in zip(hand.spec.fingers, chains, strict=True)
            if body in c
        ]
        owner[body] = (
            of[0] if len(of) == 1 else owner[model.body_parentid[body]] if not of else PALM
        )
    return owner


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a line segment, fixed to a body.

    Attributes:
        geom: shape of the model that it fills; -1 for a stand-in of a link without one.
        body: body that carries it.
        ends: (2, 3) ends of the segment in the body's frame [m].
        radius: radius [m].
        root: True for a stand-in for the first bone of a finger, which is joined to the palm.
    """

    geom: int
    body: int
    ends: Float[np.ndarray, "2 3"]
    radius: float
    root: bool = False


def shape_capsules(model: mujoco.MjModel, geom: int) -> Iterator[Capsule]:
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
        if kind != mujoco.mjtGeom.mjGEOM_BOX:  # rounder than a box: one capsule of a mean width
            radius = float(np.sqrt(half[thin] * half[wide]))
            yield capsule(origin, unit[long], max(float(half[long]) - radius, 0.0), radius)
            return
        spread = float(half[wide]) - radius
        rows = 1 + int(np.ceil(2 * spread / radius)) if spread > 0.1 * radius else 1
        for shift in np.linspace(-spread, spread, rows) if rows > 1 else (0.0,):
            yield capsule(shift * unit[wide], unit[long], float(half[long]) - radius, radius)
