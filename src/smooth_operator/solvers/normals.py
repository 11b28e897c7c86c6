"""Standard normals, fresh or fixed, laid out for one fused loop over the candidates.

Fresh draws come from a counter: candidate n of a cycle owns its normals as a function of (key, n).
Nothing is stored; the elite are drawn again from their indices, and a compiler can fuse drawing,
kinematics and cost into a single pass that writes one number per candidate. JAX's own generator
(threefry and an inverse error function) costs more than all the kinematics of Algorithm 1.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import Final, Literal

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, UInt32

from smooth_operator.errors import ConfigError


def counter_normals(
    index: UInt32[Array, "*n"], words: UInt32[Array, "2"], count: int
) -> list[Float[Array, "*n"]]:
    """Independent standard normals, addressed by index.

    Two rounds of a 32-bit mixer with full avalanche (Wellons' ``lowbias32`` constants) over the
    keyed counter give the bits; Box and Muller's transform the normals.

    Args:
        index: which candidates.
        words: two random words, the key of the cycle.
        count: how many normals each candidate has.

    Returns:
        ``count`` arrays of index's shape.
    """
    pairs = (count + 1) // 2
    both = [_pair(index * jnp.uint32(pairs) + jnp.uint32(k), words) for k in range(pairs)]
    return [pair[half] for half in (0, 1) for pair in both][:count]


def counter_normal_matrix(
    index: UInt32[Array, " n"], words: UInt32[Array, "2"], count: int
) -> Float[Array, "count n"]:
    """The same numbers as :func:`counter_normals`, as one matrix: less code, for few candidates."""
    pairs = (count + 1) // 2
    which = jnp.arange(pairs, dtype=jnp.uint32)[:, None]
    return jnp.concatenate(_pair(index * jnp.uint32(pairs) + which, words))[:count]


def seed_words(seed: int) -> UInt32[np.ndarray, "2"]:
    """Two well mixed words from any integer seed."""
    words: np.ndarray = np.random.SeedSequence([abs(seed), int(seed < 0)]).generate_state(2)
    return words


def frame_key(seed: UInt32[Array, "2"], count: UInt32[Array, ""]) -> UInt32[Array, "2"]:
    """The key of the count-th frame."""
    odd = jnp.asarray([0x9E3779B9, 0x85EBCA6B], jnp.uint32)  # two sequences that share no period
    return mix(mix(seed + odd * count) ^ seed[::-1])


def random_words(key: UInt32[Array, "2"], count: int) -> UInt32[Array, "count 2"]:
    """``count`` keys for as many cycles, from the key of a frame."""
    counter = jnp.arange(2 * count, dtype=jnp.uint32).reshape(count, 2)
    return mix(mix(counter + key[0]) ^ key[1])


def _pair(counter: UInt32[Array, "*n"], words: UInt32[Array, "2"]) -> tuple[Array, Array]:
    first = mix(counter ^ words[0])
    second = mix(first + words[1])
    # 23 bits centred in their cells: never 0, and the logarithm stays finite
    uniform = _to_float(first >> 9) * 2.0**-23 + 2.0**-24
    angle = _to_float(second) * 2.0**-31  # half turns, in [-1, 1)
    radius = jnp.sqrt(_minus_two_log(uniform))
    size = jnp.abs(angle)
    sine = _sin_half_turns(jnp.minimum(size, 1 - size))
    cosine = _sin_half_turns(0.5 - size)
    return radius * cosine, radius * jnp.where(angle < 0, -sine, sine)


def mix(x: UInt32[Array, "*n"]) -> UInt32[Array, "*n"]:
    """A bijection of 32-bit words in which every input bit reaches every output bit."""
    x = (x ^ (x >> 16)) * jnp.uint32(0x7FEB352D)
    x = (x ^ (x >> 15)) * jnp.uint32(0x846CA68B)
    return x ^ (x >> 16)


def fixed_normals(
    count: int, samples: int, kind: Literal["quasi", "pseudo"], seed: int
) -> Float[np.ndarray, "count samples"]:
    """A set of standard normals to use again in every frame.

    Sampling noise is then a smooth function of the input, which a command that is compared with the
    last one wants.

    Args:
        count: normals per candidate.
        samples: number of candidates.
        kind: ``quasi`` (low discrepancy: the additive recurrence of Roberts' generalised golden
            ratio, randomly shifted) or ``pseudo`` (random).
        seed: of the shift or the draws.

    Returns:
        (count, samples) float32.

    Raises:
        ConfigError: for another kind.
    """
    rng = np.random.default_rng(seed)
    if kind == "pseudo":
        return _whitened(rng.standard_normal((count, samples)))
    if kind != "quasi":
        raise ConfigError(f"base samples must be 'quasi' or 'pseudo', not {kind!r}")
    ratio = 2.0
    for _ in range(64):  # the root of x^(count + 1) = x + 1
        ratio = (1 + ratio) ** (1 / (count + 1))
    steps = ratio ** -np.arange(1.0, count + 1)
    points = (rng.random((count, 1)) + steps[:, None] * np.arange(1, samples + 1)) % 1.0
    inverse = NormalDist().inv_cdf  # SciPy's would cost half a second of import at start-up
    quantiles = [inverse(u) for u in np.clip(points, 1e-6, 1 - 1e-6).ravel()]
    return _whitened(np.array(quantiles).reshape(count, samples))


def _whitened(normals: Float[np.ndarray, "count samples"]) -> Float[np.ndarray, "count samples"]:
    """Mean 0 and covariance I exactly, where there are samples enough: a few hundred fixed normals
    in 16 dimensions would otherwise lean one way for ever."""
    count, samples = normals.shape
    if samples > 2 * count:
        normals = normals - normals.mean(axis=1, keepdims=True)
        normals = np.linalg.solve(np.linalg.cholesky(normals @ normals.T / samples), normals)
    return normals.astype(np.float32)


def _to_float(x: UInt32[Array, "*n"]) -> Float[Array, "*n"]:
    # as int32, which is what vector units convert
    return lax.bitcast_convert_type(x, jnp.int32).astype(jnp.float32)


def _minus_two_log(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """-2 ln x of numbers in (0, 1], to 3e-6; the general function is careful, and slower.

    With x = 2^e (1 + f), f in [-1/3, 1/3], ln x = e ln 2 + ln(1 + f).
    """
    bits = lax.bitcast_convert_type(x, jnp.int32)
    exponent = (bits - 0x3F2AAAAB) & jnp.int32(-0x800000)  # e, where float32 keeps it
    f = lax.bitcast_convert_type(bits - exponent, jnp.float32) - 1
    series = jnp.float32(_LOG_SERIES[-1])
    for c in _LOG_SERIES[-2::-1]:
        series = series * f + c
    whole: Array = lax.convert_element_type(exponent, jnp.float32) * (2 * math.log(2) / 2**23)
    minus: Array = series * f - whole
    return minus


# -2 ln(1 + f) / f, a polynomial through Chebyshev nodes: an even number, since f = 0 divides by 0
_LOG_NODES: Final = np.polynomial.chebyshev.chebpts1(8) / 3
_LOG_SERIES: Final = [
    float(c)
    for c in np.polynomial.Chebyshev.fit(_LOG_NODES, -2 * np.log1p(_LOG_NODES) / _LOG_NODES, 7)
    .convert(kind=np.polynomial.Polynomial)
    .coef
]


def _sin_half_turns(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """sin(pi x) for |x| <= 1/2, to 2e-7."""
    y = x * x
    odd = 2.55016404 + y * (-0.59926453 + y * 0.0821458866)
    return x * (3.14159265 + y * (-5.16771278 + y * odd))
