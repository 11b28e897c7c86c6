"""Points with outward normals on the surfaces of a hand's links, and their positions in a pose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from smooth_operator.hand_discovery.skeleton import shape_points
from smooth_operator.hands.capsules import hand_capsules
from smooth_operator.hands.collision import Capsule
from smooth_operator.hands.hand import Hand, tree_with

SPACING: Final = 0.002
"""Distance of neighbouring points on a surface [m]."""


class SurfacePoints(NamedTuple):
    """Points on the surfaces of links.

    Attributes:
        bodies: (N,) body of each point.
        points: (N, 3) positions in the body's frame [m].
        normals: (N, 3) outward unit normals in the body's frame.
    """

    bodies: Int[np.ndarray, " N"]
    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]

    def only(self, chosen: np.ndarray) -> SurfacePoints:
        """The points of a mask or of indices."""
        return SurfacePoints(*(array[chosen] for array in self))


def surface_points(hand: Hand, bodies: Sequence[int]) -> SurfacePoints:
    """Points on the collision shapes of some bodies, about ``SPACING`` apart.

    A mesh counts as its convex hull, as in MuJoCo's collisions. A shape that is not there or that
    can't be read is the capsules that stand in for it.
    """
    parts: list[tuple[int, np.ndarray, np.ndarray]] = []
    for body, corners in _solids(hand):
        if body in bodies:
            points, normals = _on_hull(corners)
            parts.append((body, points, normals))
    if not parts:
        return SurfacePoints(np.empty(0, int), np.empty((0, 3)), np.empty((0, 3)))
    of = np.concatenate([np.full(len(points), body) for body, points, _ in parts])
    return SurfacePoints(
        of, np.concatenate([p for _, p, _ in parts]), np.concatenate([n for *_, n in parts])
    )


class PosedBodies:
    """Positions of surface points in the palm frame, for many poses at a time.

    Args:
        hand: the hand.
        bodies: bodies that are posed.
    """

    def __init__(self, hand: Hand, bodies: Sequence[int]) -> None:
        self._bodies = sorted(set(bodies))
        corners = np.vstack([np.zeros(3), np.eye(3)])
        points = {
            f"frame {body} {k}": (body, corner)
            for body in self._bodies
            for k, corner in enumerate(corners)
        }
        self._tree = tree_with(hand, points)
        self._names = list(points)

    def __call__(
        self, q: Float[np.ndarray, "T n"], surface: SurfacePoints
    ) -> tuple[Float[np.ndarray, "T N 3"], Float[np.ndarray, "T N 3"]]:
        """Positions [m] and normals of points at (T, n) positions of all joints [rad]."""
        columns = list(np.ascontiguousarray(np.asarray(q, float).T))
        frames = np.empty((len(q), len(self._bodies), 4, 3))
        flat = frames.reshape(len(q), -1, 3)
        for k, corner in enumerate(self._tree.forward_kinematics(columns, self._names)):
            for axis, values in enumerate(corner):
                flat[:, k, axis] = values  # a coordinate that no joint moves is one number
        points, normals = (np.empty((len(q), len(surface.bodies), 3)) for _ in range(2))
        for body in np.unique(surface.bodies):
            own, frame = surface.bodies == body, frames[:, self._bodies.index(int(body))]
            turns = frame[:, 1:] - frame[:, :1]  # rows: the body's axes
            points[:, own] = surface.points[own] @ turns + frame[:, :1]
            normals[:, own] = surface.normals[own] @ turns
        return points, normals


def _solids(hand: Hand) -> Iterator[tuple[int, Float[np.ndarray, "n 3"]]]:
    """Body and corners, in its frame [m], of each shape."""
    model = hand.model
    geoms = dict[int, Capsule]()
    for capsule in hand_capsules(hand):
        if capsule.geom < 0:
            ball = shape_points(mujoco.mjtGeom.mjGEOM_SPHERE, np.array([capsule.radius]))
            ends = [ball + end for end in capsule.ends]
            yield capsule.body, np.concatenate(ends)
        geoms[capsule.geom] = capsule
    for geom in geoms.keys() - {-1}:
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
        corners = _corners(model, geom) @ matrix.reshape(3, 3).T + model.geom_pos[geom]
        yield int(model.geom_bodyid[geom]), corners


def _corners(model: mujoco.MjModel, geom: int) -> Float[np.ndarray, "n 3"]:
    """Points whose convex hull is a shape, in the shape's frame [m]."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    if kind != mujoco.mjtGeom.mjGEOM_MESH:
        return shape_points(kind, model.geom_size[geom])
    mesh = int(model.geom_dataid[geom])
    first = int(model.mesh_vertadr[mesh])
    return np.asarray(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], float)


def _on_hull(
    corners: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Points and normals on the convex hull of corners."""
    hull = ConvexHull(corners, qhull_options="QJ")
    faces, normals = corners[hull.simplices], hull.equations[:, :3]
    longest = np.linalg.norm(faces - np.roll(faces, 1, axis=1), axis=-1).max(axis=1)
    points, of = list[np.ndarray](), list[np.ndarray]()
    steps = np.maximum(np.ceil(longest / SPACING).astype(int), 1)
    for step in np.unique(steps):
        own = np.flatnonzero(steps == step)
        i, j = np.nonzero(np.tri(step, dtype=bool)[::-1])
        weights = (np.stack([i, j, step - 1 - i - j], axis=-1) + 1 / 3) / step
        points.append((weights @ faces[own]).reshape(-1, 3))
        of.append(np.repeat(own, len(weights)))
    every, face = np.concatenate(points), np.concatenate(of)
    _, first = np.unique(np.round(every / SPACING).astype(int), axis=0, return_index=True)
    return every[first], normals[face[first]]
