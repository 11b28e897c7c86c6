"""Noise of a person's fingertips: tremor, and errors that grow with the movement."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

TREMOR_HZ: Final = (8.0, 12.0)
"""Band of physiological tremor of the finger (Elble and Koller 1990)."""

_CORRELATED_S: Final = 0.1
"""Correlation time of the noise of a movement [s]; ours: about one submovement."""

_FORGOTTEN_S: Final = 1.0
"""Time constant with which proprioception takes such an error back [s]; ours."""

_TONES: Final = 4  # of the tremor, for each finger and axis


class MotorNoise:
    """Displacement of fingertips about where the person wants them.

    Args:
        share: standard deviation at the end of a movement over its length.
        tremor: root mean square of the tremor along an axis [m].
        fingers: how many.
        rng: source of random numbers.
    """

    def __init__(self, share: float, tremor: float, fingers: int, rng: np.random.Generator) -> None:
        self._share, self._rng = share, rng
        self._drift = np.zeros((fingers, 3))
        self._colour = rng.normal(size=(fingers, 3))
        shape = (_TONES, fingers, 3)
        self._hertz = rng.uniform(*TREMOR_HZ, shape)
        self._phase = rng.uniform(0.0, 2 * np.pi, shape)
        self._tremor = tremor * np.sqrt(2.0 / _TONES)

    def update(
        self, time: float, moved: Float[np.ndarray, "f 3"], seconds: float
    ) -> Float[np.ndarray, "f 3"]:
        """The displacement now.

        Args:
            time: now [s].
            moved: (f, 3) how far each fingertip was to move since the last call [m].
            seconds: since the last call [s].
        """
        keep = np.exp(-seconds / _CORRELATED_S)
        self._colour = keep * self._colour + np.sqrt(1 - keep**2) * self._rng.normal(
            size=self._colour.shape
        )
        length = np.linalg.norm(moved, axis=-1, keepdims=True)
        self._drift *= np.exp(-seconds / _FORGOTTEN_S)
        self._drift += self._share * length * self._colour
        tones = np.sin(2 * np.pi * self._hertz * time + self._phase)
        return np.asarray(self._drift + self._tremor * tones.sum(axis=0))
