"""An objective as a sum of terms: Eq. (1) and the terms that a method or a preset adds to it.

``Objective.value_grad_hess`` gives cost, gradient and Hessian of one pose for Newton steps, as a
small program; ``SampledObjective`` gives the costs of thousands of poses for a sampler. Terms are
in ``smooth_operator.retargeting.terms``.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.geometry import AnyArray
from smooth_operator.hands.differential import PointKinematics, PointMotion, all_joints, contracted
from smooth_operator.hands.hand import Hand, tree_with
from smooth_operator.hands.kinematics import KinematicTree
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.retargeting.targets import CloseTargets, TargetPolicy, VectorLayout
from smooth_operator.retargeting.terms import (
    TRANSITION,
    FrameGoal,
    JointCost,
    JointTerm,
    Keyvectors,
    PointTerm,
    Pull,
    Quadratic,
    RobotVectors,
    Term,
)
from smooth_operator.settings import check_numbers


@dataclass(frozen=True)
class TermsConfig:
    """Settings of an objective: those of ``smooth``; ``ObjectiveConfig`` has all of Eq. (1).

    Attributes:
        targets: the target policy.
        pose_weight: lambda_reg (gamma of the paper's table), pull to the neutral pose.
        terms: more terms, which are built for the hand.
    """

    targets: TargetPolicy[Any, Any] = field(default_factory=CloseTargets)
    pose_weight: float = 0.026
    terms: tuple[Term, ...] = ()

    def __post_init__(self) -> None:
        check_numbers(self, not_negative=("pose_weight",))

    def keyvectors(self, vectors: RobotVectors) -> Keyvectors:
        """First term of Eq. (1)."""
        return Keyvectors(vectors, TRANSITION)

    def pulls(self, neutral: Float[np.ndarray, " m"]) -> tuple[JointTerm, JointTerm]:
        """Second and third term of Eq. (1), of a hand's neutral pose [rad]."""
        pose = Pull(lambda _: (self.pose_weight, neutral))
        return pose, Pull(lambda goal: (goal.velocity_weight, goal.previous))


@dataclass(frozen=True, eq=False)
class Objective:
    """Eq. (1) and more terms, for one hand.

    Attributes:
        hand: the robot hand.
        config: weights of Eq. (1), and the preset's own terms.
        more: terms that the method adds.
    """

    hand: Hand
    config: TermsConfig
    more: tuple[PointTerm | JointTerm, ...] = ()

    @cached_property
    def layout(self) -> VectorLayout:
        """Vectors that the target policy uses; usually the keyvectors of the hand.

        Raises:
            ConfigError: the hand lacks a point that a vector needs.
        """
        layout: VectorLayout = self.config.targets.layout(self.hand.fingers)
        keypoints = self.hand.tree.keypoints
        lacking = [LANDMARKS[i] for i in layout.landmarks if LANDMARKS[i] not in keypoints]
        if lacking:
            raise ConfigError(
                f"{type(self.config.targets).__name__} needs points on the robot that "
                f"correspond to {lacking}, but hand {self.hand.name!r} has only "
                f"{sorted(keypoints)}: add the points to its description, or choose another "
                "method"
            )
        return layout

    # The terms

    @cached_property
    def keyvectors(self) -> Keyvectors:
        """First term of Eq. (1)."""
        return self.config.keyvectors(RobotVectors(self.hand, self.layout))

    @cached_property
    def point_terms(self) -> tuple[PointTerm, ...]:
        """Terms on the positions of points: keyvectors, then those of the method and the preset."""
        own = (term for term in self._own if isinstance(term, PointTerm))
        return (self.keyvectors, *own)

    @cached_property
    def joint_terms(self) -> tuple[JointTerm, ...]:
        """Terms on joints: neutral pose, velocity, then those of the method and the preset."""
        own = (term for term in self._own if isinstance(term, JointTerm))
        return (*self.config.pulls(self.hand.neutral), *own)

    @cached_property
    def _own(self) -> tuple[Term, ...]:
        terms = (*self.more, *(term.build(self.hand) for term in self.config.terms))
        return tuple(term for term in terms if not term.is_off)

    def regularisation(self, q: Float[AnyArray, "*n m"], goal: FrameGoal) -> JointCost:
        """Terms on joint positions: the last two of Eq. (1), and those of a preset.

        Args:
            q: (..., m) actuated joint positions [rad]; NumPy or JAX.
        """
        every = zip(*(term.expand(q, goal) for term in self.joint_terms), strict=True)
        return JointCost(*(functools.reduce(operator.add, parts) for parts in every))

    # One pose, with derivatives

    @cached_property
    def tree(self) -> KinematicTree:
        """Kinematics of the landmarks of the hand and of the points that terms add."""
        own: dict[str, tuple[int, np.ndarray]] = {}
        for term in self.point_terms:
            own.update(term.own_points())
        return tree_with(self.hand, own) if own else self.hand.tree

    @cached_property
    def kinematics(self) -> PointKinematics:
        """The points of all terms, with derivatives."""
        every = (name for term in self.point_terms for name in term.points())
        return PointKinematics(self.tree, tuple(dict.fromkeys(every)))

    def value_grad_hess(
        self, q: Float[Array, " m"], goal: FrameGoal
    ) -> tuple[Float[Array, ""], Float[Array, " m"], Float[Array, "m m"]]:
        """Value, gradient and Hessian at a pose: the sum over the terms.

        The Hessian is as exact as those of the terms; the terms of Eq. (1) are exact, except at the
        kinks of smooth-L1 (a set of measure zero).
        """
        near = self._near(q, goal)
        hessian = near.weighted.T @ near.rows
        total = jnp.asarray(self.kinematics.moves.T, q.dtype) @ near.moments
        joints = self.hand.coupling_matrix[np.array(self.kinematics.order)]
        slope, curvature = self.kinematics.derivatives(near.motion, total)
        cost, first, second = self.regularisation(q, goal)
        half = contracted(hessian + curvature, joints)
        return (
            near.cost + cost,
            contracted(slope, joints) + first,
            contracted(half.T, joints) + second * jnp.eye(len(q), dtype=q.dtype),
        )

    def _near(self, q: Float[Array, " m"], goal: FrameGoal) -> _Near:
        motion = self.kinematics(all_joints(self.hand, q))
        chosen = [_Chosen.of(term.points(), self.kinematics.names) for term in self.point_terms]
        near = [
            term.expand(motion.points[at.at], self.kinematics.jacobian(motion, at.at), goal)
            for term, at in zip(self.point_terms, chosen, strict=True)
        ]
        cost = functools.reduce(operator.add, [one.cost for one in near])
        gradient = jnp.zeros((0, 3), q.dtype)  # with respect to the points of the terms so far
        for one, at in zip(near, chosen, strict=True):
            gradient = at.added(gradient, one.gradient)
        moments = self.kinematics.moments(motion, gradient)
        return _Near(cost, motion, moments, *_gauss_newton(near, motion))

    def values(self, q: Float[Array, "c m"], goal: FrameGoal) -> Float[Array, " c"]:
        """Costs of a few poses, without derivatives, computed by the small program."""
        costs: Array = jax.vmap(
            lambda one: self._near(one, goal).cost + self.regularisation(one, goal).cost
        )(q)
        return costs


class _Near(NamedTuple):
    """Quadratic model of the point terms near a pose; ``weighted`` are rows times their weights."""

    cost: Float[Array, ""]
    motion: PointMotion
    moments: Float[Array, "F 12"]
    rows: Float[Array, "R J"]
    weighted: Float[Array, "R J"]


class _Chosen(NamedTuple):
    """Positions of a term's points in the list of all points, which is in the order of the terms.
    ``at`` is a slice if they are adjacent, which is cheaper; ``end`` is exclusive."""

    at: slice | np.ndarray
    end: int

    @classmethod
    def of(cls, names: Sequence[str], every: Sequence[str]) -> _Chosen:
        index = [every.index(name) for name in names]
        first, last = min(index), max(index)
        neighbours = index == list(range(first, last + 1))
        return cls(slice(first, last + 1) if neighbours else np.array(index), last + 1)

    def added(self, total: Float[Array, "T 3"], values: Float[Array, "P 3"]) -> Array:
        """Adds a term's gradient to the sum, which becomes longer if the term adds points."""
        rows = len(total)
        if isinstance(self.at, slice) and self.at.start == rows:
            return jnp.concatenate([total, values]) if rows else values
        if self.end > rows:
            total = jnp.concatenate([total, jnp.zeros((self.end - rows, 3), total.dtype)])
        if isinstance(self.at, slice) and len(values) == len(total):
            return total + values
        return total.at[self.at].add(values)


def _gauss_newton(near: Sequence[Quadratic], motion: PointMotion) -> tuple[Array, Array]:
    """Rows of all terms, and the rows times their weights."""
    rows, weighted = [], []
    for one in near:
        own = one.rows(motion) if callable(one.rows) else one.rows
        if one.weights.ndim == 1:
            product = own * one.weights[:, None]
        else:  # second derivatives mix residuals in groups of three
            product = (one.weights[..., None] * own[:, None]).sum(axis=2)
        rows.append(own.reshape(-1, own.shape[-1]))
        weighted.append(product.reshape(-1, own.shape[-1]))
    return jnp.concatenate(rows), jnp.concatenate(weighted)
