"""Goals of the frames of a recording, without regard to the command before.

Trajectory optimisation solves all frames together: each has a goal, and motion between them costs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.loss import Objective


@dataclass(frozen=True, eq=False)
class FrameGoals:
    """Goals of successive frames; what passes from frame to frame is in and out, never inside.

    Attributes:
        objective: the cost that the goals are for.
    """

    objective: Objective

    def begin(self) -> Any:
        """State before the first frame: the target policy's first state."""
        return self.objective.config.targets.init(self.objective.layout)

    def follow(self, memory: Any, aligned: Float[Array, "21 3"]) -> tuple[Any, FrameGoal]:
        """The goal of a frame, without velocity and motion of fingertips; traceable.

        Args:
            memory: from ``begin`` or the frame before.
            aligned: (21, 3) landmarks in the palm frame [m].

        Returns:
            what is remembered after the frame, and the goal.
        """
        objective, hand = self.objective, self.objective.hand
        layout = objective.layout
        targets, memory = objective.config.targets(memory, layout, layout.human(aligned))
        neutral = jnp.asarray(hand.neutral, aligned.dtype)
        none = jnp.zeros((), aligned.dtype)
        tips = jnp.zeros((len(hand.fingers), 3), aligned.dtype)
        goal = FrameGoal(targets.vectors, targets.weights, neutral, none, tips, tips[:, 0])
        return memory, goal
