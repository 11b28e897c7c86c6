"""Random numbers of SBR's sampler: keys of frames and cycles, and normals for candidates.

The normals of candidate n of a cycle are a function of (key, n) and are not stored: the compiler
fuses drawing, kinematics and cost. JAX's own generator is slower than all of the kinematics.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, UInt32


def seed_words(seed: int) -> UInt32[np.ndarray, "2"]:
    """Makes two random words from any integer seed."""
    words: np.ndarray = np.random.SeedSequence([abs(seed), int(seed < 0)]).generate_state(2)
    return words


def frame_key(seed: UInt32[Array, "2"], count: UInt32[Array, ""]) -> UInt32[Array, "2"]:
    """Makes the random key of the count-th frame."""
    odd = jnp.asarray([0x9E3779B9, 0x85EBCA6B], jnp.uint32)  # two sequences without a common period
    return mix(mix(seed + odd * count) ^ seed[::-1])


def random_words(key: UInt32[Array, "2"], count: int) -> UInt32[Array, "count 2"]:
    """Makes the keys of ``count`` cycles from the key of a frame."""
    counter = jnp.arange(2 * count, dtype=jnp.uint32).reshape(count, 2)
    return mix(mix(counter + key[0]) ^ key[1])


def random_word_at(
    key: UInt32[Array, "2"] | tuple[Array, Array], which: Array, half: int
) -> UInt32[Array, ""]:
    """Returns one number of ``random_words``: the first or second number of a row."""
    counter = 2 * which.astype(jnp.uint32) + jnp.uint32(half)
    return mix(mix(counter + key[0]) ^ key[1])


def mix(x: UInt32[Array, "*n"], word: Array | int = 0) -> UInt32[Array, "*n"]:
    """Mixes 32-bit words by a bijection in which every input bit affects every output bit.

    The constants are those of Wellons' ``lowbias32``. Each ``word`` gives another bijection.
    """
    x = (x ^ (x >> 16)) * jnp.uint32(0x7FEB352D) + jnp.uint32(word)
    x = (x ^ (x >> 15)) * jnp.uint32(0x846CA68B)
    return x ^ (x >> 16)


def counter_normals(
    index: UInt32[Array, "*n"], words: UInt32[Array, "2"], count: int
) -> list[Float[Array, "*n"]]:
    """Makes ``count`` arrays of independent standard normals for the indices of candidates, from
    the two words of the cycle's key. A 32-bit mixer with full avalanche maps the keyed counter to
    one word, and the Box-Muller transform maps the word to two normals."""
    pairs = (count + 1) // 2
    both = [pair_of_normals(index * jnp.uint32(pairs) + jnp.uint32(k), words) for k in range(pairs)]
    return [pair[half] for half in (0, 1) for pair in both][:count]


def counter_normal_matrix(
    index: UInt32[Array, " n"], words: UInt32[Array, "2"], count: int
) -> Float[Array, "count n"]:
    """The numbers of ``counter_normals`` as one matrix, in a smaller program for few candidates."""
    pairs = (count + 1) // 2
    which = jnp.arange(pairs, dtype=jnp.uint32)[:, None]
    return jnp.concatenate(pair_of_normals(index * jnp.uint32(pairs) + which, words))[:count]


def pair_of_normals(
    counter: UInt32[Array, "*n"], words: UInt32[Array, "2"] | tuple[Array, Array]
) -> tuple[Array, Array]:
    """Box-Muller transform of one word: upper bits give the angle, the lower 16 the radius.

    The radius is therefore at most 4.85 standard deviations; one draw in 125,000 would exceed that.
    """
    bits = mix(counter ^ words[0], words[1])
    # 16 bits, centred in their cells: never 0, so that the logarithm is finite
    uniform = _to_float(bits & jnp.uint32(0xFFFF)) * 2.0**-16 + 2.0**-17
    radius = jnp.sqrt(-2 * jnp.log(uniform))
    angle = _to_float(bits) * 2.0**-32  # half turns, in [-1/2, 1/2)
    square = angle * angle
    sine = angle * _horner(_SINE, square)
    # the lowest bit selects the half of the circle
    sign = bits << 31
    mirrored = lax.bitcast_convert_type(lax.bitcast_convert_type(radius, jnp.uint32) ^ sign, _FLOAT)
    return mirrored * _horner(_COSINE, square), radius * sine


def _to_float(x: UInt32[Array, "*n"]) -> Float[Array, "*n"]:
    # via int32, because vector units convert only that
    return lax.bitcast_convert_type(x, jnp.int32).astype(jnp.float32)


def _horner(coefficients: Sequence[float], x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    value: Array = jnp.full_like(x, coefficients[-1])
    for c in coefficients[-2::-1]:
        value = value * x + c
    return value


def _fit(
    function: Callable[[np.ndarray], np.ndarray], low: float, high: float, degree: int
) -> list[float]:
    """Coefficients of a polynomial through Chebyshev nodes: close to the best of its degree."""
    fit = np.polynomial.Chebyshev.interpolate(function, degree, domain=[low, high])
    return [float(c) for c in fit.convert(kind=np.polynomial.Polynomial).coef]


_FLOAT: Final = jnp.float32
# no Chebyshev node is 0, the end of the intervals, where the first would divide by it
_SINE: Final = _fit(lambda y: np.sin(np.pi * np.sqrt(y)) / np.sqrt(y), 0.0, 0.25, 3)  # in x², / x
_COSINE: Final = _fit(lambda y: np.cos(np.pi * np.sqrt(y)), 0.0, 0.25, 4)
