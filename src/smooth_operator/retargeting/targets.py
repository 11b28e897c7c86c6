"""Keyvectors, the base class of target policies, and the target policy of ``smooth``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.geometry import AnyKind, array_namespace, lengths
from smooth_operator.landmarks import WRIST, finger_landmarks
from smooth_operator.settings import check_numbers


class VectorLayout(ABC):
    """A list of vectors between landmarks for which a target policy sets targets.

    Subclasses define ``vectors``. The robot's points have the names of the landmarks.
    """

    @property
    @abstractmethod
    def vectors(self) -> tuple[tuple[int | None, int], ...]:
        """Landmark indices (from, to) of the (K,) vectors; None is the palm frame's origin."""

    @cached_property
    def landmarks(self) -> tuple[int, ...]:
        """Landmarks that the vectors join, in the order in which they first appear."""
        return tuple(dict.fromkeys(i for pair in self.vectors for i in pair if i is not None))

    def human(self, landmarks: AnyKind) -> AnyKind:
        """(..., K, 3) vectors of the human [m], from (..., 21, 3) aligned landmarks [m]."""
        return self.among(landmarks[..., list(self.landmarks), :])

    def among(self, points: AnyKind) -> AnyKind:
        """(..., K, 3) vectors [m] from the (..., P, 3) positions of ``landmarks`` [m]."""
        xp = array_namespace(points)
        points = xp.concatenate([points, xp.zeros_like(points[..., :1, :])], axis=-2)
        at = {None: -1} | {landmark: i for i, landmark in enumerate(self.landmarks)}
        start, end = ([at[pair[side]] for pair in self.vectors] for side in (0, 1))
        vectors: AnyKind = points[..., end, :] - points[..., start, :]
        return vectors


@dataclass(frozen=True)
class KeyvectorLayout(VectorLayout):
    """Keyvectors of the Smooth Operator paper, made from a hand's fingers rather than listed.

    Order: wrist to each tip (F), thumb tip to each other tip (F - 1), then tip to tip among the
    other fingers; 15 for five fingers, 6 for three. The wrist is the first landmark, then the tips.

    Attributes:
        fingers: human finger names, thumb first.
        between_fingers: False leaves out the vectors between fingers other than the thumb.
    """

    fingers: tuple[str, ...]
    between_fingers: bool = True

    @cached_property
    def vectors(self) -> tuple[tuple[int | None, int], ...]:
        """Landmark indices (from, to) of the (K,) vectors."""
        every = tuple(combinations((WRIST, *tips_of(self.fingers)), 2))
        return every if self.between_fingers else every[: self.thumb.stop]

    @property
    def thumb(self) -> slice:
        """Slice of the keyvectors from the thumb to the other fingers."""
        count = len(self.fingers)
        return slice(count, 2 * count - 1)


def tips_of(fingers: Sequence[str]) -> tuple[int, ...]:
    """Landmark indices of fingertips."""
    return tuple(chain[-1] for chain in finger_landmarks(fingers))


class Targets(NamedTuple):
    """Target vectors of one frame and their weights.

    Attributes:
        vectors: (K, 3) target values of the robot's keyvectors [m].
        weights: (K,) weights lambda_k of Eq. (1).
    """

    vectors: Float[Array, "K 3"]
    weights: Float[Array, " K"]


LayoutT = TypeVar("LayoutT", bound=VectorLayout)
StateT = TypeVar("StateT")


class TargetPolicy(ABC, Generic[LayoutT, StateT]):
    """Computes targets for the robot's vectors from the human's vectors, frame by frame.

    Subclasses are frozen dataclasses; the memory between frames is a pytree of arrays.
    """

    @abstractmethod
    def layout(self, fingers: tuple[str, ...]) -> LayoutT:
        """Returns the vectors for which the policy sets targets on a hand with these fingers."""

    @abstractmethod
    def init(self, layout: LayoutT) -> StateT:
        """Returns the state before the first frame."""

    @abstractmethod
    def __call__(
        self, state: StateT, layout: LayoutT, human: Float[Array, "K 3"]
    ) -> tuple[Targets, StateT]:
        """Targets of one frame for the human's (K, 3) vectors [m], and the state after it;
        traceable."""

    def latched(self, state: StateT) -> Bool[Array, " P"] | None:
        """(F - 1,) True for fingers latched to the thumb; None for a policy without latches."""
        del state
        return None


@dataclass(frozen=True)
class CloseTargets(TargetPolicy[KeyvectorLayout, Bool[Array, " P"]]):
    """Target policy of ``smooth``: targets are the human's vectors from wrist and thumb tip.

    The vectors from the thumb's tip have weight 0, because ``DirectionLength`` controls them.

    Attributes:
        w_wrist: weight of the wrist-to-tip keyvectors.
        project, escape: a finger is latched to the thumb when the distance of their tips falls
            below ``project``, and released when it rises above ``escape`` [m].
    """

    w_wrist: float = 18.0
    project: float = 0.012
    escape: float = 0.02

    def __post_init__(self) -> None:
        check_numbers(self, "targets.", positive=("project", "escape"))
        if isinstance(self.project, float) and not self.project <= self.escape:
            raise ConfigError(f"project {self.project} must not exceed escape {self.escape} [m]")

    def layout(self, fingers: tuple[str, ...]) -> KeyvectorLayout:
        """Returns the keyvectors from the wrist and from the thumb's tip."""
        return KeyvectorLayout(fingers, between_fingers=False)

    def init(self, layout: KeyvectorLayout) -> Bool[Array, " P"]:
        """Returns the state before the first frame, in which all latches are open."""
        latches: Array = jax.device_put(np.zeros(len(layout.fingers) - 1, bool))
        return latches

    def latched(self, state: Bool[Array, " P"]) -> Bool[Array, " P"]:
        """(F - 1,) True for fingers that are latched to the thumb."""
        return state

    def __call__(
        self, state: Bool[Array, " P"], layout: KeyvectorLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, Bool[Array, " P"]]:
        """Targets of one frame, and the latches after it."""
        near = lengths(human[layout.thumb])
        state = jnp.where(state, near <= self.escape, near < self.project)
        from_wrist = np.arange(len(human)) < len(layout.fingers)
        weights = jnp.asarray(np.where(from_wrist, self.w_wrist, 0.0), human.dtype)
        return Targets(human, weights), state
