"""GPU kernels for two steps of the solvers, faster than a sequence of library calls.

``next_gaussian`` computes lines 7 to 11 of Algorithm 1: the elites, by a counting search for the
threshold on the bits of the costs, their mean and covariance, and its Cholesky factor.
``solve_positive_definite`` solves a few small systems. Both are written in Pallas for Triton, which
``jax.experimental`` has for NVIDIA and AMD. Without it, and on a CPU, ``kernels_available`` is
False, and callers use JAX's operations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, UInt32

from smooth_operator.geometry import on_gpu
from smooth_operator.retargeting.sbr.random_numbers import pair_of_normals, random_word_at

MOST_SAMPLES: Final = 1 << 14
"""Largest number of costs that fit into the registers of one block of threads."""

WARPS: Final = 4
"""Number of groups of 32 threads that search for the elites."""

_BLOCK: Final = 16
"""Smallest size of a matrix product in Triton."""


def kernels_available(samples: int = 0) -> bool:
    """True if a program that is being traced can contain the kernels.

    Args:
        samples: number of costs in a call of ``next_gaussian``.
    """
    try:
        return on_gpu() and samples <= MOST_SAMPLES and hasattr(_pallas()[1], "debug_barrier")
    except ImportError:
        return False


def _pallas() -> tuple[Any, Any]:
    """Imports Pallas and its module for Triton, which takes 0.1 s; never on a CPU."""
    from jax.experimental import pallas
    from jax.experimental.pallas import triton

    return pallas, triton


def cholesky_rows(matrix: Sequence[Sequence[Array]]) -> list[list[Array]]:
    """Rows of the lower Cholesky factor of a matrix whose entries are arrays of the same shape.
    Entries above the diagonal are not read. NaN for a matrix that is not positive definite."""
    rows: list[list[Array]] = []
    inverse: list[Array] = []
    for i, entries in enumerate(matrix):
        row: list[Array] = []
        for j in range(i):
            entry = entries[j]
            for k in range(j):
                entry = entry - row[k] * rows[j][k]
            row.append(entry * inverse[j])
        pivot = entries[i]
        for k in range(i):
            pivot = pivot - row[k] * row[k]
        inverse.append(lax.rsqrt(pivot))
        rows.append([*row, pivot * inverse[i]])
    return rows


def _solved(factor: Sequence[Sequence[Array]], right: Sequence[Array]) -> list[Array]:
    """Solves ``L L^T x = right`` entry by entry."""
    size = len(right)
    inverse = [1 / factor[i][i] for i in range(size)]
    x = list(right)
    for i in range(size):
        for k in range(i):
            x[i] = x[i] - factor[i][k] * x[k]
        x[i] = x[i] * inverse[i]
    for i in reversed(range(size)):
        for k in range(i + 1, size):
            x[i] = x[i] - factor[k][i] * x[k]
        x[i] = x[i] * inverse[i]
    return x


def solve_positive_definite(
    matrices: Float[Array, "c m m"], right: Float[Array, "c m"], interpret: bool = False
) -> Float[Array, "c m"]:
    """Solves ``matrix @ x = right`` for a few small positive definite matrices.

    Args:
        matrices: (c, m, m); only the lower triangles are read.
        interpret: True to run the kernel's operations one by one on any device; for tests.

    Returns:
        (c, m) solutions; NaN for a matrix that is not positive definite.
    """
    count, size = right.shape
    pallas, triton = _pallas()
    like: Any = jax.ShapeDtypeStruct

    def kernel(matrices: Any, right: Any, x: Any) -> None:
        # Triton compiles single numbers in 3 s, vectors of 8 in 30 s
        which = pallas.program_id(0)
        rows = [[matrices[which, i, j] for j in range(i + 1)] for i in range(size)]
        sides = [right[which, i] for i in range(size)]
        for i, entry in enumerate(_solved(cholesky_rows(rows), sides)):
            x[which, i] = entry

    solution: Array = pallas.pallas_call(
        kernel,
        like(right.shape, right.dtype),
        grid=(count,),
        interpret=interpret,
        compiler_params=None if interpret else triton.CompilerParams(num_warps=1),
    )(matrices, right)
    return solution


def next_gaussian(
    costs: Float[Array, " n"],
    mean: Float[Array, " m"],
    chol: Float[Array, "m m"],
    words: UInt32[Array, "2"],
    following: tuple[UInt32[Array, "2"], Array],
    base: Float[Array, "m n"] | None,
    limits: Float[np.ndarray, "m 2"] | Float[Array, "m 2"],
    elites: int,
    temperature: float,
    jitter: float,
    interpret: bool = False,
) -> tuple[Float[Array, " m"], Float[Array, "m m"], UInt32[Array, "2"]]:
    """Computes mean, Cholesky factor and random key of the next cycle from this cycle's costs.

    The elites are drawn again from their indices. Among equal costs, lower indices come first; NaN
    counts as infinite.

    Args:
        costs: (n,), n up to ``MOST_SAMPLES``.
        words: key of this cycle's normals.
        following: key of the frame and number of the next cycle; see ``random_word_at``.
        base: (m, n) fixed normals; None for those of the key.
        limits: (m, 2) bounds to which draws are clipped.
        elites: number of elites.
        temperature: temperature of the softmax over the elites.
        jitter: added to the diagonal of the covariance.
        interpret: True to run the kernel's operations one by one on any device; for tests.
    """
    count, size = len(costs), len(mean)
    pallas, triton = _pallas()
    side, places = max(_BLOCK, _power_of_two(size)), max(_BLOCK, _power_of_two(elites))

    def barrier() -> None:  # makes writes of a thread visible to the other threads of the block
        if not interpret:
            triton.debug_barrier()

    def kernel(*refs: Any) -> None:
        costs, mean, chol, words, key, number, limits, *rest = refs
        *fixed, new_mean, new_chol, new_words, chosen, covariance = rest
        one, two = words[0], words[1]
        which = jnp.arange(_power_of_two(count))
        inside = which < count
        values = triton.load(costs.at[which], mask=inside, other=jnp.inf)
        values = jnp.where(values != values, jnp.inf, values)
        elite, place = _lowest(_ordered(values), inside, elites)
        # places out of bounds for the others, because the interpreter ignores masks
        place = jnp.where(elite, place, places + which)
        triton.store(chosen.at[place], which, mask=elite)
        least = jnp.min(values)
        barrier()

        at = jnp.arange(places)
        index = triton.load(chosen.at[at], mask=at < elites, other=0)
        cost = triton.load(costs.at[index])
        weight = jnp.where(at < elites, jnp.exp((least - cost) / temperature), 0.0)
        weight = jnp.where(cost != cost, jnp.exp((least - jnp.inf) / temperature), weight)
        weight = weight / jnp.sum(weight)

        row = jnp.arange(side)
        joint = jnp.minimum(row, size - 1)
        used = row < size
        if fixed:
            normals = triton.load(fixed[0].at[joint[:, None], index[None, :]])
        else:
            pairs = (size + 1) // 2
            second = joint >= pairs
            pair = jnp.where(second, joint - pairs, joint).astype(jnp.uint32)
            counter = index.astype(jnp.uint32)[None, :] * jnp.uint32(pairs) + pair[:, None]
            first_half, second_half = pair_of_normals(counter, (one, two))
            normals = jnp.where(second[:, None], second_half, first_half)
        lower = used[:, None] & (row[None, :] <= row[:, None])
        factor = triton.load(chol.at[joint[:, None], joint[None, :]], mask=lower, other=0.0)
        low, high, middle = (
            triton.load(ref, mask=used, other=0.0)
            for ref in (limits.at[joint, 0], limits.at[joint, 1], mean.at[joint])
        )
        draws = middle[:, None] + _product(factor, normals)
        draws = jnp.minimum(jnp.maximum(draws, low[:, None]), high[:, None])

        centre = jnp.sum(draws * weight[None, :], axis=1)
        triton.store(new_mean.at[row], centre, mask=used)
        spread = (draws - centre[:, None]) * jnp.sqrt(weight)[None, :]
        square = _product(spread, jnp.transpose(spread))
        square = square + jnp.where(row[:, None] == row[None, :], jitter, 0.0)
        triton.store(covariance.at[row[:, None], row[None, :]], square)
        barrier()

        for half in range(2):
            new_words[half] = random_word_at((key[0], key[1]), number[0], half)
        entries = [[covariance[i, j] for j in range(i + 1)] for i in range(size)]
        for i, entry in enumerate(cholesky_rows(entries)):
            for j, value in enumerate(entry):
                new_chol[i, j] = value  # the zeros above the diagonal are those of ``chol``

    like: Any = jax.ShapeDtypeStruct
    key, number = following
    arguments = [costs, mean, chol, words, key, number.reshape(1), jnp.asarray(limits, jnp.float32)]
    new_mean, new_chol, new_words, *_ = pallas.pallas_call(
        kernel,
        [
            like((size,), jnp.float32),
            like((size, size), jnp.float32),
            like((2,), jnp.uint32),
            like((places,), jnp.int32),
            like((side, side), jnp.float32),
        ],
        input_output_aliases={1: 0, 2: 1, 3: 2},  # otherwise a loop copies them every time
        interpret=interpret,
        compiler_params=None if interpret else triton.CompilerParams(num_warps=WARPS),
    )(*arguments, *([] if base is None else [base]))
    return new_mean, new_chol, new_words


def _lowest(keys: Array, inside: Array, count: int) -> tuple[Array, Array]:
    """Mask of the lowest ``count`` integers, and the rank of each by index."""

    def searching(carry: tuple[Array, Array, Array]) -> Array:
        low, high, reached = carry
        return (low + 1 < high) & (reached != count)

    def narrowed(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        low, high, reached = carry
        width = lax.bitcast_convert_type(high - low, jnp.uint32) // 3
        third = jnp.maximum(lax.bitcast_convert_type(width, jnp.int32), 1)
        one, two = low + third, high - third
        # both counts in one sum, which is the expensive operation
        both = (keys <= one).astype(jnp.int32) + ((keys <= two).astype(jnp.int32) << 15)
        sums = jnp.sum(both)
        up_to_one, up_to_two = sums & 0x7FFF, sums >> 15
        first, second = up_to_one >= count, up_to_two >= count
        low = jnp.where(first, low, jnp.where(second, one, two))
        high = jnp.where(first, one, jnp.where(second, two, high))
        return low, high, jnp.where(first, up_to_one, jnp.where(second, up_to_two, reached))

    start = (jnp.min(keys) - 1, jnp.max(keys), jnp.int32(len(keys)))
    _, threshold, _ = lax.while_loop(searching, narrowed, start)
    below, equal = keys < threshold, (keys == threshold) & inside
    # again two counts in one sum: those below in the upper half of the word
    sums = jnp.cumsum((below.astype(jnp.int32) << 16) + equal.astype(jnp.int32))
    room = count - jnp.sum(below.astype(jnp.int32))
    so_far = sums & 0xFFFF
    elite = below | (equal & (so_far <= room))
    return elite, (sums >> 16) + jnp.minimum(so_far, room) - 1


def _ordered(values: Array) -> Array:
    """Maps float32 numbers to integers in the same order."""
    bits = lax.bitcast_convert_type(values, jnp.int32)
    return bits ^ ((bits >> 31) & 0x7FFFFFFF)


def _product(a: Array, b: Array) -> Array:
    return jnp.dot(a, b, precision=lax.Precision.HIGHEST)


def _power_of_two(count: int) -> int:
    return 1 << max(0, count - 1).bit_length()
