"""The measured state of a robot hand, as a sink that reads its hand back gives it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.types import Side


@dataclass(frozen=True, eq=False)
class HandState:
    """Where a robot hand is, real or simulated, and what its actuators feel.

    Attributes:
        side: which hand.
        hand: name of the robot hand.
        stamp: of the measurement, by the loop's clock [s].
        names: (n,) joint names, in the model's own order, coupled ones included.
        positions: (n,) measured joint positions [rad]; NaN where the hand measures none.
        velocities: (n,) measured joint velocities [rad/s], or None.
        actuators: (a,) names of the actuators; empty where there are none of their own.
        currents: (a,) current of the actuators, or force, in the driver's unit; NaN where unknown;
            None if the hand measures none.
        temperatures: (a,) of the actuators [degrees Celsius], or None.
        touch: (k,) touch or force sensors, in the driver's unit and order, or None.
    """

    side: Side
    hand: str
    stamp: float
    names: tuple[str, ...]
    positions: Float[np.ndarray, " n"]
    velocities: Float[np.ndarray, " n"] | None = None
    actuators: tuple[str, ...] = ()
    currents: Float[np.ndarray, " a"] | None = None
    temperatures: Float[np.ndarray, " a"] | None = None
    touch: Float[np.ndarray, " k"] | None = None

    @property
    def time(self) -> float:
        """The stamp; the name that simulations use."""
        return self.stamp
