"""The robot's keyvectors as a linear function of the points that joints move."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.objective.keyvectors import KeyvectorLayout, VectorLayout


@dataclass(frozen=True, eq=False)
class RobotVectors:
    """The vectors of a layout on one hand: incidence @ moving points + a constant.

    Attributes:
        hand: the robot hand.
        layout: landmarks that each vector joins; the hand has counterparts of them all.
    """

    hand: Hand
    layout: VectorLayout

    def keyvectors(self, cost: str) -> KeyvectorLayout:
        """The layout, for a cost of the paper's keyvectors.

        Args:
            cost: its name in the error.

        Raises:
            ConfigError: if the vectors are not the paper's keyvectors.
        """
        if not isinstance(self.layout, KeyvectorLayout):
            raise ConfigError(
                f"the cost of {cost} needs the paper's keyvectors, not {type(self.layout).__name__}"
            )
        return self.layout

    @cached_property
    def moving(self) -> tuple[int, ...]:
        """The P landmarks whose counterparts a joint moves; those of the others are fixed."""
        keypoints = self.hand.tree.keypoints
        return tuple(i for i in self.layout.landmarks if keypoints[LANDMARKS[i]].joint >= 0)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the moving points."""
        return tuple(LANDMARKS[i] for i in self.moving)

    @cached_property
    def incidence(self) -> Float[np.ndarray, "K P"]:
        """1 where a vector ends at a moving point, -1 where it begins at one."""
        matrix = np.zeros((len(self.layout.vectors), len(self.moving)))
        for k, (start, end) in enumerate(self.layout.vectors):
            for landmark, sign in ((end, 1.0), (start, -1.0)):
                if landmark in self.moving:
                    matrix[k, self.moving.index(landmark)] = sign
        return matrix

    def _row(self, landmark: int | None) -> int:
        """Row of a landmark among the moving points; -1 for a fixed one."""
        return self.moving.index(landmark) if landmark in self.moving else -1

    def at(self, points: Float[Array, "P 3"]) -> Float[Array, "K 3"]:
        """The vectors [m], from the moving points [m]."""
        keypoints = self.hand.tree.keypoints
        moving = {i: points[p] for p, i in enumerate(self.moving)}
        every = [
            moving[i]
            if i in moving
            else jnp.asarray(keypoints[LANDMARKS[i]].position, points.dtype)
            for i in self.layout.landmarks
        ]
        return self.layout.among(every)

    def jacobian(self, jacobian: Float[Array, "P J 3"]) -> Float[Array, "K 3 J"]:
        """Derivatives of the vectors, from those of the moving points [m/rad]."""
        every = jnp.concatenate([jacobian, jnp.zeros_like(jacobian[:1])])  # the last: fixed points
        (start, end) = (
            [self._row(i) for i in side] for side in zip(*self.layout.vectors, strict=True)
        )
        return jnp.swapaxes(every[np.array(end)] - every[np.array(start)], 1, 2)

    def spread(self, slopes: Float[Array, "V 3"], which: slice = slice(None)) -> Array:
        """(P, 3) a cost's derivatives with respect to the points, from those by some vectors."""
        # a sum, for XLA's library takes 4 us to begin with so small a product
        incidence = jnp.asarray(self.incidence[which], slopes.dtype)
        return (incidence[:, :, None] * slopes[:, None, :]).sum(axis=0)
