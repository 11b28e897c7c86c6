"""State between frames: one array, and the trees that it is made of."""

from typing import Any

import jax
import numpy as np

from smooth_operator.retargeting.program import FrameState, RetargetState, StateLayout

TREE = {
    "positions": np.linspace(-1, 1, 6, dtype=np.float32).reshape(2, 3),
    "lost": np.array([np.nan, -np.nan, np.inf, -0.0], np.float32),
    "ticks": np.array([0, 7, 2**32 - 1], np.uint32),
    "count": np.array(-5, np.int32),
    "latched": np.array([True, False]),
    "none": (),
}
OTHERS = {"precise": np.array([0.1, 0.2]), "small": np.array([1, -1], np.int8), "number": 1.0}
Q = np.array([0.5, -0.5], np.float32)


def same(one: Any, other: Any) -> bool:
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return jax.tree.structure(one) == jax.tree.structure(other) and all(
        np.asarray(a).dtype == np.asarray(b).dtype
        and np.asarray(a).tobytes() == np.asarray(b).tobytes()
        for a, b in pairs
    )


def test_a_state_is_one_array_bit_for_bit():
    trees = FrameState(TREE, Q)
    layout = StateLayout.of(trees)
    words, others = layout.pack(trees)
    assert words.dtype == np.float32
    assert others == ()
    assert same(layout.unpack(words, others), trees)
    traced = jax.jit(lambda state: layout.unpack(*layout.pack(state)))(trees)
    assert same(traced, trees)


def test_arrays_of_other_kinds_stay_as_they_are():
    trees = FrameState(TREE | OTHERS, Q)
    state = RetargetState.of(trees)
    assert len(state.others) == len(OTHERS)
    assert same(state.trees, trees)
    assert same(state.method, trees.method)
    np.testing.assert_array_equal(state.trees.q, Q)
