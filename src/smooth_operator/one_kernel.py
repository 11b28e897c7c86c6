"""Parts of a program that XLA compiles into one kernel each, and not one for each operation.

On a CPU, XLA queues the operations of a program. As soon as nine are ready it hands half of them to
another thread, and being woken takes that thread longer than a frame's operations take: a frame of
``smooth`` lost a third of its time that way. What stands in one kernel is not queued.

XLA does it for a call with certain attributes, which it sets itself on small loops. They are not
documented, so they are used with the versions that were tried alone; others queue all operations.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.metadata import version
from types import ModuleType
from typing import Any, Final, Generic, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core
from jaxtyping import Array, Float

from smooth_operator.geometry import array_namespace

Made = TypeVar("Made")

TRIED: Final = frozenset({"0.10.2"})
"""Versions of jaxlib with which the tests of all hands have passed."""

_UNFIT: Final = frozenset(
    {
        "approx_top_k", "cholesky", "conv_general_dilated", "custom_call", "debug_callback",
        "dot_general", "eigh", "ffi_call", "fft", "householder_product", "io_callback", "lu",
        "pure_callback", "qr", "rng_bit_generator", "schur", "sort", "svd", "top_k",
        "triangular_solve", "tridiagonal", "tridiagonal_solve",
    }
)  # fmt: skip
"""Operations for which XLA calls a library: they can't stand in such a kernel."""

_TAGS: Final = {"xla_cpu_small_call": "true", "inlineable": "false"}

_SHAPE: Any = jax.ShapeDtypeStruct  # has no types
_on: ContextVar[bool] = ContextVar("one_kernel", default=False)


@contextlib.contextmanager
def one_kernel_parts(on: bool) -> Iterator[None]:
    """Whether parts of what is traced in the block are kernels; on other devices they are not."""
    before = _on.set(on and jax.default_backend() == "cpu" and version("jaxlib") in TRIED)
    try:
        yield
    finally:
        _on.reset(before)


def one_kernel(function: Callable[..., Made]) -> Callable[..., Made]:
    """The function as a part of a program that is one kernel, where that is on and possible.

    Args:
        function: of trees of arrays of 32 bits or booleans (or ``handed_on``), to such a tree;
            traceable.
    """

    def part(*arguments: Any) -> Made:
        trees = [tree_of(each) for each in arguments]
        if not _on.get():
            return function(*trees)
        trees = [jax.tree.map(jnp.asarray, each) for each in trees]
        from jax.experimental.xla_metadata import set_xla_metadata

        # One array for each argument, and one for the value: an array that the compiler finds to be
        # unused ends the process (jaxlib 0.10.2), and an argument is hardly unused as a whole.
        made: list[Made] = []

        def flat(*arrays: Array) -> Array:
            value = function(*map(parted, trees, arrays))
            made.append(jax.tree.map(lambda leaf: _SHAPE(leaf.shape, leaf.dtype), value))
            return joined(value)

        both = zip(arguments, trees, strict=True)
        given = [each.array if isinstance(each, Joined) else joined(tree) for each, tree in both]
        program = jax.jit(flat)
        traced = program.trace(*(_SHAPE(each.shape, each.dtype) for each in given)).jaxpr.jaxpr
        if not (_fits(traced) and _uses_all(traced)):
            return function(*trees)
        tagged: Any = set_xla_metadata  # has no types
        value: Made = parted(made[0], tagged(program(*given), **_TAGS))
        return value

    return part


@jax.tree_util.register_pytree_node_class
@dataclass(frozen=True, eq=False)
class Joined(Generic[Made]):
    """A tree of arrays in one array, which a program takes, gives and hands on in a third of the
    time of twenty.

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
        """The tree: of traced arrays if they are traced, else NumPy's."""
        traced = isinstance(self.array, jax.core.Tracer)
        return parted(self.like, self.array if traced else np.asarray(self.array))

    def tree_flatten(self) -> tuple[tuple[Any], Any]:
        """See ``jax.tree_util.register_pytree_node_class``."""
        leaves, structure = jax.tree.flatten(self.like)
        return (self.array,), (tuple((leaf.shape, leaf.dtype) for leaf in leaves), structure)

    @classmethod
    def tree_unflatten(cls, known: Any, leaves: tuple[Any]) -> Joined[Any]:
        """See ``jax.tree_util.register_pytree_node_class``."""
        shapes, structure = known
        return cls(*leaves, jax.tree.unflatten(structure, [_SHAPE(*each) for each in shapes]))


def handed_on(tree: Made) -> Made | Joined[Made]:
    """A tree for several kernels: ``Joined`` where parts are kernels."""
    return Joined.of(tree) if _on.get() else tree


def tree_of(tree: Made | Joined[Made]) -> Made:
    """The tree of what was ``handed_on``."""
    return tree.tree if isinstance(tree, Joined) else tree


def _uses_all(jaxpr: Any) -> bool:
    """Whether each argument has a part in the value."""
    live = {id(var) for var in jaxpr.outvars}
    for equation in reversed(jaxpr.eqns):
        if any(id(var) in live for var in equation.outvars):
            live |= {id(var) for var in equation.invars}
    return all(id(var) in live for var in jaxpr.invars)


def _fits(jaxpr: Any) -> bool:
    return all(equation.primitive.name not in _UNFIT for equation in jaxpr.eqns) and all(
        map(_fits, core.subjaxprs(jaxpr))
    )


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
    found, done, xp = [], 0, array_namespace(joined)
    for leaf in leaves:
        shape = np.shape(leaf)
        taken = joined[done : done + math.prod(shape)].reshape(shape)
        found.append(_as(taken, jax.dtypes.canonicalize_dtype(jnp.result_type(leaf)), xp))
        done += math.prod(shape)
    made: Made = jax.tree.unflatten(structure, found)
    return made


def _as(part: Any, kind: Any, xp: ModuleType) -> Any:
    """The same bits as another kind of 32 bits; truth as 0 or 1."""
    if part.dtype == bool:
        return part.astype(kind)
    if np.dtype(kind) == np.dtype(bool):
        return part != 0
    return part.view(kind) if xp is np else jax.lax.bitcast_convert_type(part, kind)
