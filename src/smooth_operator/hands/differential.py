"""Computes the keypoints of a single pose, with first and second derivatives.

This module sweeps the tree level by level, which gives a small program, and takes the derivatives
from the geometry of hinges. With axis a_j and arm r_fj from joint j to point f:

    dp_f / dq_j           = a_j x r_fj                     (a_j for a slide)
    d2p_f / (dq_i dq_j)   = a_i x (a_j x r_fj)             for hinge i above or equal to j
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.kinematics import KinematicTree


class PointMotion(NamedTuple):
    """Keypoints in one pose, and the velocities that unit joint velocities give them.

    Attributes:
        points: (F, 3) positions in the palm frame [m].
        hinge_axes: (J, 3) hinge axes, zero for slides.
        origin_speeds: (J, 3) velocity at the palm frame's origin of the body that each joint moves
            [m/rad].
    """

    points: Float[Array, "F 3"]
    hinge_axes: Float[Array, "J 3"]
    origin_speeds: Float[Array, "J 3"]

    def along(self, points: Float[Array, "R 3"], directions: Float[Array, "R 3"]) -> Array:
        """(R, J) speed of each point along a direction per unit speed of each joint [m/rad]."""
        wrenches = jnp.concatenate([_cross(points, directions), directions], axis=1)
        screws = jnp.concatenate([self.hinge_axes, self.origin_speeds], axis=1)
        # a sum: a matrix product would cost a call of XLA's library
        return functools.reduce(
            operator.add, [wrenches[:, i, None] * screws[None, :, i] for i in range(6)]
        )


@dataclass(frozen=True, eq=False)
class PointKinematics:
    """Kinematics of some keypoints with derivatives. Joints are ordered by their depth in the tree.

    Attributes:
        tree: the kinematics.
        names: names of the keypoints.
    """

    tree: KinematicTree
    names: tuple[str, ...]

    @cached_property
    def levels(self) -> tuple[tuple[int, ...], ...]:
        """Indices into ``tree.joints``, grouped by depth in the tree."""
        levels: list[tuple[int, ...]] = []
        above: tuple[int, ...] = (-1,)
        while above := tuple(i for i, j in enumerate(self.tree.joints) if j.parent in above):
            levels.append(above)
        return tuple(levels)

    @cached_property
    def _flat(self) -> list[int]:
        """Indices into ``tree.joints``, in the order of the levels."""
        return [i for level in self.levels for i in level]

    @cached_property
    def order(self) -> tuple[int, ...]:
        """(J,) index of each joint in the vector of all joints."""
        return tuple(self.tree.joints[i].source for i in self._flat)

    @cached_property
    def above(self) -> Bool[np.ndarray, "J J"]:
        """(J, J) mask; [i, j]: joint i is joint j or above it in the tree."""
        above = np.eye(len(self._flat), dtype=bool)
        for column, i in enumerate(self._flat):
            if (parent := self.tree.joints[i].parent) >= 0:
                above[:, column] |= above[:, self._flat.index(parent)]
        return above

    @cached_property
    def moves(self) -> Bool[np.ndarray, "F J"]:
        """(F, J) mask; [f, j]: joint j moves point f."""
        rows = np.zeros((len(self.names), len(self._flat)), bool)
        for f, name in enumerate(self.names):
            if (joint := self.tree.keypoints[name].joint) >= 0:
                rows[f] = self.above[:, self._flat.index(joint)]
        return rows

    def __call__(self, q: Float[Array, " n"]) -> PointMotion:
        """Points and their motion at (n,) positions of all joints [rad]."""
        joints, flat = self.tree.joints, self._flat
        angle = q[np.array(self.order)][:, None]
        slide = np.array([joints[i].slide for i in flat])[:, None]
        fixed = jnp.asarray(np.stack([joints[i].rotation for i in flat]), q.dtype)
        moved = jnp.asarray(np.stack([joints[i].translation for i in flat]), q.dtype)
        turn = jnp.where(slide, 0.0, angle + jnp.asarray([[joints[i].offset] for i in flat]))
        c, s, (x, y, z) = jnp.cos(turn), jnp.sin(turn), jnp.moveaxis(fixed, 2, 0)
        # columns of rotations, and origins, in the frame above
        columns = (x * c + y * s, y * c - x * s, z, moved + jnp.where(slide, angle, 0.0) * z)
        local = jnp.stack(columns, axis=-1)
        frame = jnp.eye(3, 4)[None]  # the palm, above the first level
        above: Sequence[int] = (-1,)
        frames, done = [], 0
        for level in self.levels:
            frame = frame[np.array([above.index(joints[i].parent) for i in level])]
            # a sum fuses with the operations around it, a matrix product does not
            turned = frame[:, :, :3, None] * local[done : done + len(level)][:, None]
            frame = turned.sum(axis=2) + frame[:, :, 3:] * np.eye(1, 4, 3, dtype=np.float32)
            frames.append(frame)
            above, done = level, done + len(level)
        every = jnp.concatenate([*frames, jnp.eye(3, 4)[None]])

        keypoints = [self.tree.keypoints[name] for name in self.names]
        at = np.array([flat.index(k.joint) if k.joint >= 0 else len(flat) for k in keypoints])
        spots = jnp.asarray(np.stack([k.position for k in keypoints]), q.dtype)
        points = (every[at][:, :, :3] * spots[:, None, :]).sum(-1) + every[at][:, :, 3]

        axes = every[:-1, :, 2]
        speeds = jnp.where(slide, axes, _cross(every[:-1, :, 3], axes))
        return PointMotion(points, jnp.where(slide, 0.0, axes), speeds)

    def jacobian(self, motion: PointMotion, of: slice | np.ndarray = slice(None)) -> Array:
        """(F, J, 3) dp_f/dq_j [m/rad] of some or all points, zero where joint j does not move f."""
        axes, points = motion.hinge_axes, motion.points[of]
        result = _cross(axes[None], points[:, None]) + motion.origin_speeds[None]
        return jnp.where(jnp.asarray(self.moves[of])[:, :, None], result, 0.0)

    def derivatives(
        self, motion: PointMotion, total: Float[Array, "J 12"]
    ) -> tuple[Float[Array, " J"], Float[Array, "J J"]]:
        """First and second derivatives of sum_f gradient_f . p_f with respect to the J joints, from
        (J, 12) ``moves.T @ moments(points, gradient)``."""
        # With w_fj = a_j x p_f + o_j, they are sums of g . w_fj, and of g . (a_i x w_fj) for i
        # above j. Points enter only by their moments p g^T and g, summed over the points of j.
        axes, speeds = motion.hinge_axes, motion.origin_speeds
        moment, force = total[:, :9].reshape(-1, 3, 3), total[:, 9:]
        trace = jnp.trace(moment, axis1=1, axis2=2)
        turned = (moment * axes[:, None, :]).sum(-1) - trace[:, None] * axes + _cross(speeds, force)
        twist = jnp.stack([moment[:, i - 2, i - 1] - moment[:, i - 1, i - 2] for i in range(3)], 1)
        upper = (axes[:, None, :] * turned[None]).sum(-1)
        above = jnp.asarray(self.above)
        second = jnp.where(above, upper, jnp.where(above.T, upper.T, 0.0))
        return (axes * twist).sum(-1) + (speeds * force).sum(-1), second


def moments(points: Float[Array, "F 3"], gradient: Float[Array, "F 3"]) -> Float[Array, "F 12"]:
    """Moments p g^T and g of each point p, as input of ``PointKinematics.derivatives``. The
    gradient g with respect to the points is treated as constant."""
    products = (points[:, :, None] * gradient[:, None, :]).reshape(-1, 9)
    return jnp.concatenate([products, gradient], axis=1)


def linear_joints(hand: Hand, q: Float[Array, " m"]) -> Float[Array, " n"]:
    """A q + b of the hand's ``Transmission`` at one pose, as sums; ``curved`` takes it;
    traceable."""
    transmission = hand.transmission
    return contracted(q, transmission.matrix.T) + transmission.offset.astype(q.dtype)


def contracted(values: Float[Array, "*batch J"], matrix: np.ndarray) -> Float[Array, "*batch m"]:
    """``values @ matrix`` as sums, for a constant (J, m) matrix with few entries per column."""
    most = max(1, int((matrix != 0).sum(axis=0).max(initial=0)))
    rows = np.argsort(matrix == 0, axis=0, kind="stable")[:most]  # nonzero entries first
    gains = np.take_along_axis(matrix, rows, axis=0)
    both = zip(rows, gains.astype(values.dtype), strict=True)
    total: Array = functools.reduce(operator.add, [values[..., row] * gain for row, gain in both])
    return total


def _cross(a: Array, b: Array) -> Array:
    turned = [a[..., i - 2] * b[..., i - 1] - a[..., i - 1] * b[..., i - 2] for i in range(3)]
    return jnp.stack(turned, axis=-1)
