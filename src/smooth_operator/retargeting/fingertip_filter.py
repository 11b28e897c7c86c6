"""Filter of fingertips: still while the human is still, without delay when he moves.

A tracker's points shake, also while the hand rests. Low-pass filters trade that shake for delay.
This one makes the *step* of a point smaller: while a point stays within a few shakes of the
filtered one, a share of its step is followed at once and the rest within seconds. The further it
leaves, the larger that share, up to the whole step. So a motion begins without delay, whether slow
or fast, a few shakes behind the human's, and catches up.

How large the shake is, is measured while the hand is in use: by what points do over some hundredths
of a second beyond steady motion, in the stillest quarter of the time. It is the same measure at any
frame rate. Steps too long for a hand are followed in part, so an outlier hardly moves anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.settings import check_numbers

SHAKE_AT_FIRST: Final = 1e-3
"""Shake of a tracker that hasn't been seen yet [m]: more than that of most, for the estimate falls
three times as fast as it grows."""
SHORT: Final = 0.02
"""Time over which shake differs from motion [s]."""
ORDER: Final = 3
"""Order of the differences that show it: a motion of constant acceleration has none."""
STILL: Final = 0.25
"""Share of the time in which the hand may be still: the shake is that quantile of what points do
beyond steady motion."""
_ADAPTS: Final = 0.4  # time in which the estimate of the shake can change by e [s]
_TINY: Final = 1e-6  # [m]


@dataclass(frozen=True)
class FingertipFilterConfig:
    """Settings of the filter of fingertips.

    Attributes:
        share: share of a point's step that is followed at once while it rests; 1 filters nothing.
        reach: distance from the filtered point, in shakes, at which half of the rest is followed.
        settle: time in which a resting point is reached [s].
        jump: step in one frame of which half is followed [m], at a high frame rate.
        jump_speed: what that step grows by with the time between two frames [m/s].
    """

    share: float = 0.3
    reach: float = 4.0
    settle: float = 2.0
    jump: float = 0.06
    jump_speed: float = 4.0

    def __post_init__(self) -> None:
        check_numbers(
            self,
            "fingertips.",
            positive=("reach", "settle", "jump"),
            not_negative=("share", "jump_speed"),
        )


class FilterState(NamedTuple):
    """State of the filter between frames.

    Attributes:
        points: (n, 3) filtered [m].
        followed: (n, 3) as measured, but for jumps [m].
        means: (ORDER, n, 3) running means of the measured points, of what these differ from their
            mean, and so on [m].
        shake: how far the tracker's points shake at rest [m].
    """

    points: Float[Array, "n 3"]
    followed: Float[Array, "n 3"]
    means: Float[Array, "order n 3"]
    shake: Float[Array, ""]

    @classmethod
    def unseen(cls, count: int) -> FilterState:
        """State of points without any frame yet."""
        zero, means, shake = jax.device_put(
            (
                np.zeros((count, 3), np.float32),
                np.zeros((ORDER, count, 3), np.float32),
                np.float32(SHAKE_AT_FIRST),
            )
        )
        return cls(zero, zero, means, shake)


def filter_fingertips(
    before: FilterState,
    measured: Float[Array, "n 3"],
    dt: Float[Array, ""] | float,
    config: FingertipFilterConfig,
    restart: Bool[Array, ""] | bool = False,
) -> tuple[FilterState, Float[Array, "n 3"]]:
    """The state after a frame of (n, 3) measured points [m], a time ``dt`` [s] after the last, and
    (n, 3) the steps of the filtered points in it [m].
    After a ``restart`` the last frame was too long ago to count; the measured shake is kept."""
    start = jnp.where(restart, measured, before.points)
    followed = jnp.where(restart, measured, before.followed)
    beyond, means = measured, []
    for order in range(ORDER):
        mean = jnp.where(restart, 0.0 if order else measured, before.means[order])
        beyond = beyond - mean
        means.append(mean + dt / (dt + SHORT) * beyond)
    size = _median(_lengths(beyond)[:, 0])  # the median: a finger that flicks is not the tracker
    grows = jnp.where(size < before.shake, STILL - 1, STILL) * dt / _ADAPTS
    shake = jnp.where(restart, before.shake, before.shake * jnp.exp(grows))
    step = measured - followed
    step = step / (1 + (_lengths(step) / (config.jump + config.jump_speed * dt)) ** 2)
    followed = followed + step
    left = (_lengths(followed - start) / (config.reach * (before.shake + _TINY))) ** 4
    share = (config.share + left) / (1 + left)
    points = start + share * step
    points = points + dt / (dt + config.settle) * (followed - points)
    return FilterState(points, followed, jnp.stack(means), shake), points - start


def _lengths(vectors: Float[Array, "n 3"]) -> Float[Array, "n 1"]:
    return jnp.sqrt((vectors * vectors).sum(-1, keepdims=True) + _TINY**2)


def _median(values: Float[Array, " n"]) -> Float[Array, ""]:
    """By rank and not by sorting, for which XLA calls a library."""
    count, index = len(values), np.arange(len(values))
    first = (values[None] < values[:, None]) | (
        (values[None] == values[:, None]) & (index[None] < index[:, None])
    )
    rank = first.sum(axis=1)
    middle = jnp.where((rank == (count - 1) // 2) | (rank == count // 2), values, 0.0)
    return middle.sum() / (2 - count % 2)
