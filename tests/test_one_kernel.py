"""Parts of a program that are one kernel each."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jaxtyping import Array
from queued import QueuedSmooth

from smooth_operator import Retargeter
from smooth_operator.one_kernel import (
    TRIED,
    Joined,
    handed_on,
    joined,
    joins,
    one_kernel,
    one_kernel_parts,
    parted,
    tree_of,
)
from smooth_operator.synthetic import SyntheticOperator

TREE = {
    "positions": np.linspace(-1, 1, 6, dtype=np.float32).reshape(2, 3),
    "lost": np.array([np.nan, -np.nan, np.inf, -0.0], np.float32),
    "ticks": np.array([0, 7, 2**32 - 1], np.uint32),
    "count": np.array(-5, np.int32),
    "latched": np.array([True, False]),
    "none": (),
}

tried = pytest.mark.skipif(
    jax.default_backend() != "cpu" or version("jaxlib") not in TRIED,
    reason=f"kernels are made with jaxlib {', '.join(sorted(TRIED))} on a CPU alone",
)


def same(one: Any, other: Any) -> bool:
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return jax.tree.structure(one) == jax.tree.structure(other) and all(
        np.asarray(a).dtype == np.asarray(b).dtype
        and np.asarray(a).tobytes() == np.asarray(b).tobytes()
        for a, b in pairs
    )


def in_kernels(function: Callable[..., Any]) -> Callable[..., Any]:
    def traced(*arguments: Any) -> Any:
        with one_kernel_parts(True):
            return function(*arguments)

    return jax.jit(traced)


def kernels(function: Callable[..., Any], *arguments: Any) -> int:
    return str(in_kernels(function).lower(*arguments).as_text()).count("xla_cpu_small_call")


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
    assert same(tree_of(again), TREE)
    assert tree_of(TREE) is TREE
    assert jax.tree.structure(whole) == jax.tree.structure(again)
    assert handed_on(TREE) is TREE  # outside of a program of kernels


@tried
def test_a_part_is_one_kernel_and_computes_the_same() -> None:
    def part(tree: dict[str, Array], more: Array) -> dict[str, Array]:
        points = tree["positions"] * more + jnp.where(tree["latched"], 1.0, 2.0)[:, None]
        return {"points": points / (1 + points * points), "ticks": tree["ticks"] + jnp.uint32(1)}

    arguments = TREE, np.float32(3)
    assert kernels(one_kernel(part), *arguments) == 1
    assert kernels(part, *arguments) == 0
    found = in_kernels(one_kernel(part))(*arguments)
    expected = jax.jit(part)(*arguments)
    np.testing.assert_allclose(found["points"], expected["points"], rtol=1e-6)
    np.testing.assert_array_equal(found["ticks"], np.array([1, 8, 0], np.uint32))
    assert same(one_kernel(part)(*arguments), part(*arguments))  # off


@tried
def test_numbers_of_another_precision_are_taken_as_jax_takes_them() -> None:
    limits = np.array([[-1.0, 1.0], [0.25, 0.5]])  # float64
    found = in_kernels(one_kernel(lambda q, limits: jnp.clip(q, limits[:, 0], limits[:, 1])))(
        np.array([-3.0, 3.0], np.float32), limits
    )
    np.testing.assert_array_equal(found, np.array([-1, 0.5], np.float32))


@pytest.mark.parametrize(
    "unfit",
    [
        lambda x: x @ x,
        lambda x: jnp.sort(x),
        lambda x: jnp.linalg.cholesky(x @ x.T + jnp.eye(3)),
        lambda x: lax.cond(x[0, 0] > 0, lambda y: y @ y, lambda y: y, x),
    ],
)
def test_what_calls_a_library_is_left_as_it_is(unfit: Callable[[Array], Array]) -> None:
    x = np.arange(9, dtype=np.float32).reshape(3, 3)
    assert kernels(one_kernel(unfit), x) == 0
    np.testing.assert_allclose(in_kernels(one_kernel(unfit))(x), jax.jit(unfit)(x), rtol=1e-6)


@tried
def test_what_a_kernel_does_not_use_does_no_harm_in_a_loop() -> None:
    def half(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        return state[0] * 0.5, state[1], state[2]  # the others pass

    def first(state: tuple[Array, Array, Array]) -> Array:
        return jnp.sqrt(state[0] + 1)  # the others are not used at all

    def unused(x: Array, other: Array) -> Array:  # left as it is
        return x

    def loop(x: Array, y: Array, flag: Array) -> tuple[Array, Array]:
        def step(state: tuple[Array, ...]) -> tuple[Array, ...]:
            return one_kernel(half)(handed_on(state))

        end = lax.while_loop(lambda s: s[0].max() > 1, step, (x, y, flag))
        return one_kernel(unused)(end[1], y), one_kernel(first)(end)

    x, y = np.full(4, 16, np.float32), np.arange(3, dtype=np.int32)
    assert kernels(loop, x, y, np.array(True)) == 2
    passed, root = in_kernels(loop)(x, y, np.array(True))
    np.testing.assert_array_equal(passed, y)
    np.testing.assert_allclose(root, np.sqrt(2), rtol=1e-6)


@tried
@pytest.mark.parametrize("hand", ["mimic_p050", "inspire_hand"])
def test_smooth_is_the_same_with_and_without_kernels(hand: str) -> None:
    frames = list(SyntheticOperator(seed=5).record(0.6))
    usual, queued = Retargeter(hand), Retargeter(hand, config=QueuedSmooth.default())
    pairs = [(usual(frame), queued(frame)) for frame in frames]
    apart = [a.command.positions - b.command.positions for a, b in pairs]
    assert np.abs(apart).max() < 5e-3  # rad: a Newton step more or less
    assert [a.status for a, _ in pairs] == [b.status for _, b in pairs]
