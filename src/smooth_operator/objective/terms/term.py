"""Terms of an objective: a cost of points of the robot, or a cost of its joints.

A term of your own is a frozen dataclass with its settings. ``LeastSquaresTerm`` needs residuals
alone; ``PointTerm`` gives gradient and Gauss-Newton rows itself; ``JointTerm`` is for a cost of
joint positions. ``ObjectiveConfig(terms=(MyTerm(),))`` adds it to a preset.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.geometry import AnyArray, AnyKind
from smooth_operator.hands.differential import PointMotion
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.kinematics import Vector
from smooth_operator.objective.goal import FrameGoal

T = TypeVar("T", bound="Term")


class Quadratic(NamedTuple):
    """A term near one pose.

    The objective makes the Hessian of the rows, rows^T weights rows, and adds the curvature of the
    kinematics along the gradient.

    Attributes:
        cost: at the pose.
        gradient: (P, 3) of the cost with respect to the term's points.
        rows: (R, J) derivatives of R residuals with respect to the J joints; or (K, 3, J), where
            second derivatives mix residuals in groups of three. Or what gives them of a motion.
        weights: (R,) second derivatives of the cost with respect to the residuals; or (K, 3, 3).
    """

    cost: Float[Array, ""]
    gradient: Float[Array, "P 3"]
    rows: Float[Array, "R J"] | Float[Array, "K 3 J"] | Callable[[PointMotion], Array]
    weights: Float[Array, " R"] | Float[Array, "K 3 3"]


class Term:
    """One term of an objective."""

    def build(self: T, hand: Hand) -> T:
        """The term for one hand; itself, if it does not depend on the hand.

        Raises:
            ConfigError: if the hand lacks what the term needs.
        """
        del hand
        return self

    @property
    def is_off(self) -> bool:
        """True if the term is left out, as with a weight of 0."""
        return False


class PointTerm(Term, ABC):
    """A cost of where some points of the robot are, in the palm frame."""

    @abstractmethod
    def points(self) -> tuple[str, ...]:
        """Names of the P points: landmarks that a joint moves, or points of ``own_points``."""

    def own_points(self) -> Mapping[str, tuple[int, np.ndarray]]:
        """Points that are no landmarks: name -> (body of the model, (3,) position in it [m])."""
        return {}

    @abstractmethod
    def expand(
        self, points: Float[Array, "P 3"], jacobian: Float[Array, "P J 3"], goal: FrameGoal
    ) -> Quadratic:
        """Cost, gradient and Gauss-Newton rows at one pose; traceable.

        Args:
            points: (P, 3) the term's points [m].
            jacobian: (P, J, 3) their derivatives with respect to the J joints [m/rad].
            goal: targets of the frame.
        """

    def cost(self, points: Sequence[Vector], goal: FrameGoal) -> Array:
        """The cost of many poses, for the sampler; traceable.

        Args:
            points: (x, y, z) of each point [m]: arrays of a common shape, the batch, or floats.
            goal: targets of the frame.

        Returns:
            costs, of that shape.
        """
        shape = jnp.broadcast_shapes(*(jnp.shape(c) for point in points for c in point))
        rows = [[jnp.broadcast_to(jnp.asarray(c), shape).ravel() for c in p] for p in points]
        poses = jnp.moveaxis(jnp.stack([jnp.stack(row) for row in rows]), -1, 0)
        no_joints = jnp.zeros((len(points), 0, 3), poses.dtype)
        costs: Array = jax.vmap(lambda one: self.expand(one, no_joints, goal).cost)(poses)
        return costs.reshape(shape)


class LeastSquaresTerm(PointTerm):
    """Half the sum of squared residuals of some points; the simplest term to write."""

    @abstractmethod
    def residuals(self, points: Float[Array, "P 3"], goal: FrameGoal) -> Float[Array, " R"]:
        """(R,) residuals at one pose, each times the root of its weight; differentiable."""

    def expand(
        self, points: Float[Array, "P 3"], jacobian: Float[Array, "P J 3"], goal: FrameGoal
    ) -> Quadratic:
        """See ``PointTerm``; the derivatives of the residuals come from JAX."""
        residuals = self.residuals(points, goal)
        slopes = jax.jacfwd(lambda p: self.residuals(p, goal))(points)  # (R, P, 3)
        return Quadratic(
            0.5 * (residuals * residuals).sum(),
            jnp.einsum("r,rpc->pc", residuals, slopes),
            jnp.einsum("rpc,pjc->rj", slopes, jacobian),
            jnp.ones_like(residuals),
        )


class JointTerm(Term, ABC):
    """A cost of the m actuated joints, each for itself: a sum over the joints."""

    @abstractmethod
    def cost(self, q: AnyKind, goal: FrameGoal) -> AnyKind:
        """(..., m) joint positions [rad] to their (...) costs; NumPy or JAX."""

    @abstractmethod
    def joint_cost(self, q: Array, joint: int, goal: FrameGoal) -> Array:
        """The share of one joint, for positions of any shape [rad]."""

    @abstractmethod
    def derivatives(
        self, q: Float[Array, " m"], goal: FrameGoal
    ) -> tuple[Float[Array, " m"], Float[Array, " m"] | Float[Array, ""] | float]:
        """First derivative, and the diagonal of the second or the one number on it."""

    def square(self, goal: FrameGoal) -> Square | None:
        """The term as a square about a pose; None if it is something else."""
        del goal
        return None


class Square(NamedTuple):
    """weight |q - centre|^2 + constant.

    Attributes:
        weight, constant: numbers, traced or not.
        centre: (m,) [rad].
    """

    weight: Float[Array, ""] | float
    centre: Float[AnyArray, " m"]
    constant: Float[Array, ""] | float = 0.0

    def plus(self, other: Square) -> Square:
        """The sum of two squares, which is one about their weighted mean."""
        weight = self.weight + other.weight
        share = other.weight / jnp.maximum(weight, 1e-12)
        gap = self.centre - other.centre
        constant = self.weight * share * (gap**2).sum()
        return Square(
            weight,
            self.centre + share * (other.centre - self.centre),
            self.constant + other.constant + constant,
        )


class SquaredJointTerm(JointTerm):
    """A joint term that is a weight times the squared distance from a pose."""

    @abstractmethod
    def square(self, goal: FrameGoal) -> Square:
        """Weight and pose."""

    def cost(self, q: AnyKind, goal: FrameGoal) -> AnyKind:
        """See ``JointTerm``."""
        weight, centre, _ = self.square(goal)
        total: AnyKind = weight * ((q - centre.astype(q.dtype, copy=False)) ** 2).sum(axis=-1)
        return total

    def joint_cost(self, q: Array, joint: int, goal: FrameGoal) -> Array:
        """See ``JointTerm``."""
        weight, centre, _ = self.square(goal)
        share: Array = weight * (q - centre.astype(q.dtype)[joint]) ** 2
        return share

    def derivatives(
        self, q: Float[Array, " m"], goal: FrameGoal
    ) -> tuple[Float[Array, " m"], Float[Array, ""] | float]:
        """See ``JointTerm``."""
        weight, centre, _ = self.square(goal)
        return 2 * weight * (q - centre.astype(q.dtype)), 2 * weight


class TermConfig(Protocol):
    """Settings of a term, which build it for a hand; a ``Term`` is its own."""

    def build(self, hand: Hand) -> Term:
        """The term for one hand."""
