"""Fingertips with their first and second derivatives, for one hand at a time.

The unrolled ``KinematicTree.forward_kinematics`` is made for thousands of candidates. A Newton step
asks for one pose, with derivatives, and wants a small program: here the tree is swept level by
level in batched 3 x 3 products, and the Jacobian and second derivatives come from the geometry of a
hinge rather than from differentiating code. With axis a_j and arm r_fj from joint j to point f:

    dp_f / dq_j           = a_j x r_fj                     (a_j for a slide)
    d2p_f / (dq_i dq_j)   = a_i x (a_j x r_fj)             for hinge i above or equal to j
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.hands.kinematics import KinematicTree


class PointMotion(NamedTuple):
    """Points and how joints move them.

    Attributes:
        points: (F, 3) positions in the palm frame [m].
        jacobian: (F, J, 3) dp_f/dq_j [m/rad], zero where joint j does not move point f.
        hinge_axes: (J, 3) hinge axes, zero for slides.
    """

    points: Float[Array, "F 3"]
    jacobian: Float[Array, "F J 3"]
    hinge_axes: Float[Array, "J 3"]


@dataclass(frozen=True, eq=False)
class PointKinematics:
    """Some keypoints of a tree, with derivatives; joints are in the order of the tree's levels.

    Attributes:
        tree: the kinematics.
        names: the keypoints.
    """

    tree: KinematicTree
    names: tuple[str, ...]

    @cached_property
    def levels(self) -> tuple[tuple[int, ...], ...]:
        """Indices into ``tree.joints`` by depth."""
        depth: list[int] = []
        for joint in self.tree.joints:
            depth.append(0 if joint.parent < 0 else depth[joint.parent] + 1)
        return tuple(
            tuple(i for i, d in enumerate(depth) if d == level)
            for level in range(max(depth, default=-1) + 1)
        )

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Position in the vector of all joints of each of the J joints here."""
        return tuple(self.tree.joints[i].source for level in self.levels for i in level)

    @cached_property
    def above(self) -> Bool[np.ndarray, "J J"]:
        """[i, j]: joint i is above joint j in the tree, or is it."""
        flat = [i for level in self.levels for i in level]
        above = np.eye(len(flat), dtype=bool)
        for column, i in enumerate(flat):
            parent = self.tree.joints[i].parent
            if parent >= 0:
                above[:, column] |= above[:, flat.index(parent)]
        return above

    @cached_property
    def moves(self) -> Bool[np.ndarray, "F J"]:
        """[f, j]: joint j moves point f."""
        flat = [i for level in self.levels for i in level]
        rows = np.zeros((len(self.names), len(flat)), bool)
        for f, name in enumerate(self.names):
            joint = self.tree.keypoints[name].joint
            if joint >= 0:
                rows[f] = self.above[:, flat.index(joint)]
        return rows

    def __call__(self, q: Float[Array, " n"]) -> PointMotion:
        """Points and their motion.

        Args:
            q: (n,) positions of all joints [rad].
        """
        joints = self.tree.joints
        rotation, origin = jnp.eye(3)[None], jnp.zeros((1, 3))  # the palm, above the first level
        above: Sequence[int] = (-1,)
        rotations, origins = [], []
        for level in self.levels:
            parent = np.array([above.index(joints[i].parent) for i in level])
            angle = q[np.array([joints[i].source for i in level])]
            slide = np.array([joints[i].slide for i in level])
            fixed = jnp.asarray(np.stack([joints[i].rotation for i in level]), q.dtype)
            moved = jnp.asarray(np.stack([joints[i].translation for i in level]), q.dtype)
            offset = jnp.asarray(np.array([joints[i].offset for i in level]), q.dtype)
            before = rotation[parent]
            origin = origin[parent] + jnp.einsum("nij,nj->ni", before, moved)
            before = jnp.einsum("nij,njk->nik", before, fixed)
            turn = jnp.where(slide, 0.0, angle + offset)
            rotation = jnp.einsum("nij,njk->nik", before, _rz(turn))
            if slide.any():
                origin = origin + jnp.where(slide, angle, 0.0)[:, None] * before[:, :, 2]
            above = level
            rotations.append(rotation)
            origins.append(origin)
        all_rotations = jnp.concatenate([*rotations, jnp.eye(3)[None]])
        all_origins = jnp.concatenate([*origins, jnp.zeros((1, 3))])

        flat = [i for level in self.levels for i in level]
        keypoints = [self.tree.keypoints[name] for name in self.names]
        at = np.array([flat.index(k.joint) if k.joint >= 0 else len(flat) for k in keypoints])
        local = jnp.asarray(np.stack([k.position for k in keypoints]), q.dtype)
        points = all_origins[at] + jnp.einsum("fij,fj->fi", all_rotations[at], local)

        axes = all_rotations[:-1, :, 2]
        hinge = jnp.asarray([not joints[i].slide for i in flat])[:, None]
        arm = points[:, None, :] - all_origins[None, :-1, :]
        jacobian = jnp.where(hinge, _cross(axes[None], arm), axes[None])
        jacobian = jnp.where(jnp.asarray(self.moves)[:, :, None], jacobian, 0.0)
        return PointMotion(points, jacobian, jnp.where(hinge, axes, 0.0))

    def curvature(self, motion: PointMotion, gradient: Float[Array, "F 3"]) -> Float[Array, "J J"]:
        """Second derivative of sum_f gradient_f . p_f with respect to the J joints.

        Args:
            motion: at the pose.
            gradient: (F, 3) of a cost with respect to the points, held fixed.
        """
        # g . (a_i x w_fj) = (g x a_i) . w_fj, for i above j
        torque = _cross(gradient[:, None, :], motion.hinge_axes[None])
        upper = jnp.einsum("fic,fjc->ij", torque, motion.jacobian)
        return jnp.where(
            jnp.asarray(self.above), upper, jnp.where(jnp.asarray(self.above.T), upper.T, 0.0)
        )


def _rz(angle: Float[Array, " n"]) -> Float[Array, "n 3 3"]:
    c, s = jnp.cos(angle), jnp.sin(angle)
    zero, one = jnp.zeros_like(c), jnp.ones_like(c)
    rows = ((c, -s, zero), (s, c, zero), (zero, zero, one))
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def _cross(a: Array, b: Array) -> Array:
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]
