"""Targets of keyvectors: the human's, or, once a pinch is meant, closed ones (DexPilot)."""

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


class StatelessTargets(TargetPolicy[LayoutT, tuple[()]]):
    """Base class of policies that remember nothing between frames."""

    def init(self, layout: LayoutT) -> tuple[()]:
        """The empty state."""
        del layout
        return ()


@dataclass(frozen=True)
class PlainTargets(StatelessTargets[KeyvectorLayout]):
    """Every keyvector follows the human's.

    Attributes:
        beta: scale of the human vector.
        w_wrist, w_thumb, w_between: weights of the wrist-to-tip, thumb-to-tip and finger-to-finger
            keyvectors.
    """

    beta: float = 1.0
    w_wrist: float = 1.0
    w_thumb: float = 1.0
    w_between: float = 1.0

    def layout(self, fingers: tuple[str, ...]) -> KeyvectorLayout:
        """The paper's keyvectors."""
        return KeyvectorLayout(fingers)

    def __call__(
        self, state: tuple[()], layout: KeyvectorLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, tuple[()]]:
        """Targets of one frame."""
        weights = jnp.asarray(base_weights(layout, self.w_wrist, self.w_thumb, self.w_between))
        return Targets(human * self.beta, weights.astype(human.dtype)), state


class LatchState(NamedTuple):
    """State of a policy with pinch latches between frames.

    Attributes:
        latched: (F - 1,) which fingers are latched to the thumb.
        closure: (F - 1,) how far each latch has taken effect, 0 to 1.
    """

    latched: Bool[Array, " P"]
    closure: Float[Array, " P"]


@dataclass(frozen=True)
class DexPilotTargets(TargetPolicy[KeyvectorLayout, LatchState]):
    """Group form of DexPilot's targets (Handa et al. 2019), as the paper's table has it.

    Per finger, a latch with hysteresis: it closes when the (aligned) human thumb-to-tip distance
    falls under ``project`` and opens when it rises above ``escape``. Closed thumb vectors aim at
    direction x eta1 with weight w_set1; vectors between two fingers that are both latched aim at
    direction x eta2 with weight w_set2; all others at the human vector x beta with w_default.

    Attributes:
        project: closing distance [m].
        escape: opening distance [m].
        eta1: closed thumb-to-tip distance [m].
        eta2: distance between two latched fingers [m].
        w_set1: weight of closed thumb vectors.
        w_set2: weight between latched fingers.
        w_default: weight of the rest.
        w_thumb: factor on the open thumb-to-tip vectors (1 in the paper).
        w_between: factor on the open finger-to-finger vectors (1 in the paper).
        beta: scale of the human vectors.
        blend: share by which a latch's effect moves on per frame. 1, as published, makes targets
            and weights jump when a latch closes or opens; less spreads it over 1 / blend frames.
    """

    project: float = 0.010
    escape: float = 0.015
    eta1: float = 0.001
    eta2: float = 0.0
    w_set1: float = 2.0
    w_set2: float = 0.0
    w_default: float = 1.0
    w_thumb: float = 1.0
    w_between: float = 1.0
    beta: float = 1.0
    blend: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.blend <= 1:
            raise ConfigError(f"blend must be in (0, 1], not {self.blend}")
        if not 0 < self.project <= self.escape:
            raise ConfigError(
                f"pinch distances must satisfy 0 < project <= escape, not project={self.project}, "
                f"escape={self.escape} [m]"
            )

    def layout(self, fingers: tuple[str, ...]) -> KeyvectorLayout:
        """The paper's keyvectors."""
        return KeyvectorLayout(fingers)

    def with_operator(self, operator: OperatorProfile) -> tuple[DexPilotTargets, OperatorProfile]:
        """Latches at the operator's distances.

        Once tips are corrected, thumb and finger read nearly nothing in every pinch, so one pair of
        distances serves all fingers. DexPilot's own (30 and 50 mm) allow for an operator without a
        calibration, and also latch the neighbours of a pinching finger.
        """
        project, escape = operator.project, operator.escape
        if not operator.has("pinch") or project is None or escape is None:
            return self, operator
        return replace(self, project=project, escape=escape), operator

    def init(self, layout: KeyvectorLayout) -> LatchState:
        """Open latches."""
        count = len(layout.fingers) - 1
        return LatchState(*jax.device_put((np.zeros(count, bool), np.zeros(count, np.float32))))

    def latched(self, state: LatchState) -> Bool[Array, " P"]:
        """(F - 1,) which fingers are latched to the thumb."""
        return state.latched

    def __call__(
        self, state: LatchState, layout: KeyvectorLayout, human: Float[Array, "K 3"]
    ) -> tuple[Targets, LatchState]:
        """Targets of one frame, and the latches after it."""
        latched, closure = state
        length = jnp.linalg.norm(human, axis=-1)
        direction = human / jnp.maximum(length, 1e-9)[:, None]
        distance = length[layout.thumb]
        latched = jnp.where(latched, distance <= self.escape, distance < self.project)
        closure = jnp.clip(closure + jnp.where(latched, self.blend, -self.blend), 0.0, 1.0)

        weights = base_weights(
            layout, self.w_default, self.w_default * self.w_thumb, self.w_default * self.w_between
        )
        # Per keyvector: how far is it a closed thumb vector, or one between latched fingers?
        closed = jnp.zeros(len(layout.pairs), human.dtype).at[layout.thumb].set(closure)
        both = jnp.zeros_like(closed)
        if layout.between:
            k, i, j = (np.asarray(column) for column in zip(*layout.between, strict=True))
            both = both.at[k].set(jnp.minimum(closure[i], closure[j]))
        held = closed + both  # never both: they are different keyvectors
        eta = closed * self.eta1 + both * self.eta2
        free = (1 - held) * self.beta
        vectors = human * free[:, None] + direction * eta[:, None]
        lambdas = (1 - held) * weights + closed * self.w_set1 + both * self.w_set2
        return Targets(vectors, lambdas.astype(human.dtype)), LatchState(latched, closure)


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
        w_wrist, w_thumb, w_between: weights of the wrist-to-tip, thumb-to-tip and finger-to-finger
            keyvectors of length ``at``.
        focus: power by which the weight of thumb-to-tip vectors falls with their length. 2 prices
            the angle, 0 the distance alike at any length.
        focus_between: the same for finger-to-finger vectors.
        at: length at which the weights are those given [m].
        floor: length below which weights rise no more [m].
        apart: soft lower bound of thumb-to-tip targets, since pads touch before tips meet: a length
            g becomes (g^4 + apart^4)^(1/4); 0 leaves them the human's [m].
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
    w_between: float = 1.0
    focus: float = 2.0
    focus_between: float = 1.6
    at: float = 0.06
    floor: float = 0.01
    apart: float = 0.0035
    pinch_gaps: tuple[tuple[str, float], ...] = ()
    latches: bool = False
    project: float = 0.012
    escape: float = 0.02

    def __post_init__(self) -> None:
        check_numbers(self, positive=("at", "floor", "project"), not_negative=("apart",))
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
        """The paper's keyvectors."""
        return KeyvectorLayout(fingers)

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
        length = jnp.sqrt((human * human).sum(-1) + 1e-12)
        ratio = (self.at**2 + self.floor**2) / (length**2 + self.floor**2)
        base = jnp.asarray(base_weights(layout, 1.0, 0.0, 0.0), human.dtype) * self.w_wrist
        thumb = jnp.asarray(base_weights(layout, 0.0, 1.0, 0.0), human.dtype)
        between = jnp.asarray(base_weights(layout, 0.0, 0.0, 1.0), human.dtype)
        weights = (
            base
            + thumb * self.w_thumb * ratio ** (self.focus / 2)
            + between * self.w_between * ratio ** (self.focus_between / 2)
        )
        near = length[layout.thumb]
        if self.latches:
            state = jnp.where(state, near <= self.escape, near < self.project)
        if self.pinch_gaps:  # of an operator
            from smooth_operator.human.operator import pinch_nearness

            gaps = dict(self.pinch_gaps)
            left = jnp.asarray([gaps.get(name, 0.0) for name in layout.fingers[1:]], human.dtype)
            near = near - jnp.minimum(pinch_nearness(near, jnp) * left, near)
        longer = (near**4 + self.apart**4) ** 0.25 / length[layout.thumb]
        before, after = (np.ones(n) for n in (layout.thumb.start, len(human) - layout.thumb.stop))
        vectors = human * jnp.concatenate([before, longer, after]).astype(human.dtype)[:, None]
        return Targets(vectors, weights), state
