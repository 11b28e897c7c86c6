"""Targets of the preset ``position``: the human's fingertip positions in the palm frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.objective.keyvectors import VectorLayout, tips_of
from smooth_operator.objective.targets import StatelessTargets, Targets


@dataclass(frozen=True)
class TipLayout(VectorLayout):
    """From the origin of the palm frame to each fingertip: positions rather than directions.

    Attributes:
        fingers: human finger names, thumb first.
    """

    fingers: tuple[str, ...]

    @cached_property
    def vectors(self) -> tuple[tuple[int | None, int], ...]:
        """(F,) (origin, tip)."""
        return tuple((None, tip) for tip in tips_of(self.fingers))


@dataclass(frozen=True)
class TipTargets(StatelessTargets[TipLayout]):
    """Every fingertip goes where the human's is in the palm frame: positions, not directions.

    Attributes:
        beta: scale of the human position.
    """

    beta: float = 1.0

    def layout(self, fingers: tuple[str, ...]) -> TipLayout:
        """From the palm's origin to each tip."""
        return TipLayout(fingers)

    def __call__(
        self, state: tuple[()], layout: TipLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, tuple[()]]:
        """Targets of one frame."""
        return Targets(human * self.beta, jnp.ones(len(human), human.dtype)), state
