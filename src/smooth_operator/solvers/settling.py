"""A descent that first finds its basin, in frames in which there is none to go on in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

CLEARLY: Final = 0.8
"""Cost of another basin over that of the present one, at most, for which it is left."""


class _Best(NamedTuple):
    """The best pose (m,) yet, its cost, and whether it is in another basin than the start."""

    pose: Float[Array, " m"]
    cost: Float[Array, ""]
    elsewhere: Bool[Array, ""]


def settled(
    sampled: Callable[[Array, Array], Array],
    descended: Callable[[Array, Array], tuple[Array, Array]],
    start: Float[Array, " m"],
    rounds: Int[Array, ""],
    doubtful: Bool[Array, ""],
) -> tuple[Float[Array, " m"], Bool[Array, ""]]:
    """End of a descent from a start, after some rounds of sampling and descent; traceable.

    Args:
        sampled: number of a round and where the last one ended, to a start of the next.
        descended: a start, and whether the descent is free of the last answer, to where it ends
            and the cost there.
        start: (m,) where the first round begins.
        rounds: number of rounds that begin with a sample; 0 in most frames.
        doubtful: the start is an answer that is left only for one that costs clearly less
            (``CLEARLY``); the first round does not sample, for the cost of the start's basin.

    Returns:
        (m,) the pose, and whether a doubtful start was left.
    """

    # The last round only descends; of most frames it is the only one. The descent stands here once,
    # for a program with two of them takes twice as long to compile.
    def solve(round: Array, best: _Best) -> _Best:
        last = round == rounds
        samples = ~last & ~(doubtful & (round == 0))
        stays = last & ~best.elsewhere
        # A loop of one turn or none, and no branch: ``vmap`` would work out both sides of a branch.
        begin = lax.fori_loop(
            0,
            samples.astype(jnp.int32),
            lambda _, q: sampled(round, q),
            jnp.where(doubtful & stays, start, best.pose),
        )
        pose, reached = descended(begin, ~stays)
        # a later round may end in a worse basin; descent alone never does
        most = jnp.where(doubtful & (round > 0), CLEARLY * best.cost, best.cost)
        worse = (reached > most) & ~(doubtful & last)
        return _Best(
            jnp.where(worse, best.pose, pose),
            jnp.where(worse, best.cost, reached),
            best.elsewhere | (doubtful & (round > 0) & ~last & ~worse),
        )

    nothing_yet = _Best(start, jnp.asarray(jnp.inf, start.dtype), jnp.bool_(False))
    best: _Best = lax.fori_loop(0, rounds + 1, solve, nothing_yet)
    return best.pose, best.elsewhere
