"""Signed distance of a point to the shapes of a body."""

from __future__ import annotations

from typing import Any, Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import require
from smooth_operator.hands.hand import Hand

_G: Final = mujoco.mjtGeom


def part_distances(hand: Hand, body: int, point: Float[np.ndarray, "3"]) -> dict[int, float]:
    """Signed distances of a point that is fixed to a body, in the hand's neutral pose.

    Args:
        hand: the hand.
        body: body of the model.
        point: (3,) in the body's frame [m].

    Returns:
        part (a body; those fixed to each other are one, named after the first) -> distance to the
        nearest of its shapes [m], negative inside; parts without shapes are left out.
    """
    model, data = hand.model, mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
    mujoco.mj_kinematics(model, data)
    at = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
    out: dict[int, float] = {}
    for geom in range(model.ngeom):
        if not hand.bodies[model.geom_bodyid[geom]]:
            continue
        local = data.geom_xmat[geom].reshape(3, 3).T @ (at - data.geom_xpos[geom])
        distance = _distance(model, geom, local)
        if distance is not None:
            part = int(model.body_weldid[model.geom_bodyid[geom]])
            out[part] = min(distance, out.get(part, np.inf))
    return out


def _distance(model: mujoco.MjModel, geom: int, p: np.ndarray) -> float | None:
    """Signed distance of a point in the shape's own frame; None for shapes without a volume."""
    kind, size = int(model.geom_type[geom]), np.asarray(model.geom_size[geom], float)
    if kind == _G.mjGEOM_SPHERE:
        return float(np.linalg.norm(p) - size[0])
    if kind == _G.mjGEOM_CAPSULE:
        axis = np.array([0.0, 0.0, np.clip(p[2], -size[1], size[1])])
        return float(np.linalg.norm(p - axis) - size[0])
    if kind == _G.mjGEOM_CYLINDER:
        return _corner(np.array([np.hypot(p[0], p[1]) - size[0], abs(p[2]) - size[1]]))
    if kind == _G.mjGEOM_BOX:
        return _corner(abs(p) - size)
    if kind == _G.mjGEOM_ELLIPSOID:
        # exact on the surface, and good enough near it
        scaled = np.linalg.norm(p / size)
        slope = np.linalg.norm(p / size**2)
        return float(scaled * (scaled - 1) / slope) if slope > 0 else -float(size.min())
    if kind == _G.mjGEOM_MESH:
        return _mesh_distance(model, int(model.geom_dataid[geom]), p)
    return None


def _corner(past: np.ndarray) -> float:
    """Distance to a box, by how far the point is past each pair of faces."""
    return float(np.linalg.norm(np.maximum(past, 0)) + min(past.max(), 0.0))


def _mesh_distance(model: mujoco.MjModel, mesh: int, p: np.ndarray) -> float:
    require("the shape of a mesh", "lab", "trimesh")
    import trimesh

    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = np.asarray(model.mesh_vert[first : first + count], float)
    face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corners: np.ndarray = vertices[np.asarray(model.mesh_face[face : face + faces])]
    closest_point: Any = trimesh.triangles.closest_point
    nearest = closest_point(corners, np.tile(p, (faces, 1)))
    distance = float(np.linalg.norm(nearest - p, axis=1).min())
    return -distance if _winding(corners - p) > 0.5 else distance


def _winding(corners: Float[np.ndarray, "n 3 3"]) -> float:
    """Winding number of a mesh around the origin, by its solid angles: 1 inside, 0 outside.

    Small holes, as vendors' meshes have, change it little (van Oosterom and Strackee 1983).
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    rest = la * lb * lc
    for u, v, length in ((a, b, lc), (b, c, la), (c, a, lb)):
        rest = rest + np.einsum("ij,ij->i", u, v) * length
    return abs(float(np.arctan2(volume, rest).sum())) / (2 * np.pi)
