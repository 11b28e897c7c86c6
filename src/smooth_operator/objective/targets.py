"""Targets of keyvectors: the base class of policies, and the policy of ``smooth``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.objective.keyvectors import KeyvectorLayout, VectorLayout
from smooth_operator.settings import check_numbers


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
        latches: True if fingers are latched to the thumb; it changes no target.
        project, escape: a finger is latched when the tips come nearer than the one [m], until they
            are farther apart than the other.
    """

    w_wrist: float = 18.0
    w_thumb: float = 8.0
    focus: float = 2.0
    at: float = 0.06
    floor: float = 0.01
    latches: bool = False
    project: float = 0.012
    escape: float = 0.02

    def __post_init__(self) -> None:
        weights, lengths = ("w_wrist", "w_thumb", "focus"), ("at", "floor", "project", "escape")
        check_numbers(self, "targets.", positive=lengths, not_negative=weights)
        if isinstance(self.project, float) and not self.project <= self.escape:
            raise ConfigError(f"project {self.project} must not exceed escape {self.escape} [m]")

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
        return Targets(human, weights), state
