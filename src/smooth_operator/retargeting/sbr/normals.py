"""Fresh standard normals, laid out for one fused loop over the candidates.

Fresh draws come from a counter: candidate n of a cycle owns its normals as a function of (key, n).
Nothing is stored; the elite are drawn again from their indices, and a compiler can fuse drawing,
kinematics and cost into a single pass that writes one number per candidate. JAX's own generator
(threefry and an inverse error function) costs more than all the kinematics of Algorithm 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, UInt32

from smooth_operator.retargeting.sbr.random_words import mix


def counter_normals(
    index: UInt32[Array, "*n"], words: UInt32[Array, "2"], count: int
) -> list[Float[Array, "*n"]]:
    """``count`` arrays of independent standard normals, addressed by the index of a candidate and
    two random words, the key of the cycle. A 32-bit mixer with full avalanche over the keyed
    counter gives one word for two normals, Box and Muller's transform makes them of it."""
    pairs = (count + 1) // 2
    both = [pair_of_normals(index * jnp.uint32(pairs) + jnp.uint32(k), words) for k in range(pairs)]
    return [pair[half] for half in (0, 1) for pair in both][:count]


def counter_normal_matrix(
    index: UInt32[Array, " n"], words: UInt32[Array, "2"], count: int
) -> Float[Array, "count n"]:
    """The same numbers as ``counter_normals``, as one matrix: less code, for few candidates."""
    pairs = (count + 1) // 2
    which = jnp.arange(pairs, dtype=jnp.uint32)[:, None]
    return jnp.concatenate(pair_of_normals(index * jnp.uint32(pairs) + which, words))[:count]


def pair_of_normals(
    counter: UInt32[Array, "*n"], words: UInt32[Array, "2"] | tuple[Array, Array]
) -> tuple[Array, Array]:
    """Box and Muller's transform of one word: its upper bits are an angle, its lower 16 a radius.

    The radius then ends at 4.85 deviations, beyond which lies one draw in 125,000.
    """
    bits = mix(counter ^ words[0], words[1])
    # 16 bits centred in their cells: never 0, and the logarithm stays finite
    uniform = _to_float(bits & jnp.uint32(0xFFFF)) * 2.0**-16 + 2.0**-17
    radius = jnp.sqrt(_minus_two_log(uniform))
    angle = _to_float(bits) * 2.0**-32  # half turns, in [-1/2, 1/2)
    square = angle * angle
    sine = angle * _horner(_SINE, square)
    # the lowest bit says which half of the circle
    sign = bits << 31
    mirrored = lax.bitcast_convert_type(lax.bitcast_convert_type(radius, jnp.uint32) ^ sign, _FLOAT)
    return mirrored * _horner(_COSINE, square), radius * sine


def _to_float(x: UInt32[Array, "*n"]) -> Float[Array, "*n"]:
    # as int32, which is what vector units convert
    return lax.bitcast_convert_type(x, jnp.int32).astype(jnp.float32)


def _minus_two_log(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """-2 ln x of numbers in (0, 1], to 3e-5; the general function is careful, and slower.

    With x = 2^e (1 + f), f in [-1/3, 1/3], ln x = e ln 2 + ln(1 + f).
    """
    bits = lax.bitcast_convert_type(x, jnp.int32)
    exponent = (bits - 0x3F2AAAAB) & jnp.int32(-0x800000)  # e, where float32 keeps it
    f = lax.bitcast_convert_type(bits - exponent, _FLOAT) - 1
    whole: Array = lax.convert_element_type(exponent, _FLOAT) * (2 * math.log(2) / 2**23)
    minus: Array = _horner(_LOG, f) * f - whole
    return minus


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
# No node is 0, where two of these would divide by it: the first has six nodes, an even number, and
# no Chebyshev node is an end of its interval.
_LOG: Final = _fit(lambda f: -2 * np.log1p(f) / f, -1 / 3, 1 / 3, 5)
_SINE: Final = _fit(lambda y: np.sin(np.pi * np.sqrt(y)) / np.sqrt(y), 0.0, 0.25, 3)  # in x², / x
_COSINE: Final = _fit(lambda y: np.cos(np.pi * np.sqrt(y)), 0.0, 0.25, 4)
