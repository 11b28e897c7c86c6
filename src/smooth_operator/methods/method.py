"""What a retargeting method is: a pure step from aligned landmarks to joint positions."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Array, Bool, Float, UInt32

from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import AlignmentConfig


class MethodOutput(NamedTuple):
    """What a method computes in one step.

    Attributes:
        q: (m,) positions of the actuated joints, within their limits [rad].
        tracking_loss: the method's own weighted tracking loss at q, without regularisation: for
            keyvector methods the first term of Eq. (1).
    """

    q: Float[Array, " m"] | Float[np.ndarray, " m"]
    tracking_loss: Float[Array, ""] | np.floating


class MethodConfig(Protocol):
    """Configuration of a method; knows how to build it for a hand."""

    @property
    def alignment(self) -> AlignmentConfig:
        """How landmarks reach the palm frame."""

    def build(self, hand: Hand) -> Method | HostMethod:
        """The method for one hand.

        Raises:
            SmoothOperatorError: if the hand can't be served, with the reason.
        """


class Stateful(Protocol):
    """What all methods share. Frozen: all that changes is in the state."""

    @property
    def hand(self) -> Hand:
        """The robot hand."""

    @property
    def needs(self) -> tuple[int, ...]:
        """Human landmarks without which no command can be computed."""

    def init(self, seed: int) -> Any:
        """The state before the first frame: a pytree of arrays, not None at its leaves."""

    def latched(self, state: Any) -> Bool[Array, " P"] | None:
        """(F - 1,) which fingers are latched to the thumb; None for a method without latches."""


class Method(Stateful, Protocol):
    """A method that is one compiled program."""

    def step(self, state: Any, aligned: Float[Array, "21 3"]) -> tuple[Any, MethodOutput]:
        """One frame; traceable, without side effects.

        Args:
            state: from ``init`` or the last step.
            aligned: (21, 3) landmarks in the palm frame [m]; those in ``needs`` are finite.
        """


class TimedMethod(Stateful, Protocol):
    """A method that is one compiled program, and goes by the frames' stamps."""

    @property
    def timed(self) -> bool:
        """True."""

    def step(
        self, state: Any, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[Any, MethodOutput]:
        """One frame, as of ``Method``.

        Args:
            state: from ``init`` or the last step.
            aligned: (21, 3) landmarks in the palm frame [m]; those in ``needs`` are finite.
            ticks: the frame's stamp in microseconds modulo 2^32. It may stand still where frames
                have no stamps.
        """


@runtime_checkable
class HostMethod(Stateful, Protocol):
    """A method whose solver is a library on the host: compiled up to it, plain Python after it."""

    def prepare(self, state: Any, aligned: Float[Array, "21 3"]) -> Any:
        """The problem of one frame, as a pytree; traceable, without side effects.

        Args:
            state: from ``init`` or the last step.
            aligned: (21, 3) landmarks in the palm frame [m]; those in ``needs`` are finite.
        """

    def solve(self, state: Any, problem: Any) -> tuple[Any, MethodOutput]:
        """Solve it; NumPy in and out, without side effects.

        Args:
            state: that the problem was prepared from.
            problem: of ``prepare``.
        """
