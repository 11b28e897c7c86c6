"""Direction error (1 - cosine) and length error of the thumb-to-tip vectors, each with its cost.

Where parts that touch keep a short vector from its target, the nearest point to the target may lie
in any direction. With a cost of its own, the direction stays the human's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.hands.hand import Hand
from smooth_operator.objective.goal import FrameGoal
from smooth_operator.objective.keyvectors import KeyvectorLayout
from smooth_operator.objective.terms.robot_vectors import RobotVectors
from smooth_operator.objective.terms.term import PointTerm, Quadratic
from smooth_operator.settings import check_numbers, is_off

_SHORT: Final = 0.002
"""Length by which a vector is rounded, since a vector of length 0 has no direction [m]."""
_LEAST: Final = 0.25
"""Share of the curvature that is kept where a vector points away; its own would be negative."""


@dataclass(frozen=True)
class DirectionLengthConfig:
    """Settings of the direction and length cost.

    The cost of length is linear beyond ``huber_width``, so the force that closes a pinch is
    bounded, and with it the depth to which parts are pressed into each other.

    Attributes:
        direction: cost of one minus the cosine between a vector and the human's; 0 leaves it out.
        length: cost per metre of the length error of a short vector; 0 leaves it out.
        huber_width: length error below which that cost is quadratic [m].
        near: length of the human's vector at which that cost is halved; it falls with the fourth
            power [m].
    """

    direction: float = 1.5
    length: float = 115.0
    huber_width: float = 0.0012
    near: float = 0.0145

    def __post_init__(self) -> None:
        check_numbers(
            self,
            "direction_length.",
            positive=("huber_width", "near"),
            not_negative=("direction", "length"),
        )

    def build(self, hand: Hand) -> DirectionLength:
        """The term for one hand, over the paper's keyvectors."""
        return DirectionLength(RobotVectors(hand, KeyvectorLayout(hand.fingers)), self)


class VectorCosts(NamedTuple):
    """The costs of P vectors.

    Attributes:
        cost: their sum.
        gradient: (P, 3) derivative with respect to each vector.
        hessian: (P, 3, 3) second derivative, without what is negative in it.
    """

    cost: Float[Array, ""]
    gradient: Float[Array, "P 3"]
    hessian: Float[Array, "P 3 3"]


def direction_length_cost(
    vectors: Float[Array, "P 3"], targets: Float[Array, "P 3"], config: DirectionLengthConfig
) -> VectorCosts:
    """The costs of some vectors.

    Args:
        vectors: (P, 3) the robot's [m].
        targets: (P, 3) what they should be [m].
        config: weights.
    """
    goal_length = jnp.sqrt((targets * targets).sum(-1) + 1e-12)
    size = jnp.sqrt((vectors * vectors).sum(-1) + _SHORT**2)
    goal, unit = targets / goal_length[:, None], vectors / size[:, None]
    cosine = (goal * unit).sum(-1)
    turn = -(config.direction / size)[:, None] * (goal - cosine[:, None] * unit)
    along = unit[:, :, None] * unit[:, None, :]
    across = jnp.eye(3, dtype=unit.dtype) - along
    turn_weight = config.direction * jnp.maximum(cosine, _LEAST) / size**2
    slope = config.length / (1 + (goal_length / config.near) ** 4)
    longer = size - goal_length
    rounded = jnp.sqrt(longer * longer + config.huber_width**2)
    # the second derivative of the parabola that touches the cost on both sides: never too little
    length_weight = slope / rounded
    return VectorCosts(
        (config.direction * (1 - cosine) + slope * (rounded - config.huber_width)).sum(),
        turn + (length_weight * longer)[:, None] * unit,
        turn_weight[:, None, None] * across + length_weight[:, None, None] * along,
    )


@dataclass(frozen=True, eq=False)
class DirectionLength(PointTerm):
    """Direction and length cost of the vectors from the thumb's tip to the other tips.

    Attributes:
        vectors: the robot's keyvectors.
        config: settings.
    """

    vectors: RobotVectors
    config: DirectionLengthConfig

    @property
    def is_off(self) -> bool:
        """True if both costs are left out."""
        return is_off(self.config.direction) and is_off(self.config.length)

    def points(self) -> tuple[str, ...]:
        """Landmarks that the vectors join and a joint moves."""
        return self.vectors.names

    def expand(
        self, points: Float[Array, "P 3"], jacobian: Float[Array, "P J 3"], goal: FrameGoal
    ) -> Quadratic:
        """See ``PointTerm``; what is negative in the Hessian is left out."""
        thumb = self.vectors.keyvectors("direction and length").thumb
        targets = jnp.asarray(goal.vectors)
        # error + target, not the vectors themselves: a compiler shares the error with the keyvector
        # term, and the rounding decides when Newton steps stop
        vectors = (self.vectors.at(points) - targets) + targets
        expansion = direction_length_cost(vectors[thumb], targets[thumb], self.config)
        return Quadratic(
            expansion.cost,
            self.vectors.spread(expansion.gradient, thumb),
            self.vectors.jacobian(jacobian)[thumb],
            expansion.hessian,
        )
