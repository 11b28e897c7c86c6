"""Points that are followed at once, but without jumps.

A point goes from where it was towards what was measured: nearly all the way while the step is
small, an ever smaller share as it grows. So ordinary motion passes with its direction, a fraction
of a frame late, and a tracker's leap of centimetres from one frame to the next, which would
dominate the acceleration of a whole recording, is spread over a few.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError


@dataclass(frozen=True)
class PursuitConfig:
    """How a point is followed.

    Lag and leap count by the frame, on purpose: what they take out is noise that a tracker adds to
    each frame anew, and a lag that must stay under a frame at any rate.

    Attributes:
        lag: by how much steady motion is late [frames]; 0 follows at once.
        leap: a step in one frame of which no more than half is followed [m]; 0 follows any.
        leap_speed: speed whose way between two frames is no leap where that is longer [m/s]: at
            low rates, and after lost frames.
    """

    lag: float = 0.0
    leap: float = 0.0
    leap_speed: float = 2.4

    def __post_init__(self) -> None:
        for name in ("lag", "leap", "leap_speed"):
            value = getattr(self, name)
            if isinstance(value, int | float) and not value >= 0:
                raise ConfigError(f"pursuit: {name} must not be negative, not {value}")


def is_off(setting: object) -> bool:
    """Whether a setting is a plain zero; one that is traced, as when settings are tuned, is not."""
    return isinstance(setting, int | float) and setting == 0


def pursue(
    before: Float[Array, "*n 3"],
    measured: Float[Array, "*n 3"],
    dt: Float[Array, ""] | float,
    config: PursuitConfig,
) -> Float[Array, "*n 3"]:
    """One frame.

    Args:
        before: (..., 3) where the points were followed to in the last frame [m].
        measured: (..., 3) where they are now [m].
        dt: time between the two [s].
        config: how they are followed.

    Returns:
        (..., 3) where they are followed to now [m].
    """
    if is_off(config.lag) and is_off(config.leap):
        return measured
    step = measured - before
    late = jnp.full((*step.shape[:-1], 1), config.lag, step.dtype)
    if not is_off(config.leap):
        leap = jnp.maximum(config.leap, config.leap_speed * dt)
        late = late + jnp.sqrt((step * step).sum(-1, keepdims=True) + 1e-18) / leap
    followed: Array = before + step / (1 + late)
    return followed
