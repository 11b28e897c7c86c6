"""The measured joints of a robot hand over an episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError


@dataclass(frozen=True, eq=False)
class StateTrajectory:
    """Where a robot hand was, real or simulated, and what its actuators felt.

    Attributes:
        stamps: (S,) rising times of the measurements [s], on the clock of the episode's commands.
        positions: (S, n) measured joint positions [rad]; NaN where the hand measures none.
        names: (n,) joint names.
        actuators: (a,) names of the actuators; empty where there are none of their own.
        currents: (S, a) current or force of the actuators, in the driver's unit, or None.
        touch: (S, k) touch or force sensors, in the driver's unit, or None.

    Raises:
        RecordingError: the arrays do not fit each other.
    """

    stamps: Float[np.ndarray, " S"]
    positions: Float[np.ndarray, "S n"]
    names: tuple[str, ...]
    actuators: tuple[str, ...] = ()
    currents: Float[np.ndarray, "S a"] | None = None
    touch: Float[np.ndarray, "S k"] | None = None

    def __post_init__(self) -> None:
        count = len(self.stamps)
        shapes = {
            "positions": (self.positions, (count, len(self.names))),
            "currents": (self.currents, (count, len(self.actuators))),
        }
        for name, (values, shape) in shapes.items():
            if values is not None and np.shape(values) != shape:
                raise RecordingError(
                    f"measured {name} must have shape {shape}, not {np.shape(values)}"
                )
        if self.touch is not None and len(self.touch) != count:
            raise RecordingError(f"touch must have {count} rows, not {len(self.touch)}")
        if not (np.isfinite(self.stamps).all() and (np.diff(self.stamps) >= 0).all()):
            raise RecordingError("the stamps of measured joints must be finite, and never go back")

    def __len__(self) -> int:
        return len(self.stamps)

    def at(self, stamps: Float[np.ndarray, " T"]) -> tuple[np.ndarray, np.ndarray]:
        """The newest measurement at each of some times, or the first one.

        Returns:
            (T, n) positions [rad] and (T,) stamps [s]; NaN without any measurement.
        """
        if not len(self):
            empty = np.full(len(stamps), np.nan)
            return np.full((len(stamps), len(self.names)), np.nan), empty
        rows = np.searchsorted(self.stamps, stamps, side="right") - 1
        rows = np.maximum(rows, 0)
        return self.positions[rows], self.stamps[rows]
