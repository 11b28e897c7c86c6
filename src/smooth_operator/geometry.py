"""Similarity transforms between point sets, and array helpers that work with NumPy and JAX."""

from __future__ import annotations

from types import ModuleType
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

AnyArray: TypeAlias = Array | np.ndarray
"""NumPy (float64, on the host) or JAX (traceable)."""
AnyKind = TypeVar("AnyKind", Array, np.ndarray)
"""NumPy in, NumPy out; JAX in, JAX out."""


def array_namespace(*arrays: Any) -> ModuleType:
    """Array-API namespace ``xp`` of some arrays: ``jax.numpy`` if one is from JAX, else NumPy."""
    return jnp if any(isinstance(a, Array) for a in arrays) else np


_Held = TypeVar("_Held", bound=AnyArray)  # a named tuple can't be generic over alternatives


class Similarity(NamedTuple, Generic[_Held]):
    """Similarity transform x -> scale * rotation @ x + translation, and how well-conditioned it is.

    Attributes:
        rotation: (..., 3, 3) proper rotation.
        translation: (..., 3) [m].
        scale: (...) ratio of the target's size to the source's size.
        condition: (...) second singular value over the first of the covariance between the two
            sets: 0 if one set is collinear or coincident, so that the rotation is undetermined.
    """

    rotation: _Held
    translation: _Held
    scale: _Held
    condition: _Held

    def apply(self, points: _Held) -> _Held:
        """Transforms (..., n, 3) points."""
        xp = array_namespace(points, self.scale)
        turned: Any = _product(points, xp.swapaxes(self.rotation, -1, -2), xp)
        moved: _Held = self.scale[..., None, None] * turned + self.translation[..., None, :]
        return moved


def umeyama(
    source: AnyKind,
    target: AnyArray,
    scale: float | AnyArray | None = None,
    weights: AnyArray | None = None,
) -> Similarity[AnyKind]:
    """Computes the least-squares similarity of source onto target (Kabsch 1976; Umeyama 1991).

    The result is the best rotation, even if the best orthogonal matrix is a reflection. Coplanar
    sets, such as three palm landmarks, are allowed. Without a branch or LAPACK call, the function
    compiles into the program around it: the singular vectors come from Jacobi rotations of the
    3 x 3 Gram matrix, and the third pair from cross products.

    Args:
        source: (..., n, 3) points [m].
        target: (..., n, 3) corresponding points [m].
        scale: ratio of sizes to hold fixed; None estimates it.
        weights: (..., n) weight of each pair; 0 leaves it out. None gives all pairs equal weights.

    Returns:
        the transform. Check ``condition`` before using it: degenerate sets give a finite but
        meaningless rotation.
    """
    xp = array_namespace(source, target)
    if weights is None:
        centre_s, centre_t = source.mean(axis=-2), target.mean(axis=-2)
        root: AnyArray | float = 1.0
    else:
        share = weights[..., None] / xp.maximum(weights.sum(axis=-1), 1e-12)[..., None, None]
        centre_s, centre_t = (source * share).sum(axis=-2), (target * share).sum(axis=-2)
        root = xp.sqrt(weights)[..., None]
    a, b = (source - centre_s[..., None, :]) * root, (target - centre_t[..., None, :]) * root
    spread, spread_t = (a**2).sum(axis=(-2, -1)), (b**2).sum(axis=(-2, -1))
    tiny = xp.finfo(a.dtype).tiny
    # Normalising both sets makes every threshold below free of units.
    size = xp.sqrt(xp.maximum(spread * spread_t, tiny))
    cov = _product(xp.swapaxes(a, -1, -2), b, xp) / size[..., None, None]
    v1, v2, v3 = _principal_axes(cov, xp)
    u1 = _apply(cov, v1, xp)
    s1 = _norm(u1, xp)
    u1 = u1 / xp.maximum(s1, tiny)[..., None]
    u2 = _apply(cov, v2, xp)
    u2 = u2 - _dot(u1, u2)[..., None] * u1
    s2 = _norm(u2, xp)
    u2 = u2 / xp.maximum(s2, tiny)[..., None]
    u3 = xp.cross(u1, u2)
    s3 = _dot(u3, _apply(cov, v3, xp))  # signed: negative where the best map is a reflection
    rotation = sum(v[..., :, None] * u[..., None, :] for u, v in ((u1, v1), (u2, v2), (u3, v3)))
    if scale is None:
        ratio = (s1 + s2 + s3) * size / xp.maximum(spread, tiny)
    else:
        ratio = xp.broadcast_to(xp.asarray(scale, a.dtype), spread.shape)
    translation = centre_t - ratio[..., None] * _apply(rotation, centre_s, xp)
    # The differences of coincident points are rounding errors, which can have any shape.
    rounding = (4 * xp.finfo(a.dtype).eps) ** 2
    apart = spread > rounding * (source**2).sum(axis=(-2, -1))
    apart &= spread_t > rounding * (target**2).sum(axis=(-2, -1))
    condition = xp.where(apart, s2 / xp.maximum(s1, tiny), 0)
    return Similarity(rotation, translation, ratio, condition)


def lengths(vectors: Float[Array, "*n 3"], least: float = 0.0) -> Float[Array, "*n"]:
    """Lengths of vectors: square roots of the sum of squares plus ``least``, which keeps the
    derivative of a zero vector finite."""
    squares = (vectors * vectors).sum(-1)
    return jnp.sqrt(squares + least if least else squares)


def smooth_step(share: Array) -> Array:
    """Smooth step 3 s^2 - 2 s^3, with s clipped to [0, 1]; its slope is 0 at both ends."""
    share = jnp.clip(share, 0.0, 1.0)
    return share * share * (3 - 2 * share)


def on_gpu() -> bool:
    """True if programs that are traced now will run on a GPU."""
    config: Any = jax.config  # its attributes are made at run time
    device = config.jax_default_device
    return (getattr(device, "platform", device) or jax.default_backend()) in ("gpu", "cuda", "rocm")


def _principal_axes(cov: AnyArray, xp: ModuleType) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Right singular vectors in order of decreasing singular value, as a right-handed triad."""
    gram = _product(xp.swapaxes(cov, -1, -2), cov, xp)
    entries = [gram[..., i, j] for i, j in _ENTRIES]
    columns = [xp.broadcast_to(xp.eye(3, dtype=cov.dtype)[i], gram.shape[:-1]) for i in range(3)]
    state = (*entries, *columns)
    if xp is np:
        for _ in range(_TURNS):
            state = _jacobi_turn(state, xp)
    else:  # rolled up, for the sake of the compiler; on a GPU a turn of a loop costs more than that
        state = lax.fori_loop(
            0, _TURNS, lambda _, state: _jacobi_turn(state, xp), state, unroll=on_gpu() or None
        )
    values, columns = [state[_ENTRIES.index((i, i))] for i in range(3)], list(state[6:])
    for i, j in ((0, 1), (1, 2), (0, 1)):  # sort by falling value
        swap = values[i] < values[j]
        values[i], values[j] = (
            xp.where(swap, values[j], values[i]),
            xp.where(swap, values[i], values[j]),
        )
        columns[i], columns[j] = (
            xp.where(swap[..., None], columns[j], columns[i]),
            xp.where(swap[..., None], columns[i], columns[j]),
        )
    return columns[0], columns[1], xp.cross(columns[0], columns[1])


_ENTRIES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_TURNS = 12  # cyclic Jacobi converges quadratically: four turns in each plane reach float64


def _jacobi_turn(state: tuple[Any, ...], xp: ModuleType) -> tuple[Any, ...]:
    """Make entry (0, 1) zero by a rotation in that plane, then rename axes 0, 1, 2 to 2, 0, 1.

    Three rotations visit all planes and restore the names. The state is six entries of the matrix,
    in the order of ``_ENTRIES``, and three columns.
    """
    g00, g01, g02, g11, g12, g22, v0, v1, v2 = state
    one = xp.ones_like(g00)
    negligible = xp.abs(g01) < 1e-30  # the sets are normalised
    tau = (g11 - g00) / (2 * xp.where(negligible, one, g01))
    t = xp.where(tau >= 0, one, -one) / (xp.abs(tau) + xp.hypot(one, tau))
    t = xp.where(negligible, xp.zeros_like(t), t)
    c = 1 / xp.hypot(one, t)
    s = t * c
    g00, g11, g01 = g00 - t * g01, g11 + t * g01, xp.zeros_like(g01)
    g02, g12 = c * g02 - s * g12, s * g02 + c * g12
    c, s = c[..., None], s[..., None]
    v0, v1 = c * v0 - s * v1, s * v0 + c * v1
    return g11, g12, g01, g22, g02, g00, v1, v2, v0


def _product(a: AnyArray, b: AnyArray, xp: ModuleType) -> AnyArray:
    if xp is np:
        return np.asarray(a @ b)
    product: AnyArray = (a[..., :, :, None] * b[..., None, :, :]).sum(
        axis=-2
    )  # no call of a library
    return product


def _apply(matrix: AnyArray, vector: AnyArray, xp: ModuleType) -> AnyArray:
    return _product(matrix, vector[..., None], xp)[..., 0]


def _dot(a: AnyArray, b: AnyArray) -> AnyArray:
    product: AnyArray = (a * b).sum(axis=-1)
    return product


def _norm(a: AnyArray, xp: ModuleType) -> AnyArray:
    length: AnyArray = xp.sqrt(_dot(a, a))
    return length
