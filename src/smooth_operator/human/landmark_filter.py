"""Landmark filter: a low-pass that limits outliers and hardly delays ordinary motion.

A point moves from where it was towards the measurement: nearly all the way while the step is small,
a smaller share as the step grows, so a tracker's jump of centimetres is spread over several frames.
What is a jump depends on the tracker: the threshold grows with its noise, measured by what the
points usually do between three frames beyond steady motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.settings import check_numbers, is_off

NOISE_AT_FIRST: Final = 5e-4
"""Noise of a tracker that hasn't been seen yet [m]: between a glove's and a video's."""


@dataclass(frozen=True)
class LandmarkFilterConfig:
    """Settings of the landmark filter.

    Attributes:
        time_constant: delay of steady motion [s]; 0 for none.
        jump_threshold: step in one frame that is followed by half at most [m], for a tracker
            without noise.
        jump_speed: speed whose way between two frames is no jump where that is longer than the
            threshold [m/s]: at low rates, and after lost frames.
        noise: the threshold grows by this many times the tracker's noise. With a threshold of 0 as
            well, no step is limited.
        noise_time: averaging time of the noise [s].
    """

    time_constant: float = 0.0
    jump_threshold: float = 0.0
    jump_speed: float = 1.0
    noise: float = 0.0
    noise_time: float = 5.0

    def __post_init__(self) -> None:
        check_numbers(
            self,
            "landmarks.",
            positive=("noise_time",),
            not_negative=("time_constant", "jump_threshold", "jump_speed", "noise"),
        )


class FilterState(NamedTuple):
    """State of the filter between frames.

    Attributes:
        points: (n, 3) filtered [m].
        measured: (n, 3) as measured [m].
        step: (n, 3) change of the measurement in the last frame [m].
        root: running mean of the square root of the tracker's noise [m^0.5]: the mean of roots
            measures what a tracker usually does, and not its worst.
    """

    points: Float[Array, "n 3"]
    measured: Float[Array, "n 3"]
    step: Float[Array, "n 3"]
    root: Float[Array, ""]

    @classmethod
    def unseen(cls, count: int) -> FilterState:
        """State of points without any frame yet."""
        zero, root = jax.device_put(
            (np.zeros((count, 3), np.float32), np.sqrt(np.float32(NOISE_AT_FIRST)))
        )
        return cls(zero, zero, zero, root)

    @property
    def noise(self) -> Float[Array, ""]:
        """Estimated noise of the tracker, as a second difference of a point [m]."""
        return self.root**2


def filter_landmarks(
    before: FilterState,
    measured: Float[Array, "n 3"],
    dt: Float[Array, ""] | float,
    config: LandmarkFilterConfig,
    restart: Bool[Array, ""] | bool = False,
) -> tuple[FilterState, Float[Array, "n 3"]]:
    """One frame.

    Args:
        before: state after the last frame.
        measured: (n, 3) where the points are now [m].
        dt: time between the two [s].
        config: settings.
        restart: the last frame was too long ago to count; the noise estimate is kept.

    Returns:
        The state after this frame, and (n, 3) the step of the filtered points in it [m].
    """
    last = jnp.where(restart, measured, before.measured)
    start = jnp.where(restart, measured, before.points)
    step = measured - last
    # the median over points: fingers that flick are not the tracker's noise
    noise_root = _median(((step - before.step) ** 2).sum(-1) + 1e-18) ** 0.25
    share = jnp.where(restart, 0.0, dt / (dt + config.noise_time))
    root = before.root + share * (noise_root - before.root)
    after = FilterState(measured, measured, step, root)
    limits_jumps = not (is_off(config.jump_threshold) and is_off(config.noise))
    if limits_jumps or not is_off(config.time_constant):
        way = measured - start
        delay = jnp.full((len(measured), 1), config.time_constant / dt, way.dtype)
        if limits_jumps:
            threshold = config.jump_threshold + config.noise * before.noise
            threshold = jnp.maximum(threshold, config.jump_speed * dt)
            delay = delay + jnp.sqrt((way * way).sum(-1, keepdims=True) + 1e-18) / threshold
        after = after._replace(points=start + way / (1 + delay))
    return after, after.points - start


def _median(values: Float[Array, " n"]) -> Float[Array, ""]:
    """By rank and not by sorting, for which XLA calls a library."""
    count, index = len(values), np.arange(len(values))
    first = (values[None] < values[:, None]) | (
        (values[None] == values[:, None]) & (index[None] < index[:, None])
    )
    rank = first.sum(axis=1)
    middle = jnp.where((rank == (count - 1) // 2) | (rank == count // 2), values, 0.0)
    return middle.sum() / (2 - count % 2)
