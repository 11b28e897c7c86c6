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
        """A tree that ``joins``."""
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


def joins(tree: Any) -> bool:
    """Whether a tree can be ``joined``."""
    kinds = ("float32", "int32", "uint32", "bool")
    return all(str(getattr(leaf, "dtype", None)) in kinds for leaf in jax.tree.leaves(tree))


def joined(tree: Any) -> Float[Array, " n"]:
    """The arrays of a tree in one, bit for bit; of NumPy's arrays one of NumPy's."""
    leaves = jax.tree.leaves(tree)
    xp = array_namespace(*leaves)
    parts = [xp.asarray(leaf).ravel() for leaf in leaves]
    one: Array = xp.concatenate([_as(part, np.float32, xp) for part in parts])
    return one


def parted(like: Made, joined: Float[Array, " n"] | Float[np.ndarray, " n"]) -> Made:
    """A tree like another, of arrays from ``joined``."""
    leaves, structure = jax.tree.flatten(like)
    parts, done, xp = [], 0, array_namespace(joined)
    for leaf in leaves:
        shape = np.shape(leaf)
        values = joined[done : done + math.prod(shape)].reshape(shape)
        parts.append(_as(values, jax.dtypes.canonicalize_dtype(jnp.result_type(leaf)), xp))
        done += math.prod(shape)
    tree: Made = jax.tree.unflatten(structure, parts)
    return tree


def _as(part: Any, kind: Any, xp: ModuleType) -> Any:
    """The same bits as another kind of 32 bits; truth as 0 or 1."""
    if part.dtype == bool:
        return part.astype(kind)
    if np.dtype(kind) == np.dtype(bool):
        return part != 0
    return part.view(kind) if xp is np else jax.lax.bitcast_convert_type(part, kind)
