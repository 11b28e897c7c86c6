"""Gaps that a tracker leaves where thumb and finger touch, estimated and closed while one works.

A camera's hand model keeps fingertips centimetres apart that are in contact, by an amount that is
much the same for all people and differs between fingers. Nothing says when fingers touch. But a
thumb that stays at one distance from a finger, nearer than to any other, most likely touches it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.geometry import smooth_step
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, FINGERS, TIPS
from smooth_operator.retargeting.known_gaps import check_gaps

_HOLD: Final = 0.2  # for how long thumb and finger keep their distance in a contact [s]
_STEADY: Final = 0.022  # by how much that distance may vary to either side [palm lengths]
_NEAREST: Final = 0.066  # by how much other fingers are further from the thumb [palm lengths]
_MORE: Final = 0.11  # by how much a gap may exceed the one that is known [palm lengths]
_DOWN: Final = 0.5  # share by which a contact below the estimate moves it
_UP: Final = 0.1  # the same of one above it
_LEAD: Final = 0.3  # time in which the correction follows the estimate [s]
# Share of a gap by which contacts exceed it, index to little finger. What the first two hold is
# shown just beyond a contact; the others hardly ever hold anything.
_SPREAD: Final = (0.12, 0.12, 0.25, 0.25)
_CLOSED: Final = 0.9  # share of a contact's distance that is closed
_FALL: Final = 6  # power with which that share falls beyond a contact
_FOLDED: Final = 0.35  # extension of a finger, base to tip over its length, that pinches nothing
_UNFOLDED: Final = 0.5  # extension from which a finger pinches as an open one
_TINY: Final = 1e-9


class PinchGapState(NamedTuple):
    """State of the estimate; all distances between thumb and finger in palm lengths.

    Attributes:
        level: (P,) distance at which each finger is held.
        held: (P,) for how long [s].
        last: (P,) distance of its last contact.
        gap: (P,) estimate of the gap; 0 while there is none.
        closed: (P,) gap that is closed now, which follows the estimate.
        most: (P,) greatest gap that is believed.
    """

    level: Float[Array, " P"]
    held: Float[Array, " P"]
    last: Float[Array, " P"]
    gap: Float[Array, " P"]
    closed: Float[Array, " P"]
    most: Float[Array, " P"]

    @classmethod
    def of(cls, fingers: tuple[str, ...], known: Mapping[str, float] | None) -> PinchGapState:
        """State before the first frame for a hand's fingers, thumb first; see ``check_gaps``.

        Args:
            known: finger -> gap that the tracker or the operator is known for; None closes no gap.
        """
        check_gaps(known or {})
        zero = np.zeros(len(fingers) - 1, np.float32)
        if known is None:
            return cls(*jax.device_put([zero] * 6))
        start = np.array([known.get(name, 0.0) for name in fingers[1:]], np.float32)
        return cls(*jax.device_put([zero, zero, zero, start, start, start + np.float32(_MORE)]))


@dataclass(frozen=True, eq=False)
class PinchGapEstimate:
    """The running estimate for one robot hand, on landmarks in its palm frame."""

    hand: Hand

    @cached_property
    def palm(self) -> float:
        """Length of a human palm, wrist to middle knuckle, in the robot's palm frame [m]."""
        from smooth_operator.retargeting.alignment import palm_alignment
        from smooth_operator.retargeting.flat_hand import FLAT_HAND

        flat = FLAT_HAND * (1.0, -1.0, 1.0) if self.hand.spec.side == "left" else FLAT_HAND
        scale = float(palm_alignment(flat, self.hand).scale)
        return scale * float(np.linalg.norm(FLAT_HAND[BASES[2]] - FLAT_HAND[0]))

    def step(
        self,
        state: PinchGapState,
        aligned: Float[Array, "21 3"],
        dt: Float[Array, ""],
        restart: Bool[Array, ""],
    ) -> tuple[PinchGapState, Float[Array, "21 3"]]:
        """The state after a frame, and its landmarks with pinches closed; traceable.

        A distance d is shortened by the share s min(1, g' / d)^p, where the greatest distance of a
        contact is g' = (1 + ``_SPREAD``) g, s is ``_CLOSED``, and p is ``_FALL``. What thumb and
        finger hold is shown a little farther apart than a contact. A share that falls fast leaves
        them apart, and its slope stays bounded, so that it does not magnify the tracker's shake
        into leaps. Thumb and finger each go half of the way.

        Args:
            aligned: (21, 3) landmarks in the palm frame [m]; NaN where one is not known.
            dt: time since the last frame [s].
            restart: nothing came before, or too long ago to count as motion.
        """
        fingers = np.array([FINGERS.index(name) for name in self.hand.fingers[1:]])
        bases, at = np.array(BASES)[fingers], np.array(TIPS)[fingers]
        chains = aligned[bases[:, None] + np.arange(4)]
        bones = _length(jnp.diff(chains, axis=1)).sum(-1)
        extension = _length(chains[:, -1] - chains[:, 0]) / bones
        apart = (aligned[at] - aligned[TIPS[0]]) / self.palm
        distance = _length(apart)
        state = self._estimated(state, distance, extension, dt, restart)
        unfolded = smooth_step((extension - _FOLDED) / (_UNFOLDED - _FOLDED))
        over = (1 + np.array(_SPREAD)[fingers - 1]) * state.closed / distance
        share = unfolded * _CLOSED * jnp.minimum(over, 1.0) ** _FALL
        share = jnp.where(share > 0, share, 0.0)[:, None]  # NaN where bones are not known
        near = jnp.minimum(2 * share, 1.0)
        step = share * apart * self.palm
        thumb = 0.5 * (near * step).sum(0) / jnp.maximum(near.sum(), 1.0)
        return state, aligned.at[TIPS[0]].add(thumb).at[at].add(near * thumb - step)

    def _estimated(
        self,
        state: PinchGapState,
        distance: Float[Array, " P"],
        extension: Float[Array, " P"],
        dt: Float[Array, ""],
        restart: Bool[Array, ""],
    ) -> PinchGapState:
        """The state after a frame's distances from the thumb [palm lengths] and extensions."""
        level = jnp.clip(state.level, distance - _STEADY, distance + _STEADY)
        held = jnp.where((level == state.level) & ~restart, state.held + dt, 0.0)
        remaining = distance - state.closed
        others = jnp.where(np.eye(len(distance), dtype=bool), jnp.inf, remaining).min(-1)
        contact = (held >= _HOLD) & (state.held < _HOLD) & (distance < state.most)
        contact &= (extension > _UNFOLDED) & (remaining + _NEAREST < others)
        # without a known gap two contacts must agree
        agrees = jnp.abs(distance - state.last) < 2 * _STEADY
        first = jnp.where(agrees, jnp.minimum(distance, state.last), 0.0)
        share = jnp.where(distance < state.gap, _DOWN, _UP)
        moved = jnp.where(state.gap > 0, state.gap + share * (distance - state.gap), first)
        gap = jnp.where(contact, moved, state.gap)
        last = jnp.where(contact, distance, state.last)
        closed = state.closed + dt / (dt + _LEAD) * (gap - state.closed)
        return PinchGapState(level, held, last, gap, closed, state.most)


def _length(vectors: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    return jnp.sqrt((vectors * vectors).sum(-1) + _TINY**2)
