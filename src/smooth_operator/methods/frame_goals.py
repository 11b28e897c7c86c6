"""Goals of the frames of a recording, without regard to the command before.

Trajectory optimisation solves all frames together: each has a goal, and motion between them costs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.objective.loss import FrameGoal, Objective

Goal: TypeAlias = Any
"""A frame's goal, as its method's objective takes it: a pytree of arrays."""


class NearObjective(Protocol):
    """A frame's cost near a pose."""

    def derivatives(self, q: Float[Array, " m"], goal: Goal) -> tuple[Array, Array, Array]:
        """Value, (m,) gradient and (m, m) Hessian."""

    def regularisation(self, q: Float[Array, " m"], goal: Goal) -> Float[Array, ""]:
        """The part of the value that is not about the human."""


@dataclass(frozen=True, eq=False)
class FrameGoals:
    """Goals of successive frames; what passes from frame to frame is in and out, never inside.

    Attributes:
        objective: the cost that the goals are for.
        eq_1: the objective whose targets they have, for the hand.
        wrap: from a goal of Eq. (1), without its velocity term, to a goal of ``objective``.
    """

    objective: NearObjective
    eq_1: Objective
    wrap: Callable[[FrameGoal], Goal] = lambda goal: goal

    def begin(self) -> Any:
        """What is remembered before the first frame: the target policy's first state."""
        return self.eq_1.config.targets.init(self.eq_1.layout)

    def follow(self, memory: Any, aligned: Float[Array, "21 3"]) -> tuple[Any, Goal]:
        """The goal of a frame; traceable.

        Args:
            memory: from ``begin`` or the frame before.
            aligned: (21, 3) landmarks in the palm frame [m].

        Returns:
            what is remembered after the frame, and the goal.
        """
        layout = self.eq_1.layout
        targets, memory = self.eq_1.config.targets(memory, layout, layout.human(aligned))
        neutral = jnp.asarray(self.eq_1.hand.neutral, aligned.dtype)
        no_velocity = jnp.zeros((), aligned.dtype)
        return memory, self.wrap(FrameGoal(targets.vectors, targets.weights, neutral, no_velocity))
