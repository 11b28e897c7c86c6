"""Collision shapes of a hand, the fingers to which they belong, and capsules that fill them."""

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
"""Value of ``owners`` for the palm and everything else that belongs to no finger."""
_FLAT: Final = 1.5  # width over thickness from which a mesh is a row of capsules
_APART: Final = 0.006  # distance of a thin plate's rods, between which no finger fits [m]
_SLENDER: Final = 0.02  # largest radius of a cylinder that is one capsule [m]
_RIM: Final = 0.35  # radius of a wide cylinder's outer capsules, over the cylinder's
_RING: Final = 10  # number of them
_TINY: Final = 1e-9  # [m]


def solid_shapes(hand: Hand) -> Bool[np.ndarray, " g"]:
    """(g,) mask of the hand's shapes that collide, judging by their masks or declared pairs. If no
    shape collides, those in groups 3 and 4 count, which models use for collision."""
    model = hand.model
    own = hand.bodies[model.geom_bodyid]
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    solid[model.pair_geom1] = solid[model.pair_geom2] = True
    if not (solid & own).any():
        primitive = model.geom_type != mujoco.mjtGeom.mjGEOM_MESH
        solid = primitive & np.isin(model.geom_group, (3, 4))
    return np.asarray(solid & own)


def lacking_parts(hand: Hand) -> set[int]:
    """Parts of a hand that lost shapes, or all parts if the hand has no colliding shape."""
    model = hand.model
    part = np.asarray(model.body_weldid)
    if solid_shapes(hand).any():
        return {int(part[model.body(name).id]) for name in hand.unreadable}
    return {int(p) for p in part[hand.bodies]}


def owners(hand: Hand) -> Int[np.ndarray, " bodies"]:
    """Index in ``FINGERS`` of each body's finger, or ``PALM``. A finger consists of the bodies from
    palm to fingertip that it shares with no other finger, and of everything attached to them."""
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
    """Fills a shape from within with capsules: one for a capsule, a sphere, a slender cylinder or a
    rod-shaped mesh; a ring around a core for a wide cylinder; a row for a box or a flat mesh."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), np.array(model.geom_size[geom])
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    rotation, centre = matrix.reshape(3, 3), np.array(model.geom_pos[geom])
    body = int(model.geom_bodyid[geom])
    kinds = mujoco.mjtGeom
    rods: list[tuple[np.ndarray, float, float]] = []  # middle, half a length without caps, radius
    axis = 2
    if kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_SPHERE):
        rods = [(np.zeros(3), float(size[1]) * (kind == kinds.mjGEOM_CAPSULE), float(size[0]))]
    elif kind == kinds.mjGEOM_CYLINDER:
        rods = _cylinder_rods(float(size[0]), float(size[1]))
    elif kind in (kinds.mjGEOM_BOX, kinds.mjGEOM_ELLIPSOID, kinds.mjGEOM_MESH):
        middle, half = np.zeros(3), size
        if kind == kinds.mjGEOM_MESH:
            middle, half = np.array(model.geom_aabb[geom]).reshape(2, 3)
        thin, wide, axis = (int(i) for i in np.argsort(half))
        thick, shifts = float(half[thin]), strip_shifts(float(half[thin]), float(half[wide]))
        if kind == kinds.mjGEOM_BOX:
            rods = [(s * np.eye(3)[wide], float(half[axis]) - thick, thick) for s in shifts]
        elif kind == kinds.mjGEOM_MESH and half[wide] > _FLAT * thick:
            rods = _mesh_rods(model, geom, (thin, wide, axis), middle[wide] + shifts, thick)
        else:  # rounder than a box: one capsule of a mean width
            radius = float(np.sqrt(thick * half[wide]))
            rods = [(middle, max(float(half[axis]) - radius, 0.0), radius)]
    for middle, length, radius in rods:
        ends = middle + length * np.outer((-1, 1), np.eye(3)[axis])
        yield Capsule(geom, body, ends @ rotation.T + centre, radius)


def _cylinder_rods(radius: float, half: float) -> list[tuple[np.ndarray, float, float]]:
    """Rods along z that fill a cylinder; a wide one would lose its rims to a single capsule."""
    if radius <= _SLENDER:
        thin = min(radius, half)
        return [(np.zeros(3), half - thin, thin)]
    thin = min(radius, half) * _RIM
    turns = np.arange(_RING) * 2 * np.pi / _RING
    ring = (radius - thin) * np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=-1)
    core = min(radius - thin, half)
    return [(np.zeros(3), half - core, core), *((at, half - thin, thin) for at in ring)]


def strip_shifts(thick: float, wide: float) -> Float[np.ndarray, " n"]:
    """Centre lines of parallel rods across a flat part, from half its thickness and width [m]."""
    spread = wide - thick
    if spread <= 0.1 * thick:
        return np.zeros(1)
    return np.linspace(-spread, spread, 1 + int(np.ceil(2 * spread / max(thick, _APART))))


def _mesh_rods(
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
