"""What a retargeting method is: a pure step from aligned landmarks to joint positions."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from jaxtyping import Array, Float

from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import AlignmentConfig


class MethodOutput(NamedTuple):
    """What a method computes in one step.

    Attributes:
        q: (m,) positions of the actuated joints, within their limits [rad].
        tracking_loss: weighted keyvector loss at q, the first term of Eq. (1).
    """

    q: Float[Array, " m"]
    tracking_loss: Float[Array, ""]


class MethodConfig(Protocol):
    """Configuration of a method; knows how to build it for a hand."""

    @property
    def alignment(self) -> AlignmentConfig:
        """How landmarks reach the palm frame."""

    def build(self, hand: Hand) -> Method:
        """The method for one hand."""


class Method(Protocol):
    """A method for one hand. Frozen: all that changes is in the state."""

    @property
    def hand(self) -> Hand:
        """The robot hand."""

    @property
    def needs(self) -> tuple[int, ...]:
        """Human landmarks without which no command can be computed."""

    def init(self, seed: int) -> Any:
        """The state before the first frame: a pytree of arrays, not None at its leaves."""

    def step(self, state: Any, aligned: Float[Array, "21 3"]) -> tuple[Any, MethodOutput]:
        """One frame; traceable, without side effects.

        Args:
            state: from :meth:`init` or the last step.
            aligned: (21, 3) landmarks in the palm frame [m]; those in :attr:`needs` are finite.
        """
