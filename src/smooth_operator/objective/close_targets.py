"""Targets of ``smooth``: the human's vectors, weighted so that directions count, near ones most.

The direction of a short vector turns with the least error of its ends, so an error of the same
length costs more on it: a pinch is held closely without a latch that could jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.objective.keyvectors import KeyvectorLayout
from smooth_operator.objective.targets import Targets, base_weights, unlatched


@dataclass(frozen=True)
class CloseTargets:
    """Every keyvector follows the human's; the nearer its ends, the more closely.

    Attributes:
        w_wrist, w_thumb, w_between: weights of the wrist-to-tip, thumb-to-tip and finger-to-finger
            keyvectors of length ``at``.
        focus: how the weight of thumb-to-tip vectors falls with their length: its power. 2 prices
            the angle, 0 the distance alike at any length.
        focus_between: the same for finger-to-finger vectors.
        at: length at which the weights are those given [m].
        floor: length below which weights rise no more [m].
        contact: human thumb-to-tip distance under which a pinch is meant to close [m]: targets are
            then ``closed``; 0 leaves them the human's.
        release: distance from which the target is the human's own [m].
        closed: distance of the robot's tips in a closed pinch [m].
    """

    w_wrist: float = 0.3
    w_thumb: float = 10.0
    w_between: float = 1.0
    focus: float = 1.25
    focus_between: float = 1.6
    at: float = 0.06
    floor: float = 0.01
    contact: float = 0.008
    release: float = 0.02
    closed: float = 0.005

    def __post_init__(self) -> None:
        numbers = (self.contact, self.release, self.at, self.floor)
        if all(isinstance(n, float) for n in numbers):
            if self.contact and not 0 < self.contact < self.release:
                raise ConfigError(
                    "pinch distances must satisfy 0 < contact < release, not "
                    f"contact={self.contact}, release={self.release} [m]"
                )
            if self.at <= 0 or self.floor <= 0:
                raise ConfigError(
                    f"at and floor must be positive lengths [m], not {self.at}, {self.floor}"
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
        """Targets of one frame; nothing latches, the state is handed back."""
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
        vectors = human
        if not (isinstance(self.contact, int | float) and self.contact == 0):
            distance = length[layout.thumb]
            share = jnp.clip((distance - self.contact) / (self.release - self.contact), 0.0, 1.0)
            share = share * share * (3 - 2 * share)
            wanted = self.closed + share * (distance - self.closed)
            wanted = jnp.minimum(wanted, distance)
            vectors = human.at[layout.thumb].multiply((wanted / distance)[:, None])
        return unlatched(vectors, weights, latched, closure)
