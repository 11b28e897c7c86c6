"""Rows of rods that fill a flat mesh, such as a palm."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float

_TINY: Final = 1e-9  # [m]


def mesh_rods(
    model: mujoco.MjModel,
    geom: int,
    axes: tuple[int, int, int],
    rows: Float[np.ndarray, " n"],
    thick: float,
) -> list[tuple[np.ndarray, float, float]]:
    """Parallel rods across a flat mesh, each as thick and long as the mesh is in its strip.

    Args:
        axes: thin, wide and long axis of the mesh.
        rows: middle of each strip along the wide axis, in the mesh's frame [m].
        thick: half the width of a strip [m].

    Returns:
        middle, half a length without caps, and radius of each rod [m].
    """
    thin, wide, long = axes
    edges = _mesh_edges(model, geom)
    rods = []
    for at in rows:
        points = _within(edges, wide, at - thick, at + thick)
        if not len(points):
            continue
        low, high = points.min(axis=0), points.max(axis=0)
        place, radius = (low + high) / 2, float(high[thin] - low[thin]) / 2
        place[wide] = at
        if radius > 0:
            rods.append((place, max(float(high[long] - low[long]) / 2 - radius, 0.0), radius))
    return rods


def _within(
    edges: Float[np.ndarray, "e 2 3"], axis: int, low: float, high: float
) -> Float[np.ndarray, "n 3"]:
    """Ends of the parts of edges that lie between two planes."""
    first, last = edges[:, 0], edges[:, 1]
    run = last[:, axis] - first[:, axis]
    steep = np.where(np.abs(run) < _TINY, np.inf, run)
    shares = (np.array([[low], [high]]) - first[:, axis]) / steep
    start, end = np.clip(shares.min(axis=0), 0, 1), np.clip(shares.max(axis=0), 0, 1)
    flat = np.isinf(steep)
    start, end = np.where(flat, 0.0, start), np.where(flat, 1.0, end)
    inside = np.where(flat, (first[:, axis] >= low) & (first[:, axis] <= high), end > start)
    start, end = start[inside, None], end[inside, None]
    first, last = first[inside], last[inside]
    return np.concatenate([first + start * (last - first), first + end * (last - first)])


def _mesh_edges(model: mujoco.MjModel, geom: int) -> Float[np.ndarray, "e 2 3"]:
    mesh = int(model.geom_dataid[geom])
    faces = model.mesh_face[int(model.mesh_faceadr[mesh]) :][: int(model.mesh_facenum[mesh])]
    vertices = model.mesh_vert[int(model.mesh_vertadr[mesh]) :]
    return np.asarray(vertices[faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)], float)
