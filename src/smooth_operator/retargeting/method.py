"""Base classes of retargeting methods and of their settings.

A method of your own is two classes: a frozen dataclass of settings, derived from ``MethodConfig``,
whose ``build`` gives the method for one hand; and the method, derived from ``Method``, whose
``step`` maps the aligned landmarks of one frame to joint positions. Everything else has a default.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, TypeVar, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt32

from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.objective import Objective, TermsConfig
from smooth_operator.settings import RATE_RANGE_HZ

C = TypeVar("C", bound="MethodConfig")

Compiling = Callable[[Callable[..., Any], str], Callable[..., Any]]
"""Compiles a traceable function under a name that is its own among the method's functions."""

_FAINT = 1e-4
"""A pull to the neutral pose this weak decides between equally good poses, and no more."""


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
    """A retargeting method for one hand: a compiled step with explicit state.

    Immutable: the state holds all that changes from frame to frame. Subclasses have an attribute
    ``hand``, the robot hand.
    """

    hand: Hand

    on_host: ClassVar[bool] = False
    """True for a ``HostMethod``, whose solver runs on the host; else it is one compiled program."""

    uneven: ClassVar[bool] = False
    """True if some frames take its solver much longer than others. On a CPU recordings then run in
    threads of their own, for frames side by side would wait for the longest."""

    @property
    @abstractmethod
    def needs(self) -> tuple[int, ...]:
        """Indices of the human landmarks without which no command can be computed."""

    @property
    def optional_landmarks(self) -> tuple[int, ...]:
        """Indices of the human landmarks that are used where they are known."""
        return ()

    @abstractmethod
    def init(self, seed: int) -> Any:
        """The state before the first frame: a pytree of arrays, not None at its leaves.

        Args:
            seed: seed of the random numbers; ignored by methods without any.
        """

    @abstractmethod
    def step(
        self, state: Any, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[Any, MethodOutput]:
        """One frame; traceable, without side effects.

        Args:
            state: from ``init`` or the last step.
            aligned: (21, 3) landmarks in the palm frame [m]; those in ``needs`` are finite.
            ticks: the frame's stamp in microseconds modulo 2^32; see ``ticks_of`` in
                ``smooth_operator.retargeting.program``. It may stay the same from frame to frame.

        Returns:
            the next state and the output.
        """

    @property
    def constants(self) -> Any:
        """A pytree of arrays that the program holds besides figures of the hand and settings, such
        as weights from a file; None where there are none, or they are not known."""
        return None

    def latched(self, state: Any) -> Bool[Array, " P"] | None:
        """(F - 1,) which fingers are latched to the thumb; None for a method without latches."""
        del state
        return None

    def pinch_gaps(self, state: Any) -> Float[Array, " P"] | None:
        """(F - 1,) estimated gaps that the tracker leaves between thumb and finger where they touch
        [palm lengths], 0 while one is not known; None for a method that does not close them."""
        del state
        return None

    def with_pinch_gaps(self, state: Any, known: Mapping[str, float] | None) -> Any:
        """The state of a method that closes pinch gaps with those that are known before the first
        frame, finger -> gap [palm lengths]; None: it is to close none."""
        del known
        return state

    def continued(self, fresh: Any, before: Any) -> Any:
        """A state without a past, with what an earlier one has learnt about the operator."""
        del before
        return fresh

    def fingertip_targets(self, state: Any) -> Float[Array, "F 3"] | None:
        """(F, 3) places of the fingertips that the last frame asks for, in the palm frame [m];
        None for a method that does not place them, and before the first frame."""
        del state
        return None

    @property
    def trajectory_objective(self) -> Objective | None:
        """The cost of each frame in trajectory optimisation over a whole recording; None for a
        method without an objective whose derivatives are known."""
        return None


class MethodConfig(ABC):
    """Settings of a method. Subclasses are frozen dataclasses with a field ``alignment``."""

    alignment: AlignmentConfig
    """Alignment of landmarks to the palm frame."""

    shareable: ClassVar[bool] = True
    """True if retargeters with equal settings, and those of a mirrored hand, may share one compiled
    program. False where the settings do not determine the program, such as the path of a file."""

    color: ClassVar[str | None] = None
    """Colour of a plugin's method in reports, ``#rrggbb``; None for one that follows from its name.
    Those of the built-in methods are in ``smooth_operator.retargeting.registry``."""

    @property
    def one_thread(self) -> bool:
        """True if one thread is faster than one per core; if not, loops get the widest vectors."""
        return True

    @abstractmethod
    def build(self, hand: Hand) -> Method:
        """The method for one hand.

        Raises:
            SmoothOperatorError: if the hand can't be served, with the reason.
        """

    def with_alignment(self: C, **changes: Any) -> C:
        """These settings with other fields of ``AlignmentConfig``.

        Raises:
            ConfigError: a value is out of range.
        """
        return _replaced(self, alignment=dataclasses.replace(self.alignment, **changes))

    def with_file(self: C, path: Path) -> C | None:
        """These settings with a file that a user names in place of a preset, such as a trained
        model; None if the method takes no file."""
        del path
        return None

    def without_pull(self: C) -> C:
        """These settings with next to no pull to the neutral pose, to judge a hand or a solver.

        A trace of it stays, to decide between joint positions that serve the landmarks equally.
        """
        return self

    def notes(self, hand: Hand) -> tuple[str, ...]:
        """Sentences about what the method lacks on a hand, for a person; none for most hands."""
        del hand
        return ()


class ObjectiveMethodConfig(MethodConfig):
    """Settings of a method that minimises Eq. (1): those with a field ``objective``."""

    objective: TermsConfig
    """Targets and weights of Eq. (1)."""

    def without_pull(self: C) -> C:
        """These settings with a pose weight of at most 1e-4."""
        objective = cast(ObjectiveMethodConfig, self).objective
        weight = min(objective.pose_weight, _FAINT)
        return _replaced(self, objective=dataclasses.replace(objective, pose_weight=weight))


def _replaced(config: C, **changes: Any) -> C:
    # settings are dataclasses, which their base class can't say
    return cast(C, dataclasses.replace(cast(Any, config), **changes))


_SHORTEST: Final = 0.5 / RATE_RANGE_HZ[1]
"""Shortest time between frames [s], half a period of the fastest tracker: frames that arrive in a
bunch count as this far apart."""


USUAL_RATE: Final = 100.0
"""Rate that is assumed where stamps stand still [Hz]."""

LONGEST_GAP: Final = 0.25
"""Longest time between frames that counts as motion [s]; after a longer one the last answer no
longer counts."""


class FrameClock(NamedTuple):
    """Time since the last frame.

    Attributes:
        dt: that time [s].
        restart: True if no frame came before, or too long ago to count as motion.
    """

    dt: Float[Array, ""]
    restart: Bool[Array, ""]

    @classmethod
    def of(
        cls,
        passed: UInt32[Array, ""],
        frames: UInt32[Array, ""],
    ) -> FrameClock:
        """Time of a frame; traceable.

        Args:
            passed: ticks since the last one, in microseconds modulo 2^32.
            frames: number of frames before it.
        """
        elapsed = passed.astype(jnp.int32) * 1e-6
        # a stamp that goes back belongs to another recording
        restart = (frames == 0) | (elapsed > LONGEST_GAP) | (elapsed < 0)
        stamped = (passed > 0) & ~restart
        dt = jnp.where(stamped, jnp.maximum(elapsed, _SHORTEST), 1 / USUAL_RATE).astype(jnp.float32)
        return cls(dt, restart)
