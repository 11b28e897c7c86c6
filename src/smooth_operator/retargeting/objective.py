"""The objective of a frame, which is a sum of cost terms on points and joints of the robot.

To write your own term, define a frozen dataclass with its settings, derived from
``LeastSquaresTerm`` (only residuals), ``VectorTerm`` (keyvectors), ``JointTerm`` (joint positions)
or ``PointTerm`` (gradient and Gauss-Newton rows). ``ObjectiveConfig(terms=(MyTerm(),))`` adds it to
a preset. The terms of Eq. (1) are here, those of ``smooth`` in ``smooth_terms.py``.
"""

from __future__ import annotations

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, Final, Literal, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.geometry import AnyArray, AnyKind
from smooth_operator.hands.differential import (
    PointKinematics,
    PointMotion,
    contracted,
    linear_joints,
    moments,
)
from smooth_operator.hands.hand import Hand, tree_with
from smooth_operator.hands.kinematics import KinematicTree
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.retargeting.targets import (
    CloseTargets,
    KeyvectorLayout,
    TargetPolicy,
    VectorLayout,
)
from smooth_operator.settings import check_numbers

TRANSITION: Final = 0.02
"""Error at which the smooth-L1 cost of keyvectors changes from quadratic to linear [m]. Quadratic
terms divide their weights by it, so that all weights are comparable."""


class FrameGoal(NamedTuple):
    """Target vectors and weights of one frame.

    Attributes:
        vectors: (K, 3) keyvector targets [m].
        weights: (K,) their weights.
        previous: (m,) last command of the actuated joints [rad].
        velocity_weight: lambda_vel of the frame, or (m,) of each joint; 0 without a last command.
        reach: (F, 3) vectors from the wrist to the fingertips after copying the human's motion [m];
            for the motion term only.
        motion_weights: (F,) weights of that term, in the units of a keyvector's weight.
        pad: (3,) direction of the last segment of the human's thumb; for ``PadDirection`` only.
    """

    vectors: Float[AnyArray, "K 3"]
    weights: Float[AnyArray, " K"]
    previous: Float[AnyArray, " m"]
    velocity_weight: Float[Array, ""] | Float[Array, " m"] | float
    reach: Float[Array, "F 3"] | None = None
    motion_weights: Float[Array, " F"] | None = None
    pad: Float[Array, "3"] | None = None


class Quadratic(NamedTuple):
    """Quadratic model of a term near one pose. Its Hessian is rows^T weights rows plus the
    curvature of the kinematics along the gradient.

    Attributes:
        cost: cost at the pose.
        gradient: (P, 3) of the cost with respect to the term's points.
        rows: (R, J) derivatives of R residuals with respect to the J joints; or (K, 3, J) if second
            derivatives mix residuals in groups of three; or a function of a motion.
        weights: (R,) second derivatives of the cost with respect to the residuals; or (K, 3, 3).
    """

    cost: Float[Array, ""]
    gradient: Float[Array, "P 3"]
    rows: Float[Array, "R J"] | Float[Array, "K 3 J"] | Callable[[PointMotion], Array]
    weights: Float[Array, " R"] | Float[Array, "K 3 3"]


class Term:
    """Base class of the terms of an objective."""

    def build(self, hand: Hand) -> Self:
        """Returns the term for one hand, or the term itself if it does not depend on the hand.
        Raises ConfigError if the hand lacks what the term needs."""
        del hand
        return self

    @property
    def is_off(self) -> bool:
        """True if the term has no effect, for example with a weight of 0."""
        return False


class PointTerm(Term, ABC):
    """Cost term on the positions of some of the robot's points in the palm frame."""

    @abstractmethod
    def points(self) -> tuple[str, ...]:
        """Names of the P points: landmarks of the hand, or points of ``own_points``."""

    def own_points(self) -> Mapping[str, tuple[int, np.ndarray]]:
        """Additional points: maps names to (body of the model, (3,) position in it [m])."""
        return {}

    @abstractmethod
    def expand(
        self, points: Float[Array, "P 3"], jacobian: Float[Array, "P J 3"], goal: FrameGoal
    ) -> Quadratic:
        """Returns cost, gradient and Gauss-Newton rows at (P, 3) points [m], given their (P, J, 3)
        derivatives with respect to the J joints [m/rad]; traceable."""


class Derivatives(NamedTuple):
    """A separable cost of some variables and its derivatives. The variables are m joints in given
    poses, or K vectors.

    Attributes:
        cost: (...) sum over the variables.
        first: (..., m) or (K, 3) first derivative.
        second: (..., m) or (K, 3) diagonal of the second derivative, for vectors without negative
            parts; (K, 3, 3) if components mix; or one number for all joints.
    """

    cost: Any
    first: Any
    second: Any


class JointTerm(Term, ABC):
    """Separable cost term on the m actuated joints."""

    @abstractmethod
    def expand(self, q: Float[AnyArray, "*n m"], goal: FrameGoal) -> Derivatives:
        """Returns cost and derivatives at joint positions [rad]; NumPy or JAX."""


@dataclass(frozen=True, eq=False)
class Pull(JointTerm):
    """Cost term: a weight times the squared distance of each joint from a pose.

    Attributes:
        of: function from a goal to a weight (or (m,) weights) and a (m,) pose [rad].
    """

    of: Callable[[FrameGoal], tuple[Any, Any]]

    def expand(self, q: Float[AnyArray, "*n m"], goal: FrameGoal) -> Derivatives:
        """Returns cost and derivatives, as ``JointTerm.expand`` does."""
        weight, pose = self.of(goal)
        off = q - pose.astype(q.dtype, copy=False)
        return Derivatives((weight * off**2).sum(axis=-1), 2 * weight * off, 2 * weight)


@dataclass(frozen=True, eq=False)
class VectorTerm(PointTerm):
    """Separable cost term on the errors of some of the robot's vectors.

    Attributes:
        layout: landmarks that each vector joins; the hand has counterparts of them all.
    """

    part: ClassVar[Literal["all", "wrist", "thumb"]] = "all"
    """All vectors, or only the paper's keyvectors from the wrist or from the thumb's tip."""

    layout: VectorLayout

    @abstractmethod
    def slopes(self, errors: Float[Array, "K 3"], goal: FrameGoal) -> Derivatives:
        """Returns the cost of the errors of ``part`` [m], with derivatives; traceable."""

    def points(self) -> tuple[str, ...]:
        """Landmarks that the vectors join."""
        return tuple(LANDMARKS[i] for i in self.layout.landmarks)

    @cached_property
    def which(self) -> slice:
        """The vectors of ``part``; ConfigError if these are not from a ``KeyvectorLayout``."""
        if self.part == "all":
            return slice(None)
        if not isinstance(self.layout, KeyvectorLayout):
            raise ConfigError(
                f"{type(self).__name__} needs the paper's keyvectors, not "
                f"{type(self.layout).__name__}"
            )
        return self.layout.thumb if self.part == "thumb" else slice(0, len(self.layout.fingers))

    def expand(
        self, points: Float[Array, "P 3"], jacobian: Float[Array, "P J 3"], goal: FrameGoal
    ) -> Quadratic:
        """Returns cost and derivatives, as ``PointTerm.expand`` does."""
        which, among = self.which, self.layout.among
        cost, first, second = self.slopes((among(points) - goal.vectors)[which], goal)
        along = among(jacobian.reshape(len(points), -1))  # in this order XLA's loops are fast
        rows = jnp.swapaxes(along.reshape(len(along), *jacobian.shape[1:]), 1, 2)[which]
        # 1 where a vector ends at a point, -1 where it begins at one
        incidence = jnp.asarray(among(np.eye(len(points)))[which], points.dtype)
        gradient = (incidence[:, :, None] * first[:, None, :]).sum(axis=0)
        if second.ndim == 2:  # independent components
            rows, second = rows.reshape(first.size, -1), second.reshape(-1)
        return Quadratic(cost, gradient, rows, second)


@dataclass(frozen=True, eq=False)
class Keyvectors(VectorTerm):
    """Cost term: sum over vectors k of lambda_k smooth-L1(v_R - v_H), component by component.

    Attributes:
        transition: error at which smooth-L1 changes from quadratic to linear [m].
    """

    transition: float

    def price(self, error: Sequence[Array], weight: Array) -> Array:
        """Cost of one vector, from the three components of its error [m]."""
        x, y, z = (smooth_l1(component, self.transition)[0] for component in error)
        return weight * (x + y + z)

    def slopes(self, errors: Float[Array, "K 3"], goal: FrameGoal) -> Derivatives:
        """Returns costs and derivatives; exact except at the kinks of smooth-L1."""
        weights = jnp.asarray(goal.weights)[:, None]
        cost, first, second = smooth_l1(errors, self.transition)
        return Derivatives((weights * cost).sum(), weights * first, weights * second)


def smooth_l1(x: AnyKind, transition: float) -> tuple[AnyKind, AnyKind, AnyKind]:
    """Smooth-L1, which is x^2 / (2 transition) up to the transition and |x| - transition / 2
    beyond, with first and second derivatives; NumPy or JAX."""
    size = abs(x)
    near = size.clip(max=transition)
    cost: AnyKind = near * (size - 0.5 * near) * (1 / transition)
    return cost, (x / transition).clip(-1, 1), (size < transition) / transition


@dataclass(frozen=True)
class TermsConfig:
    """Settings of the objective of ``smooth``; ``ObjectiveConfig`` has further ones for ``sbr``.

    Attributes:
        targets: the target policy.
        pose_weight: lambda_reg (gamma of the paper's table), pull to the neutral pose.
        terms: additional terms, which are built for the hand.
    """

    targets: TargetPolicy[Any, Any] = field(default_factory=CloseTargets)
    pose_weight: float = 0.026
    terms: tuple[Term, ...] = ()

    def __post_init__(self) -> None:
        check_numbers(self)

    def keyvectors(self, layout: VectorLayout) -> Keyvectors:
        """Builds the keyvector term of the objective."""
        return Keyvectors(layout, TRANSITION)

    def pulls(self, neutral: Float[np.ndarray, " m"]) -> tuple[JointTerm, JointTerm]:
        """Builds the pull to this neutral pose [rad] and the velocity term."""
        pose = Pull(lambda _: (self.pose_weight, neutral))
        return pose, Pull(lambda goal: (goal.velocity_weight, goal.previous))


@dataclass(frozen=True, eq=False)
class Objective:
    """Objective for one hand: Eq. (1) of the Smooth Operator paper, and additional terms.

    Attributes:
        hand: the robot hand.
        config: weights of Eq. (1), and the preset's own terms.
        more: additional terms of the method.
    """

    hand: Hand
    config: TermsConfig
    more: tuple[PointTerm | JointTerm, ...] = ()

    @cached_property
    def layout(self) -> VectorLayout:
        """Vectors that the target policy uses; ConfigError if the hand lacks a point of one."""
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

    @cached_property
    def keyvectors(self) -> Keyvectors:
        """The term on keyvectors, the first term of Eq. (1)."""
        return self.config.keyvectors(self.layout)

    @cached_property
    def point_terms(self) -> tuple[PointTerm, ...]:
        """Terms on positions of points: keyvectors, then those of the method and the preset."""
        return (self.keyvectors, *(one for one in self._own if isinstance(one, PointTerm)))

    @cached_property
    def joint_terms(self) -> tuple[JointTerm, ...]:
        """Terms on joints: neutral pose, velocity, then those of the method and the preset."""
        pulls = self.config.pulls(self.hand.neutral)
        return (*pulls, *(one for one in self._own if isinstance(one, JointTerm)))

    @cached_property
    def _own(self) -> tuple[Term, ...]:
        terms = (*self.more, *(term.build(self.hand) for term in self.config.terms))
        return tuple(term for term in terms if not term.is_off)

    def regularisation(self, q: Float[AnyArray, "*n m"], goal: FrameGoal) -> Derivatives:
        """Sum of the terms on joints at (..., m) actuated joint positions [rad]; NumPy or JAX."""
        every = zip(*(term.expand(q, goal) for term in self.joint_terms), strict=True)
        return Derivatives(*(functools.reduce(operator.add, parts) for parts in every))

    @cached_property
    def tree(self) -> KinematicTree:
        """Kinematics of the hand's landmarks and of the points that terms add."""
        own = {k: v for term in self.point_terms for k, v in term.own_points().items()}
        return tree_with(self.hand, own) if own else self.hand.tree

    @cached_property
    def _groups(self) -> dict[tuple[str, ...], slice]:
        """Points of the terms, and where they are in ``kinematics``."""
        groups = tuple(dict.fromkeys(term.points() for term in self.point_terms))
        ends = np.cumsum([0, *map(len, groups)]).tolist()
        return {group: slice(*pair) for group, pair in zip(groups, pairwise(ends), strict=True)}

    @cached_property
    def kinematics(self) -> PointKinematics:
        """Kinematics of the points of all terms; a point that several terms use may occur twice."""
        return PointKinematics(self.tree, sum(self._groups, ()))

    @cached_property
    def value_grad_hess(self) -> Callable[[Array, FrameGoal], tuple[Array, Array, Array]]:
        """Value, (m,) gradient and (m, m) Hessian at an (m,) pose, summed over the terms. Those of
        Eq. (1) are exact, except at the kinks of smooth-L1. A program traces the function once."""
        return jax.jit(self._expand)

    def _expand(self, q: Array, goal: FrameGoal) -> tuple[Array, Array, Array]:
        kinematics, transmission = self.kinematics, self.hand.transmission
        linear = linear_joints(self.hand, q)
        motion = kinematics(transmission.curved(linear))
        slices = [self._groups[term.points()] for term in self.point_terms]
        each = [
            term.expand(motion.points[at], kinematics.jacobian(motion, at), goal)
            for term, at in zip(self.point_terms, slices, strict=True)
        ]
        rows, weighted = _gauss_newton(each, motion)
        # the kinematics adds to the Hessian along the gradient by the points
        sums: dict[tuple[str, ...], Array] = {}
        for term, one in zip(self.point_terms, each, strict=True):
            sums[term.points()] = sums.get(term.points(), 0.0) + one.gradient
        gradient = jnp.concatenate([*sums.values()])
        total = jnp.asarray(kinematics.moves.T, q.dtype) @ moments(motion.points, gradient)
        slope, curvature = kinematics.derivatives(motion, total)
        hessian = weighted.T @ rows + curvature
        order = np.array(kinematics.order)
        if transmission.curves:  # chain rule
            first, second = (transmission.curved(linear, n)[order] for n in (1, 2))
            hessian = first[:, None] * hessian * first + jnp.diag(slope * second)
            slope = slope * first
        joints = transmission.matrix[order]
        half = contracted(hessian, joints)
        cost, first, second = self.regularisation(q, goal)
        return (
            functools.reduce(operator.add, [one.cost for one in each]) + cost,
            contracted(slope, joints) + first,
            contracted(half.T, joints) + second * jnp.eye(len(q), dtype=q.dtype),
        )


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
