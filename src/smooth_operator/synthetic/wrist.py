"""Motion of the whole hand in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.poses import from_rotation_vectors
from smooth_operator.synthetic.settings import check_range, check_seed

_TERMS = 4


@dataclass(frozen=True)
class WristMotion:
    """Slow random motion of the wrist; off by default, as a glove reports the hand alone.

    Attributes:
        translation: standard deviation of each coordinate of the wrist [m].
        rotation: standard deviation of each coordinate of the rotation vector [rad].
        seed: of the motion.

    Raises:
        ConfigError: if a figure is outside its range.
    """

    translation: float = 0.0
    rotation: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_range("wrist translation", self.translation, 0.0, 1.0, "m")
        check_range("wrist rotation", self.rotation, 0.0, 1.5, "rad")
        check_seed("wrist seed", self.seed)

    def __bool__(self) -> bool:
        return bool(self.translation or self.rotation)

    def at(
        self, times: Float[np.ndarray, " T"]
    ) -> tuple[Float[np.ndarray, "T 3"], Float[np.ndarray, "T 3"]]:
        """Translation [m] and rotation vector [rad] of the wrist at each time [s]."""
        rng = np.random.default_rng([int(self.seed), 0x3A])
        frequency = rng.uniform(0.05, 0.4, (6, _TERMS))
        phase = rng.uniform(0.0, 2.0 * np.pi, (6, _TERMS))
        # Each sine has a mean square of 1/2.
        sines = np.sin(2.0 * np.pi * frequency * times[:, None, None] + phase).sum(-1)
        sines *= np.sqrt(2.0 / _TERMS)
        return self.translation * sines[:, :3], self.rotation * sines[:, 3:]

    def pose_at(self, time: float) -> Float[np.ndarray, "7"]:
        """The same at one time [s], as a pose: x y z [m], quaternion w x y z."""
        place, turn = self.at(np.array([time]))
        return np.concatenate([place[0], from_rotation_vectors(turn[0])])
