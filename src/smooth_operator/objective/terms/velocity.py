"""Third term of Eq. (1): the command stays near the last one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.geometry import AnyKind
from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.penalties import smooth_l1, smooth_l1_slopes
from smooth_operator.objective.terms.term import JointTerm, Square, SquaredJointTerm


@dataclass(frozen=True, eq=False)
class Velocity(SquaredJointTerm):
    """lambda_vel |q - q_prev|^2, with the weight of the frame, or one for each joint."""

    def square(self, goal: FrameGoal) -> Square:
        """About the last command."""
        return Square(goal.velocity_weight, goal.previous)

    def cost(self, q: AnyKind, goal: FrameGoal) -> AnyKind:
        """See ``JointTerm``."""
        weight: Any = goal.velocity_weight
        each: AnyKind = weight * (q - goal.previous) ** 2
        return each.sum(axis=-1) if jnp.ndim(weight) else super().cost(q, goal)


@dataclass(frozen=True, eq=False)
class SmoothL1Velocity(JointTerm):
    """Smooth-L1 of the weight times the change of each joint, as in AKO.

    Attributes:
        transition: where smooth-L1 turns from quadratic to linear [rad].
    """

    transition: float

    def cost(self, q: AnyKind, goal: FrameGoal) -> AnyKind:
        """See ``JointTerm``."""
        change: Any = q - goal.previous
        total: AnyKind = smooth_l1(goal.velocity_weight * change, self.transition).sum(axis=-1)
        return total

    def joint_cost(self, q: Array, joint: int, goal: FrameGoal) -> Array:
        """See ``JointTerm``."""
        return smooth_l1(goal.velocity_weight * (q - goal.previous[joint]), self.transition)

    def derivatives(
        self, q: Float[Array, " m"], goal: FrameGoal
    ) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """See ``JointTerm``."""
        weight = goal.velocity_weight
        first, second = smooth_l1_slopes(weight * (q - goal.previous), self.transition)
        return weight * first, weight**2 * second
