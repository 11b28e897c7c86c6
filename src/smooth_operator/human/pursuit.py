"""Points that are followed at once, but without jumps.

A point goes from where it was towards what was measured: nearly all the way while the step is
small, an ever smaller share as it grows. So ordinary motion passes with its direction, a fraction
of a frame late, and a tracker's leap of centimetres from one frame to the next, which would
dominate the acceleration of a whole recording, is spread over a few.

How long a leap is depends on the tracker: what a glove never does in a frame, a video does in
every one. So it is counted in units of what the points usually do between three frames that
steady motion doesn't explain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smooth_operator.settings import check_numbers, is_off

NOISE_AT_FIRST: Final = 5e-4
"""Noise of a tracker that hasn't been seen yet [m]: between a glove's and a video's."""


@dataclass(frozen=True)
class PursuitConfig:
    """How points are followed.

    Attributes:
        lag: by how much steady motion is late [s]; 0 follows at once.
        leap: a step in one frame of which no more than half is followed [m], for a tracker without
            noise.
        leap_speed: speed whose way between two frames is no leap where that is longer [m/s]: at
            low rates, and after lost frames.
        noise: by how many times the tracker's noise the leap is longer. With a leap of 0 as well,
            any is followed.
        noise_time: time over which the noise is a running mean [s].
    """

    lag: float = 0.0
    leap: float = 0.0
    leap_speed: float = 1.0
    noise: float = 0.0
    noise_time: float = 5.0

    def __post_init__(self) -> None:
        check_numbers(
            self,
            "landmarks.",
            positive=("noise_time",),
            not_negative=("lag", "leap", "leap_speed", "noise"),
        )


class Followed(NamedTuple):
    """What is remembered of points between frames.

    Attributes:
        points: (n, 3) where they were followed to [m].
        measured: (n, 3) where they were measured [m].
        step: (n, 3) how far they had been measured to go [m].
        root: running mean of the square root of the tracker's noise [m^0.5]: of the root, since
            what a tracker usually does is asked for, and not its worst.
    """

    points: Float[Array, "n 3"]
    measured: Float[Array, "n 3"]
    step: Float[Array, "n 3"]
    root: Float[Array, ""]

    @classmethod
    def nothing(cls, count: int) -> Followed:
        """Of points that haven't been seen yet."""
        zero = jnp.zeros((count, 3), jnp.float32)
        return cls(zero, zero, zero, jnp.sqrt(jnp.float32(NOISE_AT_FIRST)))

    @property
    def noise(self) -> Float[Array, ""]:
        """What the tracker is taken to add to a point, as a second difference [m]."""
        return self.root**2


def pursue(
    before: Followed,
    measured: Float[Array, "n 3"],
    dt: Float[Array, ""] | float,
    config: PursuitConfig,
    anew: Bool[Array, ""] | bool = False,
) -> tuple[Followed, Float[Array, "n 3"]]:
    """One frame.

    Args:
        before: what is remembered of the last frame.
        measured: (n, 3) where the points are now [m].
        dt: time between the two [s].
        config: how they are followed.
        anew: the last frame was too long ago to count. The noise is that of the tracker, and stays.

    Returns:
        What is remembered of this one, and (n, 3) how far the points were followed in it [m].
    """
    seen = jnp.where(anew, measured, before.measured)
    start = jnp.where(anew, measured, before.points)
    step = measured - seen
    # half of the points may do what they like: fingers that flick are not the tracker's noise
    bend = jnp.median(((step - before.step) ** 2).sum(-1) + 1e-18) ** 0.25
    share = jnp.where(anew, 0.0, dt / (dt + config.noise_time))
    root = before.root + share * (bend - before.root)
    after = Followed(measured, measured, step, root)
    leaps = not (is_off(config.leap) and is_off(config.noise))
    if leaps or not is_off(config.lag):
        way = measured - start
        late = jnp.full((len(measured), 1), config.lag / dt, way.dtype)
        if leaps:
            leap = jnp.maximum(config.leap + config.noise * before.noise, config.leap_speed * dt)
            late = late + jnp.sqrt((way * way).sum(-1, keepdims=True) + 1e-18) / leap
        after = after._replace(points=start + way / (1 + late))
    return after, after.points - start
