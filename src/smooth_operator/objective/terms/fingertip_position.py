"""Fingertips are exactly where the human's are, where they are nearly so already.

The keyvectors between fingertips weigh more than those from the wrist, so that all fingertips
together are held softly. This cost makes it stiff where the robot can reach the human's fingertips.
It is bounded: a fingertip that is far from the human's, for the robot's bones are others, is not
pulled, and moves as the human's does.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.hands.hand import Hand
from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.keyvectors import KeyvectorLayout
from smooth_operator.objective.terms.robot_vectors import RobotVectors
from smooth_operator.objective.terms.self_collision import TRANSITION
from smooth_operator.objective.terms.term import PointTerm, Quadratic
from smooth_operator.settings import check_numbers, is_off


@dataclass(frozen=True)
class FingertipPositionConfig:
    """Settings of the fingertip position cost.

    Attributes:
        weight: weight of a small error, in the units of a keyvector's weight: the cost is
            weight x e^2 / (2 x 20 mm) / (1 + e^2 / width^2) for an error e (Geman-McClure); 0
            leaves the term out.
        width: error beyond which the force falls [m].
    """

    weight: float = 40.0
    width: float = 0.004

    def __post_init__(self) -> None:
        check_numbers(self, "fingertip_position.", positive=("width",), not_negative=("weight",))

    def build(self, hand: Hand) -> FingertipPosition:
        """The term for one hand, over the paper's keyvectors."""
        return FingertipPosition(RobotVectors(hand, KeyvectorLayout(hand.fingers)), self)


@dataclass(frozen=True, eq=False)
class FingertipPosition(PointTerm):
    """Bounded cost of the wrist-to-tip vectors.

    Attributes:
        vectors: the robot's keyvectors.
        config: settings.
    """

    vectors: RobotVectors
    config: FingertipPositionConfig

    @property
    def is_off(self) -> bool:
        """Without weight."""
        return is_off(self.config.weight)

    def points(self) -> tuple[str, ...]:
        """Landmarks that the vectors join and a joint moves."""
        return self.vectors.names

    def expand(
        self, points: Float[Array, "P 3"], jacobian: Float[Array, "P J 3"], goal: FrameGoal
    ) -> Quadratic:
        """See ``PointTerm``; what is negative in the Hessian is left out."""
        config = self.config
        wrist = slice(0, len(self.vectors.keyvectors("fingertip positions").fingers))
        errors = (self.vectors.at(points) - jnp.asarray(goal.vectors))[wrist]
        squared = (errors * errors).sum(-1)
        share = 1 / (1 + squared / config.width**2)
        stiffness = config.weight / TRANSITION
        weights = stiffness * share**2
        return Quadratic(
            0.5 * stiffness * (squared * share).sum(),
            self.vectors.spread(weights[:, None] * errors, wrist),
            self.vectors.jacobian(jacobian)[wrist].reshape(errors.size, jacobian.shape[1]),
            jnp.repeat(weights, 3),
        )
