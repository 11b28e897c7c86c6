"""A descent that first finds its basin, in frames in which there is none to go on in."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int


def settled(
    sampled: Callable[[Array, Array], Array],
    descended: Callable[[Array], tuple[Array, Array]],
    start: Float[Array, " m"],
    rounds: Int[Array, ""],
) -> Float[Array, " m"]:
    """End of a descent from a start, after some rounds of sampling and descent; traceable.

    Args:
        sampled: number of a round and where the last one ended, to a start of the next.
        descended: a start to where the descent ends, and the cost there.
        start: (m,) where the first round begins.
        rounds: number of rounds that begin with a sample; 0 in most frames.
    """

    # The last round only descends; of most frames it is the only one. The descent stands here once,
    # for a program with two of them takes twice as long to compile.
    def solve(round: Array, best: tuple[Array, Array]) -> tuple[Array, Array]:
        # A loop of one turn or none, and no branch: ``vmap`` would work out both sides of a branch.
        begin = lax.fori_loop(
            0, (round < rounds).astype(jnp.int32), lambda _, q: sampled(round, q), best[0]
        )
        pose, reached = descended(begin)
        # a later round may end in a worse basin; descent alone never does
        worse = reached > best[1]
        return jnp.where(worse, best[0], pose), jnp.where(worse, best[1], reached)

    nothing_yet = jnp.asarray(jnp.inf, start.dtype)
    best: tuple[Array, Array] = lax.fori_loop(0, rounds + 1, solve, (start, nothing_yet))
    return best[0]
