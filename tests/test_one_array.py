"""A tree of arrays in one array."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from smooth_operator.methods.one_array import Joined, joined, joins, parted

TREE = {
    "positions": np.linspace(-1, 1, 6, dtype=np.float32).reshape(2, 3),
    "lost": np.array([np.nan, -np.nan, np.inf, -0.0], np.float32),
    "ticks": np.array([0, 7, 2**32 - 1], np.uint32),
    "count": np.array(-5, np.int32),
    "latched": np.array([True, False]),
    "none": (),
}


def same(one: Any, other: Any) -> bool:
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return jax.tree.structure(one) == jax.tree.structure(other) and all(
        np.asarray(a).dtype == np.asarray(b).dtype
        and np.asarray(a).tobytes() == np.asarray(b).tobytes()
        for a, b in pairs
    )


def test_a_tree_is_joined_bit_for_bit() -> None:
    on_host = joined(TREE)
    assert isinstance(on_host, np.ndarray)
    assert on_host.dtype == np.float32
    assert same(parted(TREE, on_host), TREE)
    traced = jax.jit(lambda tree: parted(tree, joined(tree)))(TREE)
    assert same(traced, TREE)
    assert joins(TREE)
    assert not joins({"a": np.zeros(2)})
    assert not joins({"a": 1.0})


def test_what_is_joined_is_a_tree_of_one_array() -> None:
    whole = Joined.of(TREE)
    assert len(jax.tree.leaves(whole)) == 1
    again = jax.tree.unflatten(*reversed(jax.tree.flatten(whole)))
    assert same(again.tree, TREE)
    assert jax.tree.structure(whole) == jax.tree.structure(again)
