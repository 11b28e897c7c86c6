"""Points on the shapes of a model, body by body."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import require

_RINGS: Final = 13  # along a cylinder or the edge of a box
_COARSE: Final = 300  # vertices of a mesh
_ROUND: Final = 400  # points on a sphere: its extent along any direction to half a per cent


def geom_points(model: mujoco.MjModel) -> dict[int, list[Float[np.ndarray, "p 3"]]]:
    """Points on each shape of a compiled model.

    Returns:
        body -> one (p, 3) array a shape, in the body's frame [m]; planes and terrain left out.
    """
    out: dict[int, list[np.ndarray]] = defaultdict(list)
    rotation = np.empty(9)
    for g in range(model.ngeom):
        kind = mujoco.mjtGeom(int(model.geom_type[g]))
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = int(model.geom_dataid[g])
            first = int(model.mesh_vertadr[mesh])
            points = np.asarray(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])])
            face = int(model.mesh_faceadr[mesh])
            faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
            points = _denser(points.astype(np.float64), np.asarray(faces))
        else:
            points = _primitive(kind, model.geom_size[g])
        if len(points):
            mujoco.mju_quat2Mat(rotation, model.geom_quat[g])
            placed = points.astype(float) @ rotation.reshape(3, 3).T + model.geom_pos[g]
            out[int(model.geom_bodyid[g])].append(placed)
    return dict(out)


def urdf_mesh_points(
    root: ElementTree.Element, files: Mapping[str, Path]
) -> tuple[dict[str, list[Float[np.ndarray, "p 3"]]], int]:
    """Points of the meshes of a URDF that MuJoCo could not load itself.

    Args:
        root: root element of the URDF.
        files: its mesh files, by the names that it has for them.

    Returns:
        link -> one (p, 3) array a mesh, in the link's frame [m]; and how many could not be read.
    """
    out: dict[str, list[np.ndarray]] = defaultdict(list)
    missing = 0
    for link in root.findall("link"):
        for part in [*link.findall("visual"), *link.findall("collision")]:
            mesh = part.find("geometry/mesh")
            if mesh is None:
                continue
            file = files.get(mesh.get("filename", ""))
            vertices = _vertices(file) if file else None
            if vertices is None:
                missing += 1
                continue
            try:
                scale = np.array([float(s) for s in mesh.get("scale", "1 1 1").split()])
                rotation, position = _origin(part.find("origin"))
            except ValueError:
                missing += 1
                continue
            out[link.get("name", "")].append(vertices * scale @ rotation.T + position)
    return dict(out), missing


def _vertices(path: Path) -> np.ndarray | None:
    require("the shape of a mesh", "lab", "trimesh")
    import trimesh

    try:
        mesh: Any = trimesh.load(path, force="mesh", process=False)
        vertices = _denser(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces))
    except Exception:  # a mesh that can't be read counts as missing, whatever its reader says
        return None
    return vertices if len(vertices) and np.isfinite(vertices).all() else None


def _denser(vertices: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, "p 3"]:
    """Points along the edges as well, of a mesh so coarse that its corners alone say little."""
    if len(vertices) >= _COARSE or not len(faces):
        return vertices
    corners = vertices[faces]  # (f, 3, 3)
    share = np.linspace(0, 1, _RINGS)[1:-1, None, None, None]
    edges = corners + share * (np.roll(corners, 1, axis=1) - corners)
    return np.concatenate([vertices, edges.reshape(-1, 3)])


def _origin(element: ElementTree.Element | None) -> tuple[np.ndarray, np.ndarray]:
    if element is None:
        return np.eye(3), np.zeros(3)
    roll, pitch, yaw = (float(a) for a in element.get("rpy", "0 0 0").split())
    quat, out = np.empty(4), np.empty(9)
    mujoco.mju_euler2Quat(quat, [roll, pitch, yaw], "XYZ")  # fixed axes, as URDF has them
    mujoco.mju_quat2Mat(out, quat)
    position = np.array([float(c) for c in element.get("xyz", "0 0 0").split()])
    return out.reshape(3, 3), position


def _primitive(kind: mujoco.mjtGeom, sizes: np.ndarray) -> Float[np.ndarray, "p 3"]:
    """Points all over the surface, not at its corners alone: sections of it are looked at."""
    size = np.asarray(sizes, np.float64)
    points: np.ndarray
    ball = _sphere()
    steps = np.linspace(-1, 1, _RINGS)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        points = grid[abs(grid).max(axis=1) == 1] * size
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        points = ball * size[0]
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        points = ball * size
    elif kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
        angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(48)], axis=1) * size[0]
        up = np.array([0.0, 0.0, size[1]])
        parts = [ring + step * up for step in steps]
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            parts += [ball * size[0] + up, ball * size[0] - up]
        points = np.concatenate(parts)
    else:
        points = np.empty((0, 3))
    return points


def _sphere() -> np.ndarray:
    """A Fibonacci lattice, with both poles."""
    i = np.arange(_ROUND)
    z = np.linspace(-1, 1, _ROUND)
    angle = i * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
