"""Where keyvectors should go: as the human's, or, once a pinch is meant, closed (DexPilot)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.objective.keyvectors import KeyvectorLayout, TipLayout, VectorLayout


class Targets(NamedTuple):
    """Targets of one frame.

    Attributes:
        vectors: (K, 3) where the robot's keyvectors should go [m].
        weights: (K,) weights lambda_k of Eq. (1).
        latched: (F - 1,) which fingers are latched to the thumb; the policy's state.
        closure: (F - 1,) how far each latch has taken effect, 0 to 1; the policy's state.
    """

    vectors: Float[Array, "K 3"]
    weights: Float[Array, " K"]
    latched: Bool[Array, " P"]
    closure: Float[Array, " P"]


class TargetPolicy(Protocol):
    """Human vectors to targets; hysteresis is passed in and out, never kept inside."""

    def layout(self, fingers: tuple[str, ...]) -> VectorLayout:
        """Which vectors the policy speaks of, for a hand of these fingers."""

    def __call__(
        self,
        layout: Any,
        human: Float[Array, "K 3"],
        latched: Bool[Array, " P"],
        closure: Float[Array, " P"] | None = None,
    ) -> Targets:
        """Targets of one frame and the latches after it."""


@dataclass(frozen=True)
class PlainTargets:
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
        self,
        layout: KeyvectorLayout,
        human: Float[Array, "K 3"],
        latched: Bool[Array, " P"],
        closure: Float[Array, " P"] | None = None,
    ) -> Targets:
        """Targets of one frame; the latches stay as they are."""
        weights = jnp.asarray(base_weights(layout, self.w_wrist, self.w_thumb, self.w_between))
        return unlatched(human * self.beta, weights.astype(human.dtype), latched, closure)


@dataclass(frozen=True)
class TipTargets:
    """Every fingertip goes where the human's is in the palm frame: positions, not directions.

    Attributes:
        beta: scale of the human position.
    """

    beta: float = 1.0

    def layout(self, fingers: tuple[str, ...]) -> TipLayout:
        """From the palm's origin to each tip."""
        return TipLayout(fingers)

    def __call__(
        self,
        layout: TipLayout,
        human: Float[Array, "K 3"],
        latched: Bool[Array, " P"],
        closure: Float[Array, " P"] | None = None,
    ) -> Targets:
        """Targets of one frame; the latches stay as they are."""
        weights = jnp.ones(len(human), human.dtype)
        return unlatched(human * self.beta, weights, latched, closure)


@dataclass(frozen=True)
class DexPilotTargets:
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

    def __call__(
        self,
        layout: KeyvectorLayout,
        human: Float[Array, "K 3"],
        latched: Bool[Array, " P"],
        closure: Float[Array, " P"] | None = None,
    ) -> Targets:
        """Targets of one frame and the latches after it."""
        if closure is None:
            closure = latched.astype(human.dtype)
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
        return Targets(vectors, lambdas.astype(human.dtype), latched, closure)


def unlatched(
    vectors: Float[Array, "K 3"],
    weights: Float[Array, " K"],
    latched: Bool[Array, " P"],
    closure: Float[Array, " P"] | None,
) -> Targets:
    """Targets of a policy that latches nothing: its state is handed back as it came."""
    if closure is None:
        closure = latched.astype(vectors.dtype)
    return Targets(vectors, weights, latched, closure)


def base_weights(
    layout: KeyvectorLayout, wrist: float, thumb: float, between: float
) -> Float[np.ndarray, " K"]:
    """(K,) weights by kind of keyvector."""
    weights = np.full(len(layout.pairs), between)
    weights[: len(layout.fingers)] = wrist
    weights[layout.thumb] = thumb
    return weights
