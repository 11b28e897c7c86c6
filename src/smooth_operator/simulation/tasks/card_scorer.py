"""Task A, card pickup, in numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Final, Self

import numpy as np

from smooth_operator.simulation.scenes.card import CARD, CardScene
from smooth_operator.simulation.scenes.state import SceneState
from smooth_operator.simulation.tasks.scorer import (
    NOT_DONE,
    PRESSES_N,
    Standing,
    held_since,
    lasted,
    outside,
    rotation,
)

OVER: Final = 0.005
"""So far beyond the table's edge, and still lying on it, the card is over the edge [m]."""

_SIDEWAYS: Final = 0.07  # a card this far sideways from its start is out of reach [m]
_FACE: Final = 0.0003  # a touch this far from the card's middle plane is on a face [m]
_CORNERS: Final = np.array(list(product((-0.5, 0.5), repeat=3))) * CARD


@dataclass(frozen=True, eq=False)
class CardScorer:
    """What has happened to the card.

    Attributes:
        scene: where.
        over: it has lain over the edge.
        protrusion: how far it is beyond the edge [m]; negative on the table.
        pinched: since when it has been pinched and clear of the table [s].
        beyond: it lies on the table where no finger reaches it.
        gone: it has left the workspace.
        done: it has been pinched and clear for long enough.
    """

    scene: CardScene
    over: bool = False
    protrusion: float = float("-inf")
    pinched: float | None = None
    beyond: bool = False
    gone: bool = False
    done: bool = False

    @property
    def standing(self) -> Standing:
        """See ``Scorer``."""
        if self.gone:
            return Standing(0.0, "dropped", "the card fell", dropped=True)
        if self.done and self.over:
            return Standing(1.0, "done", "slid over the edge and pinched", complete=True)
        if self.done:
            return Standing(
                0.5, "no-edge", "pinched without having gone over the edge", complete=True
            )
        if self.beyond:
            return Standing(0.0, NOT_DONE, "the card is out of reach", stuck=True)
        if self.pinched is not None:
            return Standing(0.0, NOT_DONE, "pinched")
        return Standing(0.0, NOT_DONE, "over the edge" if self.over else "on the table")

    def observe(self, state: SceneState) -> Self:
        """See ``Scorer``."""
        corners = state.position + _CORNERS @ rotation(state.quaternion).T
        near = float(corners[:, 0].min())
        lies = state.support > 0.0
        pinched = held_since(self.pinched, not lies and pinches(state), state.time)
        start = self.scene.start[0]
        return replace(
            self,
            over=self.over or (lies and near < self.scene.edge - OVER),
            protrusion=self.scene.edge - near,
            pinched=pinched,
            beyond=lies and (near > self.scene.reach
                             or abs(float(state.position[1] - start[1])) > _SIDEWAYS),
            gone=self.gone or outside(self.scene, state),
            done=self.done or lasted(pinched, state.time),
        )  # fmt: skip


def pinches(state: SceneState) -> bool:
    """Whether the thumb presses on one face of the card and a finger on the other."""
    side = np.where(np.abs(state.touch[:, 2]) > _FACE, np.sign(state.touch[:, 2]), 0.0)
    side = np.where(state.force > PRESSES_N, side, 0.0)
    return bool(side[0] != 0 and np.any(side[1:] == -side[0]))
