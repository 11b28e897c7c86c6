"""Filters fingertips: removes shake at rest and adds no delay to motion.

While a point stays within a few shake amplitudes of the filtered point, only a fraction of its
*step* is followed at once and the rest within seconds. The fraction grows with the distance, up to
the whole step, so motion begins without delay. The amplitude of the shake is measured during use:
it is the deviation of points from steady motion over some hundredths of a second, in the quietest
quarter of the time. Steps that are too long for a hand are followed only in part.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.geometry import lengths
from smooth_operator.retargeting.program import FrameClock
from smooth_operator.settings import check_numbers

SHAKE_AT_FIRST: Final = 1e-3
"""Initial estimate of the shake [m]. It is larger than that of most trackers, because the estimate
falls three times as fast as it grows."""
SHORT: Final = 0.02
"""Time scale that separates shake from motion [s]."""
ORDER: Final = 3
"""Order of the differences that measure shake; it is zero for motion with constant acceleration."""
STILL: Final = 0.25
"""Fraction of the time in which the hand is assumed to be at rest. The shake is this quantile of
the deviation from steady motion."""
_ADAPTS: Final = 0.4  # time constant with which the estimate of the shake can change [s]
_TINY: Final = 1e-6  # [m]


@dataclass(frozen=True)
class FingertipFilterConfig:
    """Settings of the fingertip filter.

    Attributes:
        share: fraction of a point's step that is followed at once at rest; 1 disables the filter.
        reach: distance from the filtered point, in shakes, at which half of the rest is followed.
        settle: time in which a resting point is reached [s].
        jump: step per frame of which half is followed, at a high frame rate [m].
        jump_speed: growth of ``jump`` with the time between two frames [m/s].
    """

    share: float = 0.3
    reach: float = 4.0
    settle: float = 2.0
    jump: float = 0.06
    jump_speed: float = 4.0

    def __post_init__(self) -> None:
        check_numbers(self, "fingertips.", positive=("reach", "settle", "jump"))


class FilterState(NamedTuple):
    """State of the filter between frames.

    Attributes:
        points: (n, 3) filtered points [m].
        followed: (n, 3) measured points without jumps [m].
        means: (ORDER, n, 3) running means of the measured points, of what these differ from their
            mean, and so on [m].
        shake: estimated amplitude of the tracker's shake at rest [m].
    """

    points: Float[Array, "n 3"]
    followed: Float[Array, "n 3"]
    means: Float[Array, "order n 3"]
    shake: Float[Array, ""]

    @classmethod
    def unseen(cls, count: int) -> FilterState:
        """Returns the state before the first frame."""
        zero, means = (np.zeros((*more, count, 3), np.float32) for more in ((), (ORDER,)))
        return cls(*jax.device_put((zero, zero, means, np.float32(SHAKE_AT_FIRST))))


def filter_fingertips(
    before: FilterState,
    measured: Float[Array, "n 3"],
    config: FingertipFilterConfig,
    clock: FrameClock,
) -> tuple[FilterState, Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Returns the state after a frame of (n, 3) measured points [m], and the (n, 3) steps [m] by
    which the filtered points, and the measured points without jumps, moved in that frame. If the
    last frame is too old to be used, the steps are 0, and the measured shake is kept."""
    dt, restart = clock
    start = jnp.where(restart, measured, before.points)
    followed = jnp.where(restart, measured, before.followed)
    beyond, means = measured, []
    for order in range(ORDER):
        mean = jnp.where(restart, 0.0 if order else measured, before.means[order])
        beyond = beyond - mean
        means.append(mean + dt / (dt + SHORT) * beyond)
    # the median, because a flicking finger is not tracker noise
    size = _median(lengths(beyond, _TINY**2))
    grows = jnp.where(size < before.shake, STILL - 1, STILL) * dt / _ADAPTS
    shake = jnp.where(restart, before.shake, before.shake * jnp.exp(grows))
    step = measured - followed
    long = lengths(step, _TINY**2) / (config.jump + config.jump_speed * dt)
    step = step / (1 + long[:, None] ** 2)
    followed = followed + step
    left = (lengths(followed - start, _TINY**2) / (config.reach * (before.shake + _TINY))) ** 4
    share = ((config.share + left) / (1 + left))[:, None]
    points = start + share * step
    points = points + dt / (dt + config.settle) * (followed - points)
    return FilterState(points, followed, jnp.stack(means), shake), points - start, step


def _median(values: Float[Array, " n"]) -> Float[Array, ""]:
    """Computed by comparisons instead of by sorting, because XLA calls a library to sort."""
    up_to = (values[None] <= values[:, None]).sum(axis=1)  # number of values up to each
    ranks = (len(values) + 1) // 2, len(values) // 2 + 1
    lower, upper = (jnp.where(up_to >= rank, values, jnp.inf).min() for rank in ranks)
    return 0.5 * (lower + upper)
