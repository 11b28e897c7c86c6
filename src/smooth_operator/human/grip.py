"""Grip: thumb and finger press on what is between them.

An object keeps thumb and finger apart. A robot whose fingertips keep the same distance touches it
and hardly presses, and a tracker's shake is then enough to drop it. So where thumb and finger are
near each other and keep their distance, the robot's fingertips are asked to be nearer to each other
than the human's by some millimetres, which servos turn into a force. Pads with nothing between them
meet, and self-collision stops them. A change of the distance ends the grip within millimetres, so a
human who opens lets go at once.

For finger i at distance d_i from the thumb, with the mean D_i of it over ``time`` and the nearness
n_i of the correspondence, which is 0 for a finger that pinches nothing:

    g_i <- min(g_i + dt / time, max(0, 1 - ((d_i - D_i) / 5 mm)^2))

The finger's place moves towards the thumb by n_i^4 g_i d_i ``depth`` / (2 (d_i + ``depth``)), which
never turns the vector between them. The thumb's place moves by the largest of these lengths, along
the sum of these steps reversed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.settings import check_numbers

RELEASE: Final = 0.005
"""Change of the distance that ends the grip [m]."""
_TINY: Final = 1e-9


@dataclass(frozen=True)
class GripConfig:
    """Settings of the grip.

    Attributes:
        depth: by how much the robot's thumb and finger are asked to be nearer to each other than
            the human's, whose distance is long against it [m]; 0 for no grip.
        time: time in which the grip grows to that, and of the mean distance [s].
    """

    depth: float = 0.004
    time: float = 0.25

    def __post_init__(self) -> None:
        check_numbers(self, "grip.", positive=("time",), not_negative=("depth",))


class GripState(NamedTuple):
    """State of the grip between frames.

    Attributes:
        distances: (F - 1,) mean distance of each finger from the thumb [m].
        shares: (F - 1,) how far the grip of each finger has grown, 0 to 1.
        offsets: (F, 3) by how much the fingertips' places are moved, thumb first [m].
    """

    distances: Float[Array, " P"]
    shares: Float[Array, " P"]
    offsets: Float[Array, "F 3"]

    @classmethod
    def open(cls, fingers: int) -> GripState:
        """State of a hand with that many fingers that holds nothing."""
        zero = np.zeros(fingers - 1, np.float32)
        return cls(*jax.device_put((zero, zero, np.zeros((fingers, 3), np.float32))))


def grip(
    before: GripState,
    tips: Float[Array, "F 3"],
    nearness: Float[Array, " P"],
    dt: Float[Array, ""] | float,
    config: GripConfig,
    restart: Bool[Array, ""] | bool = False,
) -> GripState:
    """The grip after a frame.

    Args:
        before: the grip after the last frame.
        tips: (F, 3) the human's fingertips, thumb first [m].
        nearness: (F - 1,) how much each finger pinches, 0 to 1.
        dt: time since the last frame [s].
        config: settings.
        restart: True if nothing came before, or too long ago to count.
    """
    vectors = tips[1:] - tips[0]
    distances = jnp.sqrt((vectors * vectors).sum(-1) + _TINY)
    mean = jnp.where(restart, distances, before.distances)
    change = distances - mean
    stays = jnp.maximum(1 - (change / RELEASE) ** 2, 0.0)
    shares = jnp.minimum(jnp.where(restart, 0.0, before.shares) + dt / config.time, stays)
    # The fourth power leaves fingers round a handle as they are: harder pressed, one of them takes
    # the force and the handle turns. Tips that nearly meet are moved less, so that the vector
    # between them keeps its direction.
    lengths = 0.5 * config.depth * nearness**4 * shares * distances / (distances + config.depth)
    pulls = (lengths / distances)[:, None] * vectors
    thumb = pulls.sum(0)
    thumb = thumb * (lengths.max() / (jnp.sqrt((thumb * thumb).sum()) + _TINY))
    mean = mean + dt / (dt + config.time) * change
    return GripState(mean, shares, jnp.concatenate([thumb[None], -pulls]))
