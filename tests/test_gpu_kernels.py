"""The kernels that a GPU runs, operation by operation on a CPU."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smooth_operator import Status
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.retargeting.batching import BatchRetargeter
from smooth_operator.retargeting.sbr.gpu_kernels import (
    kernels_available,
    next_gaussian,
    solve_positive_definite,
)
from smooth_operator.retargeting.sbr.random_numbers import counter_normal_matrix, random_words
from smooth_operator.synthetic import SyntheticOperator

LIMITS = np.array([[-0.4, 0.5]])
LARGE = pytest.mark.weekly
"""An unrolled factorisation of 13 joints or more takes 10 s to compile."""
KEY = np.array([123, 456], np.uint32)
TEMPERATURE, JITTER = 0.1, 1e-6


def gaussian(costs: np.ndarray, base: np.ndarray, elites: int) -> tuple[np.ndarray, np.ndarray]:
    """The kernel's mean and Cholesky factor for fixed normals (m, n)."""
    mean, chol, _ = compiled(jnp.asarray(costs, jnp.float32), jnp.asarray(base), elites)
    return np.asarray(mean), np.asarray(chol)


@partial(jax.jit, static_argnames="elites")
def compiled(costs: jax.Array, base: jax.Array, elites: int) -> Any:
    size = len(base)
    words: Any = KEY
    return next_gaussian(
        costs,
        jnp.full(size, 0.05),
        0.3 * jnp.eye(size),
        words,
        (KEY, jnp.int32(1)),
        base,
        np.repeat(LIMITS, size, axis=0),
        elites,
        TEMPERATURE,
        JITTER,
        interpret=True,
    )


def expected(
    costs: np.ndarray, base: np.ndarray, elites: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same by NumPy, of elites that are given by their indices."""
    draws = np.clip(0.05 + 0.3 * base[:, elites].astype(float), *LIMITS[0])
    cost = costs[elites].astype(float)
    weight = np.exp((cost.min() - cost) / TEMPERATURE)
    weight /= weight.sum()
    mean = draws @ weight
    spread = (draws - mean[:, None]) * np.sqrt(weight)
    return mean, np.linalg.cholesky(spread @ spread.T + JITTER * np.eye(len(mean)))


def costs_of(kind: str, count: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    costs = rng.gamma(2.0, 0.2, count).astype(np.float32)
    if kind == "ties":
        costs = np.round(costs, 1) + np.float32(0)
    elif kind == "equal":
        costs[:] = 0.25
    elif kind == "signs":
        costs = rng.normal(size=count).astype(np.float32)
    elif kind == "infinite":
        costs[rng.random(count) < 0.9] = np.inf
    elif kind == "nan":
        costs[rng.random(count) < 0.5] = np.nan
    elif kind == "few finite":
        costs[5:] = np.inf
    elif kind == "tiny":
        costs = (costs * 1e-38).astype(np.float32)
    return costs


KINDS = ("plain", "ties", "equal", "signs", "infinite", "nan", "few finite", "tiny")


@pytest.mark.parametrize(
    ("kind", "count", "size", "elites"),
    [
        *((kind, 500, 5, 24) for kind in KINDS),
        ("plain", 8192, 3, 128),
        ("plain", 33, 1, 1),
        pytest.param("plain", 8192, 16, 128, marks=LARGE),
        pytest.param("plain", 40, 17, 40, marks=LARGE),
    ],
)
def test_the_elites_are_those_of_a_sort(kind, count, size, elites):
    costs = costs_of(kind, count)
    base = np.random.default_rng(1).normal(size=(size, count)).astype(np.float32)
    order = np.argsort(np.where(np.isnan(costs), np.inf, costs), kind="stable")
    with np.errstate(invalid="ignore"):
        mean, chol = expected(costs, base, order[:elites])
    kernel_mean, kernel_chol = gaussian(costs, base, elites)
    np.testing.assert_allclose(kernel_mean, mean, atol=1e-6)
    np.testing.assert_allclose(kernel_chol, chol, atol=1e-4)


@pytest.mark.parametrize("size", [4, 5, pytest.param(16, marks=LARGE)])
def test_fresh_normals_and_the_next_key(size):
    costs = np.random.default_rng(4).random(300).astype(np.float32)
    index = np.argsort(costs, kind="stable")[:24]
    words = random_words(jnp.asarray(KEY), 4)
    limits = np.repeat(LIMITS, size, axis=0)
    mean, chol, following = next_gaussian(
        jnp.asarray(costs),
        jnp.full(size, 0.05),
        0.3 * jnp.eye(size),
        words[1],
        (jnp.asarray(KEY), jnp.int32(2)),
        None,
        limits,
        24,
        TEMPERATURE,
        JITTER,
        interpret=True,
    )
    base = np.zeros((size, 300), np.float32)
    base[:, index] = counter_normal_matrix(jnp.asarray(index, jnp.uint32), words[1], size)
    for value, other in zip((mean, chol), expected(costs, base, index), strict=True):
        np.testing.assert_allclose(value, other, atol=2e-5)
    np.testing.assert_array_equal(following, words[2])


@pytest.mark.parametrize("size", [1, 4, 5, pytest.param(16, marks=LARGE)])
def test_small_systems_against_numpy(size):
    rng = np.random.default_rng(size)
    roots = rng.normal(size=(5, size, size))
    matrices = roots @ np.swapaxes(roots, 1, 2) + 0.1 * np.eye(size)
    right = rng.normal(size=(5, size))
    matrices[2] = -np.eye(size)  # has no Cholesky factor
    x = solve_positive_definite(
        jnp.asarray(matrices, jnp.float32), jnp.asarray(right, jnp.float32), interpret=True
    )
    assert np.isnan(x[2]).all()
    good = [0, 1, 3, 4]
    solution = np.linalg.solve(matrices[good], right[good][..., None])[..., 0]
    np.testing.assert_allclose(np.asarray(x)[good], solution, atol=5e-4, rtol=5e-4)


def test_a_cpu_takes_none_of_them():
    assert not kernels_available()


def test_arrays_are_the_objects():
    retargeter = BatchRetargeter(method="joint_angle")
    recordings = [SyntheticOperator(seed=seed).record(0.705)[:70] for seed in range(3)]
    landmarks = np.stack([r.landmarks for r in recordings])
    landmarks[1, 60:] = np.nan  # a shorter recording
    stamps = np.stack([r.stamps for r in recordings])
    arrays = retargeter.batch_arrays(landmarks, stamps, lanes=2)
    positions = retargeter.hand.full_configuration(arrays.q)
    for i, (commands, loss) in enumerate(retargeter.batch(recordings, lanes=2)):
        end = 60 if i == 1 else 70
        np.testing.assert_allclose(positions[i, :end], commands.joint_positions[:end], atol=1e-6)
        np.testing.assert_array_equal(arrays.status[i, :end], commands.status[:end])
        np.testing.assert_allclose(arrays.tracking_loss[i, :end], loss[:end], rtol=1e-6)
    assert set(arrays.status[1, 60:]) == {Status.INVALID_LANDMARKS}
    assert np.isnan(arrays.tracking_loss[1, 60:]).all()
    np.testing.assert_array_equal(arrays.q[1, 60:], np.broadcast_to(arrays.q[1, 59], (10, 16)))
    shared = retargeter.batch_arrays(landmarks, stamps[0], lanes=2)
    np.testing.assert_array_equal(shared.q[0], arrays.q[0])
    limits = retargeter.hand.limits.astype(np.float32)
    assert (arrays.q >= limits[:, 0]).all()
    assert (arrays.q <= limits[:, 1]).all()


def test_arrays_of_other_shapes_are_refused():
    retargeter = BatchRetargeter(method="joint_angle")
    landmarks = np.zeros((2, 3, 21, 3))
    with pytest.raises(RecordingError, match=r"landmarks must be \(R, T, 21, 3\)"):
        retargeter.batch_arrays(landmarks[0], np.zeros(3))
    with pytest.raises(RecordingError, match="stamps must be"):
        retargeter.batch_arrays(landmarks, np.zeros(2))
    with pytest.raises(ConfigError, match="on the host"):
        BatchRetargeter(method="keyvector").batch_arrays(landmarks, np.zeros(3))
    assert retargeter.batch_arrays(landmarks[:0], np.zeros((0, 3))).q.shape[:2] == (0, 3)
