"""Solid parts of a robot hand, as spheres for the solver and as surface points for measurement.

Each body of the hand has four reference points: its origin and the ends of its axes. Every point
that is fixed to the body is a weighted sum of the four, and so is its derivative. Spheres and
surface points are therefore data, not part of a compiled program.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

from smooth_operator.errors import HandModelError
from smooth_operator.hands.collision import Capsule, shape_capsules, solid_shapes
from smooth_operator.hands.differential import PointKinematics
from smooth_operator.hands.hand import Hand, landmark_points, tree_with
from smooth_operator.hands.stand_ins import stand_ins
from smooth_operator.retargeting.trajectory_retargeter import joint_motion

SPACING_M: Final = 0.002
"""Distance between the points of a surface [m]."""
TIP_M: Final = 0.02
"""Distance from the tip landmark within which points belong to the fingertip [m]."""

_ALONG: Final = 0.6  # distance of spheres in a capsule over its radius
_PLATE_M: Final = 0.005  # largest radius of the spheres in a box [m]
_PLATE_STEP: Final = 1.6  # their distance over that radius
_MESH_POINTS: Final = 64  # of a mesh, for the solver
_BOX = mujoco.mjtGeom.mjGEOM_BOX
_MESH = mujoco.mjtGeom.mjGEOM_MESH


@dataclass(frozen=True, eq=False)
class Fixed:
    """Points that are fixed to bodies.

    Attributes:
        body: (K,) index into ``HandSurface.bodies``.
        share: (K, 4) weights of the body's four reference points.
        radius: (K,) radius of the sphere around each point [m].
    """

    body: Int[np.ndarray, " K"]
    share: Float[np.ndarray, "K 4"]
    radius: Float[np.ndarray, " K"]

    def of(self, chosen: np.ndarray) -> Fixed:
        """Selects some of the points, by a mask or by indices."""
        return Fixed(self.body[chosen], self.share[chosen], self.radius[chosen])

    def at(self, frames: Float[np.ndarray, "*n B 4 3"]) -> Float[np.ndarray, "*n K 3"]:
        """Computes the positions of the points on the host [m]."""
        return np.asarray(np.einsum("ki,...kic->...kc", self.share, frames[..., self.body, :, :]))


@dataclass(frozen=True, eq=False)
class HandSurface:
    """The solid parts of one robot hand, in its palm frame.

    Attributes:
        hand: the robot hand.
    """

    hand: Hand

    @cached_property
    def bodies(self) -> tuple[int, ...]:
        """The B bodies of the model with solid parts or fingertips."""
        owners = {capsule.body for capsule in self._estimated}
        owners |= {int(self.hand.model.geom_bodyid[g]) for g in self._geoms}
        owners |= {body for body, _ in self._tips}
        return tuple(sorted(owners))

    @cached_property
    def kinematics(self) -> PointKinematics:
        """Kinematics of the reference points of each body: 4 B points."""
        ends = np.concatenate([np.zeros((1, 3)), np.eye(3)])
        points = {
            f"body {body} {i}": (body, end) for body in self.bodies for i, end in enumerate(ends)
        }
        return PointKinematics(tree_with(self.hand, points), tuple(points))

    def frames(self, q_all: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T B 4 3"]:
        """Computes the bodies' four reference points on the host [m].

        Args:
            q_all: (T, n) positions of all joints [rad].
        """
        tree = self.kinematics.tree
        rows = tree.forward_kinematics(list(np.asarray(q_all, float).T), self.kinematics.names)
        count = len(q_all)
        flat = np.stack(
            [np.stack([np.broadcast_to(c, count) for c in p], axis=-1) for p in rows], axis=1
        )
        return flat.reshape(count, len(self.bodies), 4, 3)

    def motion(
        self, q: Float[Array, " m"]
    ) -> tuple[Float[Array, "B 4 3"], Float[Array, "B 4 3 m"]]:
        """The bodies' reference points [m] and their derivatives by the actuated joints;
        traceable."""
        kinematics = self.kinematics
        joints, by_actuated = joint_motion(self.hand, q)
        motion = kinematics(joints)
        spread = by_actuated[np.array(kinematics.order)]
        slopes = jnp.einsum("pjc,jm->pcm", kinematics.jacobian(motion), spread)
        count = len(self.bodies)
        return motion.points.reshape(count, 4, 3), slopes.reshape(count, 4, 3, -1)

    @cached_property
    def spheres(self) -> Fixed:
        """Spheres that fill the solid parts."""
        spheres: list[tuple[int, np.ndarray, float]] = []
        for capsule in self._estimated:
            spheres += _in_capsule(capsule)
        for geom in self._geoms:
            kind = self.hand.model.geom_type[geom]
            if kind == _BOX:
                spheres += _in_box(self.hand.model, geom)
            elif kind == _MESH:
                points = _mesh_points(self.hand.model, geom, SPACING_M)
                spread = points[_spread_out(points, _MESH_POINTS)]
                spheres += [(int(self.hand.model.geom_bodyid[geom]), p, 0.0) for p in spread]
            else:
                for capsule in shape_capsules(self.hand.model, geom):
                    spheres += _in_capsule(capsule)
        return self._fixed(spheres)

    @cached_property
    def surface(self) -> Fixed:
        """Points on the surfaces, ``SPACING_M`` apart, with radius 0, for measurements."""
        points_of_bodies: list[tuple[int, np.ndarray, float]] = []
        for capsule in self._estimated:
            points = _capsule_points(capsule, SPACING_M)
            points_of_bodies += [(capsule.body, p, 0.0) for p in points]
        for geom in self._geoms:
            body = int(self.hand.model.geom_bodyid[geom])
            points_of_bodies += [
                (body, p, 0.0) for p in surface_points(self.hand.model, geom, SPACING_M)
            ]
        return self._fixed(points_of_bodies)

    def fingertips(self, points: Fixed) -> tuple[Int[np.ndarray, " p"], ...]:
        """For each finger, the indices of the points that belong to its fingertip.

        Raises:
            HandModelError: a fingertip has no solid part.
        """
        model, out = self.hand.model, []
        parts = model.body_weldid[list(self.bodies)]
        places = points.share[:, 1:]
        for finger, (body, local) in zip(self.hand.fingers, self._tips, strict=True):
            same = parts[points.body] == model.body_weldid[body]
            here = points.body == self.bodies.index(body)
            near = np.linalg.norm(places - local, axis=-1) - points.radius < TIP_M
            chosen = np.flatnonzero(here & near)
            if not len(chosen):
                chosen = np.flatnonzero(here if here.any() else same)
            if not len(chosen):
                raise HandModelError(
                    f"hand {self.hand.name!r}: the fingertip of the {finger} has no collision "
                    "shape, so its contacts can't be computed: add one to its body"
                )
            out.append(chosen)
        return tuple(out)

    @cached_property
    def _tips(self) -> list[tuple[int, np.ndarray]]:
        """(body, position in it [m]) of each tip landmark."""
        places = landmark_points(self.hand.model, self.hand.spec)
        return [(int(places[n][0]), np.asarray(places[n][1])) for n in self.hand.tip_names]

    @cached_property
    def _estimated(self) -> tuple[Capsule, ...]:
        return tuple(c for c in stand_ins(self.hand).capsules if self._below(c.body))

    @cached_property
    def _geoms(self) -> list[int]:
        model = self.hand.model
        replaced = list(stand_ins(self.hand).replaced)
        solid = solid_shapes(self.hand) & ~np.isin(model.body_weldid[model.geom_bodyid], replaced)
        plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        every = np.flatnonzero(solid & ~plane)
        return [int(g) for g in every if self._below(int(model.geom_bodyid[g]))]

    def _below(self, body: int) -> bool:
        """True if a body is the palm or a descendant of the palm."""
        palm = self.hand.model.body(self.hand.spec.palm).id
        while body not in (0, palm):
            body = int(self.hand.model.body_parentid[body])
        return bool(body == palm)

    def _fixed(self, rows: list[tuple[int, np.ndarray, float]]) -> Fixed:
        local = np.array([place for _, place, _ in rows]).reshape(-1, 3)
        share = np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)
        index = {body: i for i, body in enumerate(self.bodies)}
        return Fixed(
            np.array([index[body] for body, _, _ in rows], int),
            share,
            np.array([radius for _, _, radius in rows], float),
        )


def surface_points(model: mujoco.MjModel, geom: int, spacing: float) -> Float[np.ndarray, "n 3"]:
    """Samples points on the surface of a shape, in the frame of its body [m].

    Args:
        model: the compiled model.
        geom: the shape.
        spacing: distance between the points [m].
    """
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), np.array(model.geom_size[geom])
    if kind == _MESH:
        return _mesh_points(model, geom, spacing)
    if kind == _BOX:
        points = _box_shell(size, np.maximum(2, np.ceil(2 * size / spacing).astype(int) + 1))
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        points = _cylinder(size[0], size[1], spacing)
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        points = _ball(1.0, spacing / float(size.max())) * size
    else:
        half = float(size[1]) if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
        points = _round(float(size[0]), half, spacing)
    return np.asarray(points @ _turn(model.geom_quat[geom]).T + model.geom_pos[geom])


def _capsule_points(capsule: Capsule, spacing: float) -> np.ndarray:
    along = capsule.ends[1] - capsule.ends[0]
    length = float(np.linalg.norm(along))
    quat = np.empty(4)
    mujoco.mju_quatZ2Vec(quat, along / length if length > 1e-9 else np.array([0.0, 0.0, 1.0]))
    points = _round(capsule.radius, length / 2, spacing)
    moved: np.ndarray = points @ _turn(quat).T + capsule.ends.mean(axis=0)
    return moved


def _round(radius: float, half: float, spacing: float) -> np.ndarray:
    """Points of a capsule along z, or of a sphere if its length is zero."""
    ball = _ball(radius, spacing)
    parts = [ball + np.where(ball[:, 2:] >= 0, half, -half) * np.array([0.0, 0.0, 1.0])]
    if half > 0:
        parts.append(_side(radius, half, spacing))
    return np.concatenate(parts)


def _ball(radius: float, spacing: float) -> np.ndarray:
    """Points of a sphere along a spiral (Saff and Kuijlaars 1997)."""
    count = max(12, int(np.ceil(4 * np.pi * radius**2 / spacing**2)))
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + np.sqrt(5)) * k
    flat = np.sqrt(np.maximum(1 - z * z, 0.0))
    return radius * np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=-1)


def _side(radius: float, half: float, spacing: float) -> np.ndarray:
    around = max(8, int(np.ceil(2 * np.pi * radius / spacing)))
    rows = max(2, int(np.ceil(2 * half / spacing)) + 1)
    angle, z = np.meshgrid(
        np.linspace(0, 2 * np.pi, around, endpoint=False), np.linspace(-half, half, rows)
    )
    ring = [radius * np.cos(angle).ravel(), radius * np.sin(angle).ravel(), z.ravel()]
    return np.stack(ring, axis=-1)


def _cylinder(radius: float, half: float, spacing: float) -> np.ndarray:
    parts = [_side(radius, half, spacing)]
    for r in np.arange(radius - spacing, 0, -spacing):
        ring = _side(float(r), half, 4 * half + spacing)
        parts.append(ring)
    return np.concatenate(parts)


def _box_shell(half: np.ndarray, counts: np.ndarray) -> np.ndarray:
    axes = [np.linspace(-h, h, n) for h, n in zip(half, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    shell: np.ndarray = grid[(np.abs(grid) >= half - 1e-12).any(axis=-1)]
    return shell


def _in_capsule(capsule: Capsule) -> list[tuple[int, np.ndarray, float]]:
    length = float(np.linalg.norm(capsule.ends[1] - capsule.ends[0]))
    count = 1 + int(np.ceil(length / (_ALONG * capsule.radius))) if length > 1e-6 else 1
    shares = np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.0])
    return [
        (capsule.body, (1 - s) * capsule.ends[0] + s * capsule.ends[1], capsule.radius)
        for s in shares
    ]


def _in_box(model: mujoco.MjModel, geom: int) -> list[tuple[int, np.ndarray, float]]:
    size = np.array(model.geom_size[geom])
    radius = min(float(size.min()), _PLATE_M)
    inner = size - radius
    counts = 1 + np.ceil(2 * inner / (_PLATE_STEP * radius)).astype(int)
    shell = _box_shell(inner, np.maximum(counts, np.where(inner > 1e-9, 2, 1)))
    places = shell @ _turn(model.geom_quat[geom]).T + model.geom_pos[geom]
    body = int(model.geom_bodyid[geom])
    return [(body, place, radius) for place in places]


def _mesh_points(model: mujoco.MjModel, geom: int, spacing: float) -> np.ndarray:
    """Vertices and random points of the triangles of a mesh, in its body's frame."""
    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    start, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    vertices = np.array(model.mesh_vert[first : first + count], float)
    corners = vertices[np.array(model.mesh_face[start : start + faces])]
    sides = corners[:, 1:] - corners[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=-1)
    rng = np.random.default_rng(0)
    total = int(np.clip(area.sum() / spacing**2, 1, 20_000))
    chosen = rng.choice(faces, total, p=area / max(float(area.sum()), 1e-18))
    u, v = np.sqrt(rng.random(total)), rng.random(total)
    shares = np.stack([1 - u, u * (1 - v), u * v], axis=-1)
    points = np.concatenate([vertices, np.einsum("nk,nkc->nc", shares, corners[chosen])])
    moved: np.ndarray = points @ _turn(model.geom_quat[geom]).T + model.geom_pos[geom]
    return moved


def _spread_out(points: np.ndarray, count: int) -> np.ndarray:
    """Indices of points that are far from each other, by farthest-point sampling."""
    chosen = [0]
    apart = np.linalg.norm(points - points[0], axis=-1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(apart.argmax()))
        apart = np.minimum(apart, np.linalg.norm(points - points[chosen[-1]], axis=-1))
    return np.array(chosen)


def _turn(quat: np.ndarray) -> np.ndarray:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quat, float))
    return matrix.reshape(3, 3)
