"""Second term of Eq. (1): joints stay near a neutral pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.terms.term import Square, SquaredJointTerm


@dataclass(frozen=True, eq=False)
class NeutralPose(SquaredJointTerm):
    """lambda_reg |q - q_neutral|^2.

    Attributes:
        weight: lambda_reg.
        centre: (m,) the neutral pose [rad].
    """

    weight: float
    centre: Float[np.ndarray, " m"]

    def square(self, goal: FrameGoal) -> Square:
        """About the neutral pose, or the frame's own rest pose."""
        return Square(self.weight, self.centre if goal.rest is None else goal.rest)
