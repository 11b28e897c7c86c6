"""Targets of a gripper's jaws. The jaws are fully open when the human's thumb and index fingertips
are as far apart as the index finger is long, and closed when they touch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.geometry import lengths
from smooth_operator.hands.hand import Hand

_POSES: Final = 4096  # poses among which the closed and the open one are
_STEPS: Final = 65  # poses between them
_TINY: Final = 1e-9


@dataclass(frozen=True, eq=False)
class Jaws:
    """The two jaws of a gripper."""

    hand: Hand

    @cached_property
    def _path(self) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, "K 2 3"]]:
        """Openings from closed to open, and the places of the tips [m]."""
        low, high = self.hand.limits.T
        count = max(2, int(_POSES ** (1 / len(low))))
        axes = np.linspace(low, high, count).T
        poses = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, len(low))

        def tips_at(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            tips = self.hand.tips(self.hand.full_configuration(q))
            return np.linalg.norm(tips[:, 1] - tips[:, 0], axis=-1), tips

        openings, _ = tips_at(poses)
        closed, opened = poses[int(np.argmin(openings))], poses[int(np.argmax(openings))]
        openings, tips = tips_at(closed + np.linspace(0, 1, _STEPS)[:, None] * (opened - closed))
        return np.maximum.accumulate(openings).astype(np.float32), tips.astype(np.float32)

    def places(
        self, length: Float[Array, ""], tips: Float[Array, "2 3"], press: float
    ) -> tuple[Float[Array, "2 3"], Float[Array, " 2"]]:
        """Computes the targets of the jaw tips, and the gains of the opening; traceable.

        With the human's distance d of thumb and index finger ``tips`` and the ``length`` l of the
        index finger [m], the opening is w_min + (w_max - w_min) (d - press) / (l - press), within
        w_min and w_max.
        """
        openings, path = (jnp.asarray(part, tips.dtype) for part in self._path)
        apart = lengths(tips[1] - tips[0], _TINY)
        room = jnp.maximum(length - press, press)
        share = jnp.clip((apart - press) / room, 0.0, 1.0)
        opening = openings[0] + share * (openings[-1] - openings[0])
        after = jnp.clip(jnp.searchsorted(openings, opening), 1, len(openings) - 1)
        step = jnp.maximum(openings[after] - openings[after - 1], _TINY)
        part = jnp.clip((opening - openings[after - 1]) / step, 0.0, 1.0)
        places = path[after - 1] + part * (path[after] - path[after - 1])
        return places, jnp.full(2, (openings[-1] - openings[0]) / room)
