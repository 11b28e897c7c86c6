"""The largest few of many numbers, against sorting."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smooth_operator.retargeting.sbr.sampling import largest

RNG = np.random.default_rng(5)
MANY, FEW = 4096, 48
USUAL = RNG.gamma(8.0, size=MANY)
ONE_COLUMN = np.where(np.arange(MANY) % (MANY // 32) < 3, 1e3 + USUAL, USUAL)


@pytest.fixture(scope="module")
def found_by() -> Callable[[np.ndarray], list[np.ndarray]]:
    run = jax.jit(lambda values: largest(values, FEW))
    return lambda values: [np.asarray(part) for part in run(jnp.asarray(values, jnp.float32))]


@pytest.mark.parametrize(
    "values",
    [
        USUAL,
        -USUAL,
        np.sort(USUAL),
        np.sort(USUAL)[::-1],
        ONE_COLUMN,  # more than the places for them are above the least of the best maxima
        np.zeros(MANY),
        np.round(USUAL),  # many equal ones
        np.where(np.arange(MANY) < FEW - 5, USUAL, -np.inf),
        np.where(np.arange(MANY) == 7, -np.inf, USUAL),
    ],
)
def test_they_are_the_largest(found_by, values):
    values = values.astype(np.float32)
    best, index = found_by(values)
    np.testing.assert_array_equal(best, np.sort(values)[::-1][:FEW])
    np.testing.assert_array_equal(values[index], best)
    assert len(set(index.tolist())) == FEW


@pytest.mark.parametrize("count", [1000, 4096])
def test_numbers_without_columns_enough(count):
    values = USUAL[:count].astype(np.float32)
    best, index = largest(jnp.asarray(values), 100)
    np.testing.assert_array_equal(best, np.sort(values)[::-1][:100])
    np.testing.assert_array_equal(values[np.asarray(index)], best)
