"""Time of a frame, by the stamps of the frames so far."""

from __future__ import annotations

from typing import Final, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, UInt32

_ADAPTS: Final = 0.05
"""By how much of the difference the usual time between frames adapts in each of them."""

_SHORTEST: Final = 1e-3
"""Time between frames that counts as some; stamps that stand still don't tell [s]."""


class FrameClock(NamedTuple):
    """Clock of frames: it turns their stamps into times.

    Attributes:
        dt: time since the last frame [s].
        period: usual time between frames [s].
        first: nothing came before.
        restart: nothing came before, or too long ago to count as motion.
    """

    dt: Float[Array, ""]
    period: Float[Array, ""]
    first: Bool[Array, ""]
    restart: Bool[Array, ""]

    @classmethod
    def of(
        cls,
        passed: UInt32[Array, ""],
        frames: UInt32[Array, ""],
        period: Float[Array, ""],
        rate_hz: float,
        gap: float,
    ) -> FrameClock:
        """Time of a frame; traceable.

        Args:
            passed: ticks since the last one, in microseconds modulo 2^32.
            frames: number of frames before it.
            period: usual time between them [s].
            rate_hz: rate that is assumed where stamps stand still.
            gap: longest time between frames that counts as motion [s].
        """
        elapsed = passed.astype(jnp.int32) * 1e-6
        first = frames == 0
        # a stamp that goes back belongs to another recording
        restart = first | (elapsed > gap) | (elapsed < 0)
        stamped = (elapsed >= _SHORTEST) & ~restart
        dt = jnp.where(stamped, elapsed, 1 / rate_hz).astype(jnp.float32)
        share = jnp.where(frames > 1, _ADAPTS, 1.0)
        return cls(dt, jnp.where(stamped, period + share * (dt - period), period), first, restart)
