"""Estimates and closes, during use, the gaps that a tracker reports when thumb and finger touch.

The hand model of a camera tracker keeps touching fingertips centimetres apart. The gap differs
between fingers but is similar for all people. Contact can't be measured directly, but a thumb that
keeps a constant distance from one finger, closer than to any other, most likely touches it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.geometry import lengths, smooth_step
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, TIPS, finger_landmarks
from smooth_operator.retargeting.alignment import palm_alignment
from smooth_operator.retargeting.flat_hand import flat_hand
from smooth_operator.retargeting.known_gaps import check_gaps
from smooth_operator.retargeting.program import FrameClock

_HOLD: Final = 0.2  # time for which thumb and finger keep their distance in a contact [s]
_STEADY: Final = 0.022  # variation of that distance to either side that is allowed [palm lengths]
# margin by which other fingers must be farther from the thumb [palm lengths]
_NEAREST: Final = 0.066
_MORE: Final = 0.11  # margin by which a gap may exceed the known one [palm lengths]
_DOWN: Final = 0.5  # weight of a contact below the estimate
_UP: Final = 0.1  # weight of a contact above the estimate
_LEAD: Final = 0.3  # time constant with which the correction follows the estimate [s]
# Fraction of a gap by which contacts may exceed it, by finger. An object held by the
# first two fingers appears just beyond a contact; the other fingers rarely hold anything.
_SPREAD: Final = {"index": 0.12, "middle": 0.12, "ring": 0.25, "pinky": 0.25}
_CLOSED: Final = 0.9  # fraction of a contact's distance that is closed
_FALL: Final = 6  # exponent with which that fraction falls beyond a contact
# extension of a finger (base-to-tip distance over length) below which it does not pinch
_FOLDED: Final = 0.35
_UNFOLDED: Final = 0.5  # extension above which a finger pinches like an open finger
_TINY: Final = 1e-18


class PinchGapState(NamedTuple):
    """State of the estimate; all thumb-to-finger distances are in palm lengths.

    Attributes:
        level: (P,) distance that each finger keeps from the thumb.
        held: (P,) time for which the finger has kept that distance [s].
        last: (P,) distance of its last contact.
        gap: (P,) estimated gap; 0 before the first estimate.
        closed: (P,) gap that is currently closed; it follows the estimate.
        most: (P,) largest gap that is accepted.
    """

    level: Float[Array, " P"]
    held: Float[Array, " P"]
    last: Float[Array, " P"]
    gap: Float[Array, " P"]
    closed: Float[Array, " P"]
    most: Float[Array, " P"]

    @classmethod
    def of(cls, fingers: tuple[str, ...], known: Mapping[str, float] | None) -> PinchGapState:
        """State before the first frame, for the fingers of a hand, thumb first; see ``check_gaps``.

        Args:
            known: known gaps of the tracker or the operator, by finger; None closes no gaps.
        """
        check_gaps(known or {})
        zero = np.zeros(len(fingers) - 1, np.float32)
        start = np.array([(known or {}).get(name, 0.0) for name in fingers[1:]], np.float32)
        most = zero if known is None else start + np.float32(_MORE)
        return cls(*jax.device_put([zero, zero, zero, start, start, most]))


@dataclass(frozen=True, eq=False)
class PinchGapEstimate:
    """Estimates pinch gaps for one robot hand, from landmarks in its palm frame."""

    hand: Hand

    @cached_property
    def palm(self) -> float:
        """Length of a human palm, from wrist to middle knuckle, in the robot's palm frame [m]."""
        flat = flat_hand(self.hand.spec.side)
        scale = float(palm_alignment(flat, self.hand).scale)
        return scale * float(np.linalg.norm(flat[BASES[2]] - flat[0]))

    def step(
        self, state: PinchGapState, aligned: Float[Array, "21 3"], clock: FrameClock
    ) -> tuple[PinchGapState, Float[Array, "21 3"]]:
        """Returns the state after a frame, and its landmarks with pinches closed; traceable.

        A distance d is shortened by the fraction s min(1, g' / d)^p, where the largest distance of
        a contact is g' = (1 + ``_SPREAD``) g, s is ``_CLOSED``, and p is ``_FALL``. It falls
        quickly, because thumb and finger that hold an object appear slightly farther apart than in
        a contact. Thumb and finger each move half of the distance.

        Args:
            aligned: (21, 3) landmarks in the palm frame [m]; NaN where one is not known.
            clock: time since the last frame.
        """
        joints = np.array(finger_landmarks(self.hand.fingers[1:]))
        at = joints[:, -1]
        chains = aligned[joints]
        bones = lengths(jnp.diff(chains, axis=1), _TINY).sum(-1)
        extension = lengths(chains[:, -1] - chains[:, 0], _TINY) / bones
        apart = (aligned[at] - aligned[TIPS[0]]) / self.palm
        distance = lengths(apart, _TINY)
        state = self._estimated(state, distance, extension, clock)
        unfolded = smooth_step((extension - _FOLDED) / (_UNFOLDED - _FOLDED))
        spread = np.array([_SPREAD[name] for name in self.hand.fingers[1:]])
        over = (1 + spread) * state.closed / distance
        share = unfolded * _CLOSED * jnp.minimum(over, 1.0) ** _FALL
        share = jnp.where(share > 0, share, 0.0)[:, None]  # NaN if bones are unknown
        near = jnp.minimum(2 * share, 1.0)
        step = share * apart * self.palm
        thumb = 0.5 * (near * step).sum(0) / jnp.maximum(near.sum(), 1.0)
        return state, aligned.at[TIPS[0]].add(thumb).at[at].add(near * thumb - step)

    def _estimated(
        self,
        state: PinchGapState,
        distance: Float[Array, " P"],
        extension: Float[Array, " P"],
        clock: FrameClock,
    ) -> PinchGapState:
        """Updates the state with a frame's thumb distances [palm lengths] and extensions."""
        level = jnp.clip(state.level, distance - _STEADY, distance + _STEADY)
        keeps = (level == state.level) & ~clock.restart
        held = jnp.where(keeps, state.held + clock.dt, 0.0)
        remaining = distance - state.closed
        others = jnp.where(np.eye(len(distance), dtype=bool), jnp.inf, remaining).min(-1)
        contact = (held >= _HOLD) & (state.held < _HOLD) & (distance < state.most)
        contact &= (extension > _UNFOLDED) & (remaining + _NEAREST < others)
        # without a known gap, two contacts must agree
        agrees = jnp.abs(distance - state.last) < 2 * _STEADY
        first = jnp.where(agrees, jnp.minimum(distance, state.last), 0.0)
        share = jnp.where(distance < state.gap, _DOWN, _UP)
        moved = jnp.where(state.gap > 0, state.gap + share * (distance - state.gap), first)
        gap = jnp.where(contact, moved, state.gap)
        last = jnp.where(contact, distance, state.last)
        closed = state.closed + clock.dt / (clock.dt + _LEAD) * (gap - state.closed)
        return PinchGapState(level, held, last, gap, closed, state.most)
