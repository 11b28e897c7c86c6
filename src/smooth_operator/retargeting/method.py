"""Base classes of retargeting methods and of their settings.

To write your own method, define two classes: a frozen dataclass of settings, derived from
``MethodConfig``, whose ``build`` returns the method for one hand; and the method, derived from
``Method``, whose ``step`` maps the aligned landmarks of one frame to joint positions.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeVar, cast

import numpy as np
from jaxtyping import Array, Bool, Float, UInt32

from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.objective import Objective, TermsConfig

C = TypeVar("C", bound="MethodConfig")

Compiling = Callable[[Callable[..., Any], str], Callable[..., Any]]
"""Compiles a traceable function under a name that is unique among the method's functions."""


class MethodOutput(NamedTuple):
    """Result of one step of a method.

    Attributes:
        q: (m,) positions of the actuated joints, within their limits [rad].
        tracking_loss: the method's own weighted tracking loss, without regularisation: for
            keyvector methods the first term of Eq. (1).
    """

    q: Float[Array, " m"] | Float[np.ndarray, " m"]
    tracking_loss: Float[Array, ""] | np.floating


class Method(ABC):
    """A retargeting method for one hand: a compiled step function with explicit state.

    Immutable: everything that changes from frame to frame is in the state. Subclasses have an
    attribute ``hand``, the robot hand.
    """

    hand: Hand

    on_host: ClassVar[bool] = False
    """True if the solver is a library on the host, outside the compiled program. The method then
    also has a function ``program(alignment, compiling)``; see ``SlsqpMethod``."""

    uneven: ClassVar[bool] = False
    """True if the solver takes much longer for some frames than for others. On a CPU, each
    recording of a batch then runs in its own thread."""

    @property
    @abstractmethod
    def needs(self) -> tuple[int, ...]:
        """Indices of the human landmarks without which no command can be computed."""

    @abstractmethod
    def init(self, seed: int) -> Any:
        """Returns the state before the first frame, a pytree of arrays without None leaves.
        ``seed`` seeds the random numbers."""

    @abstractmethod
    def step(
        self, state: Any, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[Any, MethodOutput]:
        """Computes one frame; traceable, without side effects.

        Args:
            state: from ``init`` or the last step.
            aligned: (21, 3) landmarks in the palm frame [m]; those in ``needs`` are finite.
            ticks: the frame's timestamp in microseconds modulo 2^32; see ``tick_after`` in
                ``smooth_operator.retargeting.program``. It may stay the same from frame to frame.

        Returns:
            the next state and the output.
        """

    @property
    def constants(self) -> Any:
        """Pytree of additional arrays that the program uses, such as weights from a file; None if
        there are none, or if they are unknown."""
        return None

    def latched(self, state: Any) -> Bool[Array, " P"] | None:
        """(F - 1,) True for fingers latched to the thumb; None for a method without latches."""
        del state
        return None

    def pinch_gaps(self, state: Any) -> Float[Array, " P"] | None:
        """(F - 1,) estimated gaps between a touching thumb and finger [palm lengths], 0 while
        unknown; None for a method that does not close gaps."""
        del state
        return None

    def with_pinch_gaps(self, state: Any, known: Mapping[str, float] | None) -> Any:
        """Returns a state with known pinch gaps by finger [palm lengths]; None disables closing."""
        del known
        return state

    def continued(self, fresh: Any, before: Any) -> Any:
        """Returns a fresh state that keeps what an earlier state has learnt about the operator."""
        del before
        return fresh

    def fingertip_targets(self, state: Any) -> Float[Array, "F 3"] | None:
        """(F, 3) fingertip targets of the last frame, palm frame [m]; None without targets."""
        del state
        return None

    @property
    def trajectory_objective(self) -> Objective | None:
        """Cost of each frame for trajectory optimisation; None without a differentiable one."""
        return None


class MethodConfig(ABC):
    """Base class of a method's settings: frozen dataclasses with a field ``alignment``."""

    alignment: AlignmentConfig
    """Alignment of landmarks to the palm frame."""

    shareable: ClassVar[bool] = True
    """True if retargeters with equal settings, and those of a mirrored hand, may share one compiled
    program. False if the settings do not determine the program, such as the path of a file."""

    color: ClassVar[str | None] = None
    """Colour of a plugin's method in reports, ``#rrggbb``; None derives a colour from its name."""

    @property
    def one_thread(self) -> bool:
        """True if compiled programs run faster on one thread than on one thread per core."""
        return True

    @abstractmethod
    def build(self, hand: Hand) -> Method:
        """Builds the method for one hand; SmoothOperatorError if it can't be used with the hand."""

    def with_alignment(self: C, **changes: Any) -> C:
        """Returns these settings with some fields of ``AlignmentConfig`` replaced; ConfigError if a
        value is out of range."""
        changed: Any = self  # a dataclass, which the base class can't express
        alignment = dataclasses.replace(self.alignment, **changes)
        return cast(C, dataclasses.replace(changed, alignment=alignment))

    def with_file(self: C, path: Path) -> C | None:
        """Returns these settings with another file, such as a model; None if they use no file."""
        del path
        return None

    def notes(self, hand: Hand) -> tuple[str, ...]:
        """Human-readable notes on what a hand lacks for the method; empty for most hands."""
        del hand
        return ()


class ObjectiveMethodConfig(MethodConfig):
    """Settings of a method that minimises an ``Objective``; they have a field ``objective``."""

    objective: TermsConfig
    """Targets and weights of Eq. (1)."""
