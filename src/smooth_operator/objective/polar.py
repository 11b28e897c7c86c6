"""Prices on where a vector points and how long it is, each by itself.

A distance cannot tell them apart, and where parts that touch keep a short vector from its target,
the nearest point to that is one that points anywhere. By angle and length, it goes on to point as
the human's does, a little longer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.human.pursuit import is_off

_SHORT: Final = 0.002
"""Length by which a vector is rounded, for one of length 0 points nowhere [m]."""
_LEAST: Final = 0.25
"""Share of the curvature that is kept where a vector points away; its own would be negative."""


@dataclass(frozen=True)
class PolarConfig:
    """How the robot's thumb-to-tip vectors are held by angle and length.

    The length's price is linear, so the force that closes a pinch has a bound, and with it how deep
    parts are pressed into each other.

    Attributes:
        direction: price of one minus the cosine between a vector and the human's; 0 leaves it out.
        length: price of a metre by which the length of a short vector is off; 0 leaves it out.
        knee: difference in length below which that price is quadratic [m].
        near: length of the human's at which that price is halved; it falls with the fourth power
            [m].
    """

    direction: float = 1.5
    length: float = 115.0
    knee: float = 0.0012
    near: float = 0.0145

    def __post_init__(self) -> None:
        for name in ("direction", "length"):
            value = getattr(self, name)
            if isinstance(value, int | float) and not value >= 0:
                raise ConfigError(f"polar.{name} must not be negative, not {value}")
        for name in ("knee", "near"):
            value = getattr(self, name)
            if isinstance(value, int | float) and not value > 0:
                raise ConfigError(f"polar.{name} must be a positive length [m], not {value}")

    @property
    def is_off(self) -> bool:
        """Whether both prices are left out."""
        return is_off(self.direction) and is_off(self.length)


class Polar(NamedTuple):
    """What the prices come to.

    Attributes:
        cost: their sum.
        pull: (P, 3) derivative with each vector.
        bend: (P, 3, 3) second derivative with each vector, with what is negative in it left out.
    """

    cost: Float[Array, ""]
    pull: Float[Array, "P 3"]
    bend: Float[Array, "P 3 3"]


def polar(vectors: Float[Array, "P 3"], targets: Float[Array, "P 3"], config: PolarConfig) -> Polar:
    """The prices of some vectors.

    Args:
        vectors: (P, 3) the robot's [m].
        targets: (P, 3) what they should be [m].
        config: weights.
    """
    wanted = jnp.sqrt((targets * targets).sum(-1) + 1e-12)
    size = jnp.sqrt((vectors * vectors).sum(-1) + _SHORT**2)
    goal, unit = targets / wanted[:, None], vectors / size[:, None]
    cosine = (goal * unit).sum(-1)
    pull = -(config.direction / size)[:, None] * (goal - cosine[:, None] * unit)
    along = unit[:, :, None] * unit[:, None, :]
    turn = config.direction * jnp.maximum(cosine, _LEAST) / size**2
    price = config.length / (1 + (wanted / config.near) ** 4)
    longer = size - wanted
    rounded = jnp.sqrt(longer * longer + config.knee**2)
    # of the bend, what a parabola has that touches the price on both sides: never too little
    stiff = price / rounded
    return Polar(
        (config.direction * (1 - cosine) + price * (rounded - config.knee)).sum(),
        pull + (stiff * longer)[:, None] * unit,
        turn[:, None, None] * (jnp.eye(3, dtype=unit.dtype) - along) + stiff[:, None, None] * along,
    )
