"""What a person sees, and the correction that follows from it: a delay, then a crossover model.

McRuer's crossover model: near the frequency at which the open loop's gain is 1, a person's
correction and the machine together behave as omega_c exp(-tau s) / s, whatever the machine is
(McRuer and Jex 1967). The machine here follows the fingers without much dynamics of its own, so the
person integrates the error that is seen.
"""

from __future__ import annotations

from collections import deque
from typing import Final, Generic, TypeVar

import numpy as np
from jaxtyping import Float

T = TypeVar("T")

SPEED_LIMIT: Final = 0.10
"""Fastest correction of a fingertip [m/s]: corrective submovements of some 10 to 20 mm last 150 to
200 ms (Meyer et al. 1988)."""

REACH_LIMIT: Final = 0.015
"""Largest correction [m]; ours: a fingertip that does not follow further can't go there."""


class DelayedView(Generic[T]):
    """A line of images: what comes out is as old as the delay.

    Args:
        delay_s: of what is seen [s].
    """

    def __init__(self, delay_s: float) -> None:
        self._delay = delay_s
        self._waiting: deque[tuple[float, T]] = deque()
        self._latest: T | None = None

    def show(self, time: float, image: T) -> None:
        """An image of a moment, later than the last one."""
        self._waiting.append((time, image))

    def latest(self, time: float) -> T | None:
        """The newest image that is at least as old as the delay; None before the first."""
        while self._waiting and self._waiting[0][0] <= time - self._delay + 1e-9:
            self._latest = self._waiting.popleft()[1]
        return self._latest


class CrossoverCorrection:
    """A correction that integrates the seen error.

    Args:
        gain: crossover frequency [rad/s].
        threshold: errors shorter than this count as none [m]; longer ones lose this length.
        shape: of the correction, (..., 3).
        speed_limit: of each point [m/s].
        reach_limit: of each point [m].
    """

    def __init__(
        self,
        gain: float,
        threshold: float,
        shape: tuple[int, ...],
        speed_limit: float = SPEED_LIMIT,
        reach_limit: float = REACH_LIMIT,
    ) -> None:
        self._gain, self._threshold = gain, threshold
        self._speed, self._reach = speed_limit, reach_limit
        self.value: Float[np.ndarray, "*n 3"] = np.zeros(shape)

    def update(self, error: Float[np.ndarray, "*n 3"], seconds: float) -> Float[np.ndarray, "*n 3"]:
        """Integrate for a while.

        Args:
            error: (..., 3) wanted minus seen [m], as old as the person's delay.
            seconds: since the last call [s].

        Returns:
            the correction (..., 3) [m].
        """
        size = np.linalg.norm(error, axis=-1, keepdims=True)
        felt = error * np.maximum(size - self._threshold, 0.0) / np.maximum(size, 1e-12)
        velocity = _at_most(self._gain * felt, self._speed)
        self.value = _at_most(self.value + velocity * seconds, self._reach)
        return self.value


def _at_most(vector: Float[np.ndarray, "*n 3"], most: float) -> Float[np.ndarray, "*n 3"]:
    size = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector * np.minimum(1.0, most / np.maximum(size, 1e-12)))
