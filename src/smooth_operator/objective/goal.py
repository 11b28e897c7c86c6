"""The goal of one frame: the numbers that the terms of an objective read."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Array, Float

from smooth_operator.geometry import AnyArray


class FrameGoal(NamedTuple):
    """Targets and weights of one frame.

    Attributes:
        vectors: (K, 3) keyvector targets [m].
        weights: (K,) their weights.
        previous: (m,) last command of the actuated joints [rad].
        velocity_weight: lambda_vel of the frame, or (m,) of each joint; 0 where there is no last
            command to be near to.
        tips: (F, 3) where fingertips arrive if they move as the human's do [m]; for the term of
            fingertip motion only.
        motion_weights: (F,) weights of that term, in the units of a keyvector's weight.
        rest: (m,) pose that joints are pulled to [rad]; None for the objective's own.
        near: (F,) how nearly each fingertip is where the human's is, 0 to 1; None if not known.
    """

    vectors: Float[AnyArray, "K 3"]
    weights: Float[AnyArray, " K"]
    previous: Float[AnyArray, " m"]
    velocity_weight: Float[Array, ""] | Float[Array, " m"] | float
    tips: Float[Array, "F 3"] | None = None
    motion_weights: Float[Array, " F"] | None = None
    rest: Float[Array, " m"] | None = None
    near: Float[Array, " F"] | None = None
