"""A tree of arrays in one array, which a program takes and returns in a third of the time of
twenty."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.geometry import array_namespace

Made = TypeVar("Made")

_SHAPE: Any = jax.ShapeDtypeStruct  # has no types


@jax.tree_util.register_pytree_node_class
@dataclass(frozen=True, eq=False)
class Joined(Generic[Made]):
    """A tree of arrays in one array.

    Attributes:
        array: see ``joined``.
        like: the tree, of shapes and kinds.
    """

    array: Float[Array, " n"] | Float[np.ndarray, " n"]
    like: Made

    @classmethod
    def of(cls, tree: Made) -> Joined[Made]:
        """A tree on the host in one array, its kinds as JAX would have them."""
        tree = jax.tree.map(lambda leaf: np.asarray(leaf, _kind(leaf)), tree)
        return cls(joined(tree), jax.tree.map(lambda leaf: _SHAPE(leaf.shape, leaf.dtype), tree))

    @property
    def tree(self) -> Made:
        """The tree, of NumPy's arrays."""
        return parted(self.like, np.asarray(self.array))

    def tree_flatten(self) -> tuple[tuple[Any], Any]:
        """See ``jax.tree_util.register_pytree_node_class``."""
        leaves, structure = jax.tree.flatten(self.like)
        return (self.array,), (tuple((leaf.shape, leaf.dtype) for leaf in leaves), structure)

    @classmethod
    def tree_unflatten(cls, known: Any, leaves: tuple[Any]) -> Joined[Any]:
        """See ``jax.tree_util.register_pytree_node_class``."""
        shapes, structure = known
        return cls(*leaves, jax.tree.unflatten(structure, [_SHAPE(*each) for each in shapes]))


def joined(tree: Any) -> Float[Array, " n"]:
    """The arrays of a tree in one, bit for bit; of NumPy's arrays one of NumPy's."""
    leaves = jax.tree.leaves(tree)
    xp = array_namespace(*leaves)
    one: Array = xp.concatenate([_words(xp.asarray(leaf).ravel(), xp) for leaf in leaves])
    return one


def parted(like: Made, joined: Float[Array, " n"] | Float[np.ndarray, " n"]) -> Made:
    """A tree like another, of arrays from ``joined``."""
    leaves, structure = jax.tree.flatten(like)
    parts, done, xp = [], 0, array_namespace(joined)
    for leaf in leaves:
        shape, kind = np.shape(leaf), _kind(leaf)
        length = math.prod(shape) * max(kind.itemsize // 4, 1)
        parts.append(_values(joined[done : done + length], kind, xp).reshape(shape))
        done += length
    tree: Made = jax.tree.unflatten(structure, parts)
    return tree


def _kind(leaf: Any) -> np.dtype:
    """The kind that JAX gives an array."""
    kind: np.dtype = jax.dtypes.canonicalize_dtype(jnp.result_type(leaf))
    return kind


def _wide(kind: np.dtype) -> np.dtype:
    """The kind of 32 bits or more that holds the values of a shorter one."""
    if kind.itemsize >= 4:
        return kind
    return np.dtype(np.float32 if jnp.issubdtype(kind, jnp.floating) else np.int32)


def _words(part: Any, xp: ModuleType) -> Any:
    """Values as float32 of the same bits: two for one of 64 bits, truth and others as one."""
    part = part.astype(_wide(part.dtype))
    if xp is np:
        return part.view(np.float32)
    return jax.lax.bitcast_convert_type(part, np.float32).ravel()


def _values(words: Any, kind: np.dtype, xp: ModuleType) -> Any:
    """The values of ``_words``."""
    wide = _wide(kind)
    if xp is np:
        return words.view(wide).astype(kind)
    pairs = words.reshape(-1, wide.itemsize // 4) if wide.itemsize > 4 else words
    return jax.lax.bitcast_convert_type(pairs, wide).astype(kind)
