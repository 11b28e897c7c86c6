"""Goals of the frames of a recording, without regard to the command before.

Trajectory optimisation solves all frames together: each has a goal, and motion between them costs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.objective.local import LocalObjective
from smooth_operator.objective.loss import FrameGoal, Objective
from smooth_operator.objective.smooth import SmoothGoal, SmoothObjective

Goal: TypeAlias = Any
"""A frame's goal, as its method's objective takes it: a pytree of arrays."""


class NearObjective(Protocol):
    """A frame's cost near a pose."""

    def derivatives(self, q: Float[Array, " m"], goal: Goal) -> tuple[Array, Array, Array]:
        """Value, (m,) gradient and (m, m) Hessian."""

    def regularisation(self, q: Float[Array, " m"], goal: Goal) -> Float[Array, ""]:
        """The part of the value that is not about the human."""


class FrameGoals(Protocol):
    """Goals of successive frames; what passes from frame to frame is in and out, never inside."""

    @property
    def objective(self) -> NearObjective:
        """What the goals are for."""

    def begin(self) -> Any:
        """What is remembered before the first frame: a pytree of arrays."""

    def follow(self, memory: Any, aligned: Float[Array, "21 3"]) -> tuple[Any, Goal]:
        """The goal of a frame; traceable."""


@dataclass(frozen=True, eq=False)
class SbrGoals:
    """Goals of Eq. (1) without its velocity term.

    Attributes:
        eq_1: the objective.
    """

    eq_1: Objective

    @property
    def objective(self) -> NearObjective:
        """Eq. (1) near a pose."""
        return LocalObjective(self.eq_1)

    def begin(self) -> Any:
        """The target policy's first state."""
        return self.eq_1.config.targets.init(self.eq_1.layout)

    def follow(self, memory: Any, aligned: Float[Array, "21 3"]) -> tuple[Any, FrameGoal]:
        """Targets of the frame."""
        layout = self.eq_1.layout
        targets, memory = self.eq_1.config.targets(memory, layout, layout.human(aligned))
        neutral = jnp.asarray(self.eq_1.hand.neutral, aligned.dtype)
        goal = FrameGoal(targets.vectors, targets.weights, neutral, jnp.zeros((), aligned.dtype))
        return memory, goal


@dataclass(frozen=True, eq=False)
class SmoothGoals:
    """Goals of the objective of ``smooth``, on landmarks without its filter.

    Attributes:
        objective: that of ``smooth``.
        needs: the human landmarks that the method uses.
    """

    objective: SmoothObjective
    needs: tuple[int, ...]

    def begin(self) -> Any:
        """The target policy's first state."""
        eq_1 = self.objective.objective
        return eq_1.config.targets.init(eq_1.layout)

    def follow(self, memory: Any, aligned: Float[Array, "21 3"]) -> tuple[Any, SmoothGoal]:
        """Targets of the frame."""
        eq_1, seen = self.objective.objective, jnp.asarray(self.needs)
        points = jnp.zeros((NUM_LANDMARKS, 3), aligned.dtype).at[seen].set(aligned[seen])
        layout = eq_1.layout
        targets, memory = eq_1.config.targets(memory, layout, layout.human(points))
        neutral = jnp.asarray(eq_1.hand.neutral, aligned.dtype)
        frame = FrameGoal(targets.vectors, targets.weights, neutral, jnp.zeros((), aligned.dtype))
        tips = jnp.zeros((len(eq_1.hand.fingers), 3), aligned.dtype)
        return memory, SmoothGoal(frame, tips, tips[:, 0])
