"""Poses of a hand by where its fingertips are: a start for a descent that has no good one.

The fingertips that a pose is to have say which pose of each finger comes nearest to them. That
depends on nothing that came before, and among many random poses one is in the right basin.
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
    """Random poses of a hand, the same in each run.

    Attributes:
        hand: the robot hand.
    """

    hand: Hand

    @cached_property
    def moves(self) -> Bool[np.ndarray, "F m"]:
        """(F, m) mask of the actuated joints that move each fingertip."""
        tips = PointKinematics(self.hand.tree, self.hand.tip_names)
        coupling = np.abs(self.hand.coupling_matrix[np.array(tips.order)])
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
        """(m,) the pose whose fingers are each the one of the table with the fingertip nearest to
        its place [m], and (F,) how far away that is [m]; traceable. A joint of two fingers is as
        the first of them has it, one of none neutral."""
        poses, tips = (jnp.asarray(part, places.dtype) for part in self._table)
        off = tips - places[:, None]
        squared = (off * off).sum(-1)
        fingers = poses[jnp.argmin(squared, axis=1)]
        rows = jnp.concatenate([fingers, jnp.asarray(self.hand.neutral, places.dtype)[None]])
        owners = np.where(self.moves.any(axis=0), self.moves.argmax(axis=0), len(self.moves))
        return rows[owners, np.arange(len(owners))], jnp.sqrt(squared.min(axis=1))
