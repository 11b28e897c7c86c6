"""Table of random poses of a hand, from which an optimisation starts if it has no good start.

For each finger, the table gives the pose whose fingertip is nearest to a target. The result does
not depend on earlier frames, and one of many random poses is in the right basin.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.hands.differential import PointKinematics
from smooth_operator.hands.hand import Hand

_POSES: Final = 1024


@dataclass(frozen=True, eq=False)
class PoseTable:
    """Random poses of a hand, which are the same in every run.

    Attributes:
        hand: the robot hand.
    """

    hand: Hand

    @cached_property
    def moves(self) -> Bool[np.ndarray, "F m"]:
        """(F, m) mask of the actuated joints that move each fingertip."""
        tips = PointKinematics(self.hand.tree, self.hand.tip_names)
        coupling = np.abs(self.hand.transmission.matrix[np.array(tips.order)])
        moves: np.ndarray = tips.moves.astype(float) @ coupling > 0
        return moves

    @cached_property
    def _table(self) -> tuple[Float[np.ndarray, "N m"], Float[np.ndarray, "F N 3"]]:
        """Poses [rad] and their fingertips [m]."""
        low, high = self.hand.limits.T
        poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
        tips = self.hand.tips(self.hand.full_configuration(poses))
        return poses.astype(np.float32), np.moveaxis(tips, 1, 0).astype(np.float32)

    def nearest(self, places: Float[Array, "F 3"]) -> tuple[Float[Array, " m"], Float[Array, " F"]]:
        """(m,) joint positions [rad] with tips near (F, 3) targets [m], and (F,) distances [m].

        Traceable. Each finger comes from the pose of the table whose fingertip is nearest to its
        target. A joint of two fingers comes from the first; a joint of no finger stays neutral.
        """
        poses, tips = (jnp.asarray(part, places.dtype) for part in self._table)
        off = tips - places[:, None]
        squared = (off * off).sum(-1)
        fingers = poses[jnp.argmin(squared, axis=1)]
        rows = jnp.concatenate([fingers, jnp.asarray(self.hand.neutral, places.dtype)[None]])
        owners = np.where(self.moves.any(axis=0), self.moves.argmax(axis=0), len(self.moves))
        return rows[owners, np.arange(len(owners))], jnp.sqrt(squared.min(axis=1))
