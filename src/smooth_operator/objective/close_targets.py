"""Targets of ``smooth``: the human's vectors, weighted so that directions count, near ones most,
since an error of the same length turns them more."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.human.operator import Component, OperatorProfile, pinch_nearness
from smooth_operator.objective.keyvectors import KeyvectorLayout
from smooth_operator.objective.targets import TargetPolicy, Targets, base_weights
from smooth_operator.settings import check_numbers


@dataclass(frozen=True)
class CloseTargets(TargetPolicy[KeyvectorLayout, Any]):
    """Every keyvector follows the human's; the nearer its ends, the more closely.

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
        if self.pinch_gaps:
            gaps = dict(self.pinch_gaps)
            left = jnp.asarray([gaps.get(name, 0.0) for name in layout.fingers[1:]], human.dtype)
            near = near - jnp.minimum(pinch_nearness(near, jnp) * left, near)
        longer = (near**4 + self.apart**4) ** 0.25 / length[layout.thumb]
        before, after = (np.ones(n) for n in (layout.thumb.start, len(human) - layout.thumb.stop))
        vectors = human * jnp.concatenate([before, longer, after]).astype(human.dtype)[:, None]
        return Targets(vectors, weights), state
