"""Random words of 32 bits from counters: seeds, keys of frames and of cycles."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt32


def seed_words(seed: int) -> UInt32[np.ndarray, "2"]:
    """Two random words from any integer seed."""
    words: np.ndarray = np.random.SeedSequence([abs(seed), int(seed < 0)]).generate_state(2)
    return words


def frame_key(seed: UInt32[Array, "2"], count: UInt32[Array, ""]) -> UInt32[Array, "2"]:
    """Key of the count-th frame."""
    odd = jnp.asarray([0x9E3779B9, 0x85EBCA6B], jnp.uint32)  # two sequences without a common period
    return mix(mix(seed + odd * count) ^ seed[::-1])


def random_words(key: UInt32[Array, "2"], count: int) -> UInt32[Array, "count 2"]:
    """Keys of ``count`` cycles, from the key of a frame."""
    counter = jnp.arange(2 * count, dtype=jnp.uint32).reshape(count, 2)
    return mix(mix(counter + key[0]) ^ key[1])


def random_word_at(
    key: UInt32[Array, "2"] | tuple[Array, Array], which: Array, half: int
) -> UInt32[Array, ""]:
    """One number of ``random_words``: the first or the second one of a row."""
    counter = 2 * which.astype(jnp.uint32) + jnp.uint32(half)
    return mix(mix(counter + key[0]) ^ key[1])


def mix(x: UInt32[Array, "*n"], word: Array | int = 0) -> UInt32[Array, "*n"]:
    """Bijection of 32-bit words in which every input bit affects every output bit.

    The constants are those of Wellons' ``lowbias32``. Each ``word`` gives another bijection.
    """
    x = (x ^ (x >> 16)) * jnp.uint32(0x7FEB352D) + jnp.uint32(word)
    x = (x ^ (x >> 15)) * jnp.uint32(0x846CA68B)
    return x ^ (x >> 16)
