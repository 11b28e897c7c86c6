"""A price on parts of the hand inside each other, from the capsules of its links."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.capsules import CapsulePairs, segment_parameters

TRANSITION: Final = 0.02
"""That of the keyvectors' smooth-L1 [m], so that weights compare."""


@dataclass(frozen=True)
class ClearanceConfig:
    """How parts are kept out of each other.

    Attributes:
        weight: of a pair that is too near, in the units of a keyvector's weight: the price is
            weight x d^2 / (2 x 20 mm) for a depth d; 0 leaves the term out.
        margin: distance from which a pair counts [m]. Negative lets soft parts sink in.
    """

    weight: float = 7000.0
    margin: float = -0.00125

    def __post_init__(self) -> None:
        if isinstance(self.weight, float) and self.weight < 0:
            raise ConfigError(f"clearance: weight must not be negative, not {self.weight}")


class Crowding(NamedTuple):
    """What the pairs come to at one pose.

    Attributes:
        cost: the price.
        force: (2 C, 3) its derivative with the capsules' ends.
        rows: (P, 2 C, 3) derivative of each pair's depth with the ends.
        bend: (P,) second derivative of the price with each depth.
    """

    cost: Float[Array, ""]
    force: Float[Array, "E 3"]
    rows: Float[Array, "P E 3"]
    bend: Float[Array, " P"]


def crowding(pairs: CapsulePairs, ends: Float[Array, "E 3"], config: ClearanceConfig) -> Crowding:
    """The price at a pose, with what Newton steps need.

    The depth is differentiated with the nearest points held fixed on their segments, which is
    exact, since they are nearest; of its second derivative only the kinematics' part is kept.

    Args:
        pairs: of the hand, P of them.
        ends: (2 C, 3) the capsules' ends [m].
        config: weight and margin.
    """
    first, second = pairs.pairs.T
    one, other = ((ends[2 * c], ends[2 * c + 1]) for c in (first, second))
    s, t = segment_parameters(one, other)
    apart = (
        (1 - s)[:, None] * one[0]
        + s[:, None] * one[1]
        - (1 - t)[:, None] * other[0]
        - t[:, None] * other[1]
    )
    distance = jnp.sqrt((apart * apart).sum(-1) + 1e-12)
    depth = jnp.asarray(pairs.reach + 0.0, ends.dtype) + config.margin - distance
    inside = jnp.maximum(depth, 0.0)
    scale = config.weight / TRANSITION
    direction = -apart / distance[:, None]
    shares = jnp.stack([1 - s, s, t - 1, -t], axis=-1)  # of the four ends
    at = np.stack([2 * first, 2 * first + 1, 2 * second, 2 * second + 1], axis=-1)
    chosen = np.zeros((len(first), 4, len(ends)))
    chosen[np.arange(len(first))[:, None], np.arange(4), at] = 1
    mix = jnp.einsum("pk,pke->pe", shares, jnp.asarray(chosen, ends.dtype))
    rows = mix[:, :, None] * direction[:, None, :]
    force = (mix * (scale * inside)[:, None]).T @ direction
    return Crowding(
        0.5 * scale * (inside * inside).sum(),
        force,
        rows,
        jnp.where(depth > 0, scale, 0.0),
    )
