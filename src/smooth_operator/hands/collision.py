"""Collision shapes of a hand, whose they are, and capsules that fill them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS

PALM: Final = -1
"""Value of ``owners`` for the palm and all else that belongs to no finger."""
_FLAT: Final = 1.5  # width over thickness from which a mesh is a row of capsules
_APART: Final = 0.006  # distance of a thin plate's rods, between which no finger fits [m]
_SLENDER: Final = 0.02  # largest radius of a cylinder that is one capsule [m]
_RIM: Final = 0.35  # radius of a wide cylinder's outer capsules, over the cylinder's
_RING: Final = 10  # number of them
_TINY: Final = 1e-9  # [m]


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
    """Capsules that fill a shape from within.

    A capsule or a sphere is itself, and a slender cylinder or rod of a mesh is one capsule. A wide
    cylinder is a ring of capsules around a core. A box, or a mesh that is flat, is a row of
    parallel capsules as thick as the part is in each strip.
    """
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
        flat = kind != kinds.mjGEOM_ELLIPSOID and half[wide] > _FLAT * half[thin]
        if flat or kind == kinds.mjGEOM_BOX:
            edges = _mesh_edges(model, geom) if kind == kinds.mjGEOM_MESH else _box_edges(half)
            rods = _strips(edges, (thin, wide, axis), float(middle[wide]), half)
        else:  # rounder than a box: one capsule of a mean width
            radius = float(np.sqrt(half[thin] * half[wide]))
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


def _strips(
    edges: Float[np.ndarray, "e 2 3"],
    axes: tuple[int, int, int],
    middle: float,
    half: Float[np.ndarray, "3"],
) -> list[tuple[np.ndarray, float, float]]:
    """Parallel rods across a flat part, each as thick and long as the part is in its strip.

    Args:
        edges: the part's straight edges [m]; they tell how far it reaches within a strip.
        axes: its thin, its wide and its long axis.
        middle: middle of the part along its wide axis [m].
        half: half its measures [m].
    """
    thin, wide, long = axes
    thick = float(half[thin])
    spread = float(half[wide]) - thick
    rows = 1 + int(np.ceil(2 * spread / max(thick, _APART))) if spread > 0.1 * thick else 1
    rods = []
    for shift in np.linspace(-spread, spread, rows) if rows > 1 else (0.0,):
        at = middle + shift
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
    """Ends of what is left of the edges between two planes."""
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


def _box_edges(half: Float[np.ndarray, "3"]) -> Float[np.ndarray, "12 2 3"]:
    corners = np.array(list(product((-1, 1), repeat=3)))
    ends = [(a, b) for a, b in combinations(corners, 2) if np.abs(a - b).sum() == 2]
    edges: np.ndarray = half * np.array(ends, float)
    return edges


def _mesh_edges(model: mujoco.MjModel, geom: int) -> Float[np.ndarray, "e 2 3"]:
    mesh = int(model.geom_dataid[geom])
    start, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    faces = model.mesh_face[start : start + count]
    vertices = model.mesh_vert[int(model.mesh_vertadr[mesh]) :]
    return np.asarray(vertices[faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)], float)
