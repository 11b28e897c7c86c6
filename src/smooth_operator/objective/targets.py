"""Targets of keyvectors: the base class of policies, and the policy of ``smooth``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.objective.keyvectors import KeyvectorLayout, VectorLayout
from smooth_operator.settings import check_numbers

if TYPE_CHECKING:
    from smooth_operator.human.operator import Component, OperatorProfile


class Targets(NamedTuple):
    """Targets of one frame.

    Attributes:
        vectors: (K, 3) where the robot's keyvectors should go [m].
        weights: (K,) weights lambda_k of Eq. (1).
    """

    vectors: Float[Array, "K 3"]
    weights: Float[Array, " K"]


LayoutT = TypeVar("LayoutT", bound=VectorLayout)
StateT = TypeVar("StateT")


class TargetPolicy(ABC, Generic[LayoutT, StateT]):
    """Maps the human's vectors to the targets of the robot's, frame by frame.

    A policy is immutable. What it remembers between frames is in its state: a pytree of arrays,
    made by ``init``, taken and returned by every call. Subclasses are frozen dataclasses.
    """

    @abstractmethod
    def layout(self, fingers: tuple[str, ...]) -> LayoutT:
        """Vectors for which the policy sets targets, on a hand with these fingers."""

    @abstractmethod
    def init(self, layout: LayoutT) -> StateT:
        """The state before the first frame."""

    @abstractmethod
    def __call__(
        self, state: StateT, layout: LayoutT, human: Float[Array, "K 3"]
    ) -> tuple[Targets, StateT]:
        """Targets of one frame for the human's (K, 3) vectors [m], and the state after it;
        traceable."""

    def latched(self, state: StateT) -> Bool[Array, " P"] | None:
        """(F - 1,) which fingers are latched to the thumb; None for a policy without latches."""
        del state
        return None

    def with_operator(
        self, operator: OperatorProfile
    ) -> tuple[TargetPolicy[LayoutT, StateT], OperatorProfile]:
        """The policy for a calibrated operator, and the calibration with those components that
        remain for the alignment to correct."""
        return self, operator

    def unused_components(self, operator: OperatorProfile) -> tuple[Component, ...]:
        """Components of a calibration that are used neither by the policy nor for it."""
        del operator
        return ()


def base_weights(
    layout: KeyvectorLayout, wrist: float, thumb: float, between: float
) -> Float[np.ndarray, " K"]:
    """(K,) weights by kind of keyvector."""
    weights = np.full(len(layout.pairs), between)
    weights[: len(layout.fingers)] = wrist
    weights[layout.thumb] = thumb
    return weights


@dataclass(frozen=True)
class CloseTargets(TargetPolicy[KeyvectorLayout, Any]):
    """Targets of ``smooth``: every keyvector follows the human's; the nearer its ends, the more
    closely, since an error of the same length turns a short vector more.

    Attributes:
        w_wrist, w_thumb: weights of the wrist-to-tip keyvectors, and of the thumb-to-tip keyvectors
            of length ``at``. Vectors between other fingers have no targets.
        focus: power by which the weight of thumb-to-tip vectors falls with their length. 2 prices
            the angle, 0 the distance alike at any length.
        at: length at which that weight is the one given [m].
        floor: length below which weights rise no more [m].
        pinch_gaps: gap that a tracker leaves between thumb and finger in a pinch of a calibrated
            operator: (finger, length at the robot's size [m]). It is taken off the lengths of
            thumb-to-tip targets: in full under 10 mm, not at all over 45 mm. Directions stay the
            human's. Empty without a calibration.
        latches: True if fingers are latched to the thumb; it changes no target.
        project, escape: a finger is latched when the tips come nearer than the one [m], until they
            are farther apart than the other.
    """

    w_wrist: float = 18.0
    w_thumb: float = 8.0
    focus: float = 2.0
    at: float = 0.06
    floor: float = 0.01
    pinch_gaps: tuple[tuple[str, float], ...] = ()
    latches: bool = False
    project: float = 0.012
    escape: float = 0.02

    def __post_init__(self) -> None:
        weights, lengths = ("w_wrist", "w_thumb", "focus"), ("at", "floor", "project", "escape")
        check_numbers(self, "targets.", positive=lengths, not_negative=weights)
        if isinstance(self.project, float) and not self.project <= self.escape:
            raise ConfigError(f"project {self.project} must not exceed escape {self.escape} [m]")
        for finger, gap in self.pinch_gaps:
            if not 0 <= gap < 0.1:
                raise ConfigError(f"pinch_gaps: {finger} must have 0 to 0.1 m, not {gap}")

    def with_operator(self, operator: OperatorProfile) -> tuple[CloseTargets, OperatorProfile]:
        """Targets that close the operator's pinches by their length alone: to move landmarks turns
        directions, which cost cosine similarity."""
        profile = operator.without(*self.unused_components(operator))
        if not operator.has("pinch"):
            return self, profile
        gaps = tuple((name, gap * operator.scale) for name, gap in operator.pinch_gaps.items())
        return replace(self, pinch_gaps=gaps), profile.without("pinch")

    def unused_components(self, operator: OperatorProfile) -> tuple[Component, ...]:
        """``scale``: it helped on no recording, and on video it preserved motion less."""
        return ("scale",) if operator.has("scale") else ()

    def layout(self, fingers: tuple[str, ...]) -> KeyvectorLayout:
        """The paper's keyvectors from the wrist and from the thumb's tip."""
        return KeyvectorLayout(fingers, between_fingers=False)

    def init(self, layout: KeyvectorLayout) -> Bool[Array, " P"] | tuple[()]:
        """Open latches, if there are any."""
        return jax.device_put(np.zeros(len(layout.fingers) - 1, bool)) if self.latches else ()

    def latched(self, state: Any) -> Bool[Array, " P"] | None:
        """(F - 1,) which fingers are latched to the thumb; None without latches."""
        return state if self.latches else None

    def __call__(
        self, state: Any, layout: KeyvectorLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, Any]:
        """Targets of one frame, and the latches after it."""
        wrist, thumb = human[: layout.thumb.start], human[layout.thumb]
        near = jnp.sqrt((thumb * thumb).sum(-1) + 1e-12)
        ratio = (self.at**2 + self.floor**2) / (near**2 + self.floor**2)
        weights = jnp.concatenate(
            [jnp.full(len(wrist), self.w_wrist), self.w_thumb * ratio ** (self.focus / 2)]
        ).astype(human.dtype)
        if self.latches:
            state = jnp.where(state, near <= self.escape, near < self.project)
        if self.pinch_gaps:  # of an operator
            from smooth_operator.human.operator import pinch_nearness

            gaps = dict(self.pinch_gaps)
            left = jnp.asarray([gaps.get(name, 0.0) for name in layout.fingers[1:]], human.dtype)
            # some length stays, for a vector of length 0 has no direction
            share = jnp.maximum(1 - pinch_nearness(near, jnp) * left / near, 0.1)
            human = jnp.concatenate([wrist, thumb * share[:, None]])
        return Targets(human, weights), state
