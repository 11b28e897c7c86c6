"""Joint limits of a frame that keep a bent finger on its side of straight."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.hands.finger_circles import SHORTER, bends_past_straight
from smooth_operator.hands.hand import Hand


def frame_limits(
    hand: Hand, tips: Float[Array, "F 3"] | Float[np.ndarray, "F 3"]
) -> Float[Array, "m 2"] | Float[np.ndarray, "m 2"]:
    """(m, 2) joint limits of a frame [rad]; traceable.

    Many robot fingers are longest some degrees before the limit of a joint beyond the knuckle: it
    bends them past straight. Between limit and that joint position a finger can't get shorter than
    at the limit: an optimiser that ends there holds it straight or bent backwards, though the
    human's is bent. Where the human's fingertip is nearer to the finger's base than that, the joint
    is kept on the other side.

    Args:
        hand: the robot hand.
        tips: (F, 3) where the human's fingertips are, from the robot's wrist [m].
    """
    limits, bends = hand.limits, bends_past_straight(hand)
    if not bends:
        return limits
    fingers, joints, longest, length, centres = map(np.array, zip(*bends, strict=True))
    tips = jnp.asarray(tips)
    away = tips[fingers] - jnp.asarray(centres, tips.dtype)
    bent = (away * away).sum(-1) < jnp.asarray(length - SHORTER, tips.dtype) ** 2
    low, high = (jnp.asarray(side, tips.dtype) for side in limits.T)
    low = low.at[joints].set(jnp.where(bent, jnp.asarray(longest, tips.dtype), low[joints]))
    return jnp.stack([low, high], axis=1)
