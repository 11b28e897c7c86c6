"""Fills the shapes of a model with capsules."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a line segment, fixed to a body.

    Attributes:
        geom: the shape of the model that it fills; -1 for a stand-in of a link without any.
        body: the body that carries it.
        ends: (2, 3) ends of the segment in the body's frame [m].
        radius: [m].
        root: whether it stands in for the first bone of a finger, which is joined to the palm.
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
        if kind != mujoco.mjtGeom.mjGEOM_BOX:  # round rather than square: one, of the middle width
            radius = float(np.sqrt(half[thin] * half[wide]))
            yield capsule(origin, unit[long], max(float(half[long]) - radius, 0.0), radius)
            return
        spread = float(half[wide]) - radius
        rows = 1 + int(np.ceil(2 * spread / radius)) if spread > 0.1 * radius else 1
        for shift in np.linspace(-spread, spread, rows) if rows > 1 else (0.0,):
            yield capsule(shift * unit[wide], unit[long], float(half[long]) - radius, radius)
