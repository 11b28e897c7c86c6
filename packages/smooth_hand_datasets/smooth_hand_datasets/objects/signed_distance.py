"""Signed distances of points from objects: primitives in closed form, meshes exactly or by grids.

A distance is negative inside. ``signed_distance`` is traceable: its shapes are pytrees of numbers,
so that objects of one kind share a compiled program whatever their size. A mesh is measured exactly
by libigl, on the host; compiled programs interpolate a grid of such distances.

Source of the primitives: Quilez, "Distance functions" (iquilezles.org). Sign of a mesh: Barill et
al., "Fast Winding Numbers for Soups and Clouds" (ACM ToG 37, 2018), good for meshes with holes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.errors import RecordingError, reason, require
from smooth_operator.geometry import AnyArray, AnyKind, array_namespace

CELLS: Final = 64
"""Number of points of a grid along each axis."""
MARGIN_M: Final = 0.02
"""Distance by which a grid extends beyond the mesh [m]."""
SMALLEST_M: Final = 0.001
LARGEST_M: Final = 5.0
"""Bounds of the size of a mesh [m]; outside them, its unit is assumed not to be metres."""
FAR_M: Final = 10.0
"""Distance that stands for an object whose pose is unknown [m]."""

_TINY: Final = 1e-18  # [m^2]
_STEP: Final = 1e-6  # of central differences [m]


class Sphere(NamedTuple):
    """A sphere about the origin.

    Attributes:
        radius: [m].
    """

    radius: AnyArray | float


class Box(NamedTuple):
    """A box about the origin, along the axes.

    Attributes:
        half: (3,) half of its extents [m].
    """

    half: AnyArray


class Cylinder(NamedTuple):
    """A cylinder about the origin, along z.

    Attributes:
        radius: [m].
        half: half of its length [m].
    """

    radius: AnyArray | float
    half: AnyArray | float


class Capsule(NamedTuple):
    """A capsule about the origin, along z: all points within a radius of a segment.

    Attributes:
        radius: [m].
        half: half of the segment's length [m].
    """

    radius: AnyArray | float
    half: AnyArray | float


class Grid(NamedTuple):
    """Distances at the points of a regular grid, interpolated linearly along each axis.

    Attributes:
        values: (X, Y, Z) distances [m].
        low: (3,) the first point [m].
        step: (3,) between points [m].
    """

    values: AnyArray
    low: AnyArray
    step: AnyArray


Shape: TypeAlias = Sphere | Box | Cylinder | Capsule | Grid


def signed_distance(shape: Shape, points: AnyKind) -> AnyKind:
    """Computes the distance of points from a surface, negative inside.

    Args:
        shape: the object, in its own frame.
        points: (..., 3) in that frame [m]; NumPy or JAX.

    Returns:
        (...) [m].
    """
    xp = array_namespace(points)
    out: AnyKind
    if isinstance(shape, Sphere):
        out = _norm(points, xp) - shape.radius
    elif isinstance(shape, Box):
        out = _corner(abs(points) - shape.half, xp)
    elif isinstance(shape, Cylinder):
        across = _norm(points[..., :2], xp) - shape.radius
        out = _corner(xp.stack([across, abs(points[..., 2]) - shape.half], axis=-1), xp)
    elif isinstance(shape, Capsule):
        beyond = points[..., 2] - xp.clip(points[..., 2], -shape.half, shape.half)
        ends = xp.concatenate([points[..., :2], beyond[..., None]], axis=-1)
        out = _norm(ends, xp) - shape.radius
    else:
        out = _interpolated(shape, points, xp)
    return out


def _norm(vector: Any, xp: Any) -> Any:
    return xp.sqrt((vector * vector).sum(axis=-1) + _TINY)


def _corner(beyond: Any, xp: Any) -> Any:
    """Distance from a corner region, given the distances beyond each of its sides."""
    return _norm(xp.maximum(beyond, 0.0), xp) + xp.minimum(beyond.max(axis=-1), 0.0)


def _interpolated(grid: Grid, points: Any, xp: Any) -> Any:
    size = np.array(grid.values.shape)
    place = (points - grid.low) / grid.step
    within = xp.clip(place, 0, size - 1)
    cell = xp.clip(xp.floor(within), 0, size - 2).astype(np.int32)
    share = within - cell
    total: Any = 0.0
    for corner in np.ndindex(2, 2, 2):
        at = tuple(cell[..., axis] + corner[axis] for axis in range(3))
        weight: Any = 1.0
        for axis in range(3):
            weight = weight * (share[..., axis] if corner[axis] else 1.0 - share[..., axis])
        total = total + weight * grid.values[at]
    return total + _norm((place - within) * grid.step, xp)


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh, whose distances are computed exactly.

    Attributes:
        vertices: (V, 3) [m].
        faces: (F, 3) indices of vertices, counter-clockwise from outside.
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]

    def nearest(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Signed distances [m] and the nearest points of the surface [m]."""
        import igl

        if not len(points):
            return np.empty(0), np.empty((0, 3))
        results = igl.signed_distance(
            np.ascontiguousarray(points, np.float64),
            np.ascontiguousarray(self.vertices, np.float64),
            np.ascontiguousarray(self.faces, np.int64),
            igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER,
        )
        place = np.asarray(results[2], np.float64)
        # libigl's value is weighted by an approximate winding number: only its sign is taken
        sign = np.where(np.asarray(results[0]).ravel() < 0, -1.0, 1.0)
        return sign * np.linalg.norm(points - place, axis=-1), place

    def grid(self, cells: int = CELLS, margin: float = MARGIN_M) -> Grid:
        """Computes a grid of distances in the box around the mesh.

        Args:
            cells: points along each axis.
            margin: distance by which the grid extends beyond the mesh [m].
        """
        low, high = self.vertices.min(axis=0) - margin, self.vertices.max(axis=0) + margin
        axes = [np.linspace(low[i], high[i], cells) for i in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        values = self.nearest(points)[0].reshape(cells, cells, cells)
        step = (high - low) / (cells - 1)
        return Grid(values.astype(np.float32), low.astype(np.float32), step.astype(np.float32))


@dataclass(frozen=True, eq=False)
class Solid:
    """The shape of an object, for compiled programs and for exact measurement.

    Attributes:
        shape: arrays for compiled programs.
        mesh: the exact shape behind a grid; None for a primitive, which is exact itself.
    """

    shape: Shape
    mesh: Mesh | None = None

    def distance(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        """Exact signed distances [m] of points in the object's frame, on the host."""
        if self.mesh is None:
            return np.asarray(signed_distance(self.shape, np.asarray(points, np.float64)))
        flat = np.asarray(points, np.float64).reshape(-1, 3)
        return self.mesh.nearest(flat)[0].reshape(points.shape[:-1])

    def nearest(
        self, points: Float[np.ndarray, "*n 3"]
    ) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n 3"], Float[np.ndarray, "*n 3"]]:
        """Signed distances, nearest points of the surface and outward normals there [m].

        Args:
            points: (..., 3) in the object's frame [m].
        """
        points = np.asarray(points, np.float64)
        if self.mesh is not None:
            flat = points.reshape(-1, 3)
            distance, place = self.mesh.nearest(flat)
            away = (flat - place) * np.sign(distance)[:, None]
            size = np.linalg.norm(away, axis=-1, keepdims=True)
            normal = away / np.maximum(size, 1e-9)
            shape = points.shape
            return distance.reshape(shape[:-1]), place.reshape(shape), normal.reshape(shape)
        distance = self.distance(points)
        slopes = [
            (self.distance(points + _STEP * e) - self.distance(points - _STEP * e)) / (2 * _STEP)
            for e in np.eye(3)
        ]
        normal = np.stack(slopes, axis=-1)
        normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        return distance, points - distance[..., None] * normal, normal


def read_solid(path: Path, scale: float = 1.0) -> Solid:
    """Reads a shape from a mesh file: OBJ, PLY, STL, OFF or GLB.

    Args:
        path: the file.
        scale: factor from its units to metres.

    Raises:
        RecordingError: the file is not a mesh, or its size suggests another unit.
        MissingExtraError: trimesh or libigl is not installed.
    """
    try:
        stat = path.stat()
    except OSError as error:
        raise RecordingError(f"{path}: the mesh of an object can't be read ({error})") from error
    return _read_solid(path, scale, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=64)
def _read_solid(path: Path, scale: float, changed: int, size: int) -> Solid:
    del changed, size  # part of the cache's key: a file that is written again is read again
    require("reading the mesh of an object", "objects", "igl", "trimesh")
    import trimesh

    try:
        loaded: Any = trimesh.load(path, force="mesh", skip_materials=True)
        vertices, faces = (
            np.asarray(loaded.vertices, np.float64),
            np.asarray(loaded.faces, np.int64),
        )
    except Exception as error:  # what trimesh raises depends on the format
        raise RecordingError(
            f"{path}: it can't be read as a mesh (OBJ, PLY, STL, OFF, GLB): "
            f"{type(error).__name__}: {reason(error)}"
        ) from error
    vertices = vertices * scale
    if not len(faces) or not np.isfinite(vertices).all():
        raise RecordingError(f"{path}: expected a mesh with triangles and finite vertices")
    extent = float(np.ptp(vertices, axis=0).max())
    if not SMALLEST_M <= extent <= LARGEST_M:
        raise RecordingError(
            f"{path}: the mesh is {extent:.4g} m long at scale {scale:g}; expected "
            f"{SMALLEST_M:g} to {LARGEST_M:g} m: set the factor from its units to metres"
        )
    mesh = Mesh(vertices, faces)
    return Solid(mesh.grid(), mesh)
