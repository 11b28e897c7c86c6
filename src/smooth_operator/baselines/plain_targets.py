"""Targets that equal the human's keyvectors, without a state."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from smooth_operator.retargeting.sbr.published import base_weights
from smooth_operator.retargeting.targets import KeyvectorLayout, LayoutT, TargetPolicy, Targets
from smooth_operator.settings import check_numbers


class StatelessTargets(TargetPolicy[LayoutT, tuple[()]]):
    """Base class of policies without a state."""

    def init(self, layout: LayoutT) -> tuple[()]:
        """The empty state."""
        del layout
        return ()


@dataclass(frozen=True)
class PlainTargets(StatelessTargets[KeyvectorLayout]):
    """Targets that equal the human's keyvectors.

    Attributes:
        beta: scale of the human's vectors.
        w_wrist, w_thumb, w_between: weights of the wrist-to-tip, thumb-to-tip and finger-to-finger
            keyvectors.
    """

    beta: float = 1.0
    w_wrist: float = 1.0
    w_thumb: float = 1.0
    w_between: float = 1.0

    def __post_init__(self) -> None:
        check_numbers(self, "targets.", positive=("beta",))

    def layout(self, fingers: tuple[str, ...]) -> KeyvectorLayout:
        """The paper's keyvectors."""
        return KeyvectorLayout(fingers)

    def __call__(
        self, state: tuple[()], layout: KeyvectorLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, tuple[()]]:
        """Targets of one frame."""
        weights = jnp.asarray(base_weights(layout, self.w_wrist, self.w_thumb, self.w_between))
        return Targets(human * self.beta, weights.astype(human.dtype)), state
