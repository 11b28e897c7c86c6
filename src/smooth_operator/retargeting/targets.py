"""Targets of keyvectors: the base class of policies, and the policy of ``smooth``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.retargeting.keyvectors import KeyvectorLayout, VectorLayout
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


@dataclass(frozen=True)
class CloseTargets(TargetPolicy[KeyvectorLayout, Bool[Array, " P"]]):
    """Targets of ``smooth``: the human's vectors from the wrist and from the thumb's tip.

    Those from the wrist have a weight; those from the thumb only have ``DirectionLength``'s costs.

    Attributes:
        w_wrist: weight of the wrist-to-tip keyvectors.
        project, escape: a finger is latched to the thumb when the tips come nearer than the one
            [m], until they are farther apart than the other. That changes no target.
    """

    w_wrist: float = 18.0
    project: float = 0.012
    escape: float = 0.02

    def __post_init__(self) -> None:
        check_numbers(self, "targets.", positive=("project", "escape"), not_negative=("w_wrist",))
        if isinstance(self.project, float) and not self.project <= self.escape:
            raise ConfigError(f"project {self.project} must not exceed escape {self.escape} [m]")

    def layout(self, fingers: tuple[str, ...]) -> KeyvectorLayout:
        """The paper's keyvectors from the wrist and from the thumb's tip."""
        return KeyvectorLayout(fingers, between_fingers=False)

    def init(self, layout: KeyvectorLayout) -> Bool[Array, " P"]:
        """Open latches."""
        latches: Array = jax.device_put(np.zeros(len(layout.fingers) - 1, bool))
        return latches

    def latched(self, state: Bool[Array, " P"]) -> Bool[Array, " P"]:
        """(F - 1,) which fingers are latched to the thumb."""
        return state

    def __call__(
        self, state: Bool[Array, " P"], layout: KeyvectorLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, Bool[Array, " P"]]:
        """Targets of one frame, and the latches after it."""
        thumb = human[layout.thumb]
        near = jnp.sqrt((thumb * thumb).sum(-1))
        state = jnp.where(state, near <= self.escape, near < self.project)
        from_wrist = np.arange(len(human)) < len(layout.fingers)
        weights = jnp.asarray(np.where(from_wrist, self.w_wrist, 0.0), human.dtype)
        return Targets(human, weights), state
