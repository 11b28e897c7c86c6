"""Algorithm 1 on functions whose minima are known, and the normals that it draws."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from smooth_operator.retargeting.sbr.random_numbers import (
    counter_normal_matrix,
    counter_normals,
    frame_key,
    random_words,
    seed_words,
)
from smooth_operator.retargeting.sbr.sampling import SamplingConfig, quasi_normals, sample_minimise

# Many elites: with few, the covariance (about the new mean) collapses before the mean arrives.
SMALL = SamplingConfig(samples=2048, elites=512, cycles=15, sigma=0.3)
KEY = np.array([7, 11], np.uint32)


def bowl(centre, stiffness=1.0):
    """A quadratic with a known minimum."""
    weights = np.broadcast_to(stiffness, len(centre))
    return lambda q: sum(w * (x - c) ** 2 for x, c, w in zip(q, centre, weights, strict=True))


def minimise(cost, start, limits, config=SMALL, key=KEY) -> np.ndarray:
    run = jax.jit(lambda s, k: sample_minimise(cost, s, np.asarray(limits, float), k, config))
    return np.asarray(run(jnp.asarray(start, jnp.float32), jnp.asarray(key)))


def test_one_cycle_returns_the_start_within_the_limits():
    config = replace(SMALL, cycles=1)
    limits = [[-1, 1], [0.5, 1.0], [-1, -0.5]]
    found = minimise(bowl([0.3] * 3), [0.25, 0.0, 0.0], limits, config)
    np.testing.assert_array_equal(found, np.float32([0.25, 0.5, -0.5]))


def test_the_key_decides_fresh_draws_and_nothing_else():
    cost, limits = bowl([0.3, -0.2]), [[-1, 1]] * 2
    short = replace(SMALL, cycles=4)
    first, again, other = (
        minimise(cost, [0, 0], limits, short, key) for key in (KEY, KEY, KEY + 1)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()
    fixed = replace(short, draws="quasi")
    one, two = (minimise(cost, [0, 0], limits, fixed, key) for key in (KEY, KEY + 1))
    np.testing.assert_array_equal(one, two)


def algorithm_1(cost, start, limits, config: SamplingConfig, draw) -> np.ndarray:
    """The paper's Algorithm 1, line by line, in float64; ``draw`` gives the normals of a cycle."""
    low, high = np.transpose(limits)
    mean = np.array(start, float)  # 1
    cov = config.sigma**2 * np.eye(len(start)) + config.jitter * np.eye(len(start))  # 2
    for cycle in range(1, config.cycles + 1):  # 3
        normals = draw(cycle)  # (m, N)
        candidates = mean[:, None] + np.linalg.cholesky(cov) @ normals
        candidates = np.clip(candidates, low[:, None], high[:, None])  # 4
        costs = cost(candidates)  # 5
        if cycle < config.cycles:  # 6
            elites = np.argsort(costs)[: config.elites]  # 7
            weights = np.exp(-(costs[elites] - costs[elites].min()) / config.temperature)  # 8
            weights /= weights.sum()  # 9
            chosen = candidates[:, elites]
            mean = chosen @ weights  # 10
            spread = chosen - mean[:, None]
            cov = (spread * weights) @ spread.T + config.jitter * np.eye(len(mean))  # 11
    return np.clip(mean, low, high)  # 14


@pytest.mark.parametrize("draws", ["fresh", "quasi"])
def test_it_is_algorithm_1_to_the_letter(draws):
    config = SamplingConfig(samples=300, elites=20, cycles=4, temperature=0.05, draws=draws)
    cost, start = bowl([0.3, -0.5, 0.1], [1, 2, 0.5]), [0.1, -0.1, 0.0]
    limits = np.array([[-0.2, 0.25], [-0.6, 0.4], [-1, 1]])
    words = random_words(jnp.asarray(KEY), config.cycles - 1)

    def normals_of(cycle: int) -> np.ndarray:
        if draws == "quasi":
            return quasi_normals(3, config.samples)
        if cycle == config.cycles:  # its draw is never read
            return np.zeros((3, config.samples))
        rows = counter_normals(jnp.arange(config.samples, dtype=jnp.uint32), words[cycle - 1], 3)
        return np.asarray(rows, float)

    expected = algorithm_1(cost, start, limits, config, normals_of)
    found = minimise(cost, start, limits, config)
    np.testing.assert_allclose(found, expected, atol=2e-5)
    assert found[0] < 0.25  # clipped candidates took part in the mean
    assert np.linalg.norm(expected - start) > 0.1


def test_the_defaults_are_the_papers_table():
    config = SamplingConfig()
    assert (config.samples, config.elites, config.cycles) == (8192, 128, 20)
    assert (config.sigma, config.temperature, config.jitter) == (0.2, 0.1, 1e-6)
    assert config.draws == "fresh"


COLUMNS = 8


@pytest.fixture(scope="module")
def normals() -> np.ndarray:
    """(frames, cycles, columns, candidates): 8 x 4 x 8 x 4096, a million draws, as in a run."""
    index = jnp.arange(4096, dtype=jnp.uint32)
    seed = jnp.asarray(seed_words(0))

    @jax.jit
    def frame(count: jax.Array) -> jax.Array:
        words = random_words(frame_key(seed, count), 4)
        return jnp.stack([jnp.stack(counter_normals(index, w, COLUMNS)) for w in words])

    return np.stack([np.asarray(frame(jnp.uint32(i)), float) for i in range(8)])


def test_normals_are_normal(normals):
    flat = normals.ravel()
    count = flat.size
    assert count >= 1_000_000
    # each bound is 4.5 standard errors; the seed is fixed, so that this either holds or does not
    assert abs(flat.mean()) < 4.5 / np.sqrt(count)
    assert abs(flat.var() - 1) < 4.5 * np.sqrt(2 / count)
    assert abs(stats.skew(flat)) < 4.5 * np.sqrt(6 / count)
    assert abs(stats.kurtosis(flat)) < 4.5 * np.sqrt(24 / count)
    assert stats.kstest(flat, "norm").pvalue > 1e-3
    assert 4.5 < abs(flat).max() < 6.5
    for column in range(COLUMNS):  # the cosine halves and the sine halves
        assert stats.kstest(normals[:, :, column].ravel(), "norm").pvalue > 1e-4


def test_normals_do_not_correlate(normals):
    def largest(rows: np.ndarray) -> float:
        correlation = np.corrcoef(rows) - np.eye(len(rows))
        return float(abs(correlation).max() * np.sqrt(rows.shape[1]))

    by_column = normals.transpose(2, 0, 1, 3).reshape(COLUMNS, -1)
    by_cycle = normals.transpose(1, 0, 2, 3).reshape(4, -1)
    by_frame = normals.reshape(8, -1)
    by_everything = normals.reshape(-1, 4096)
    assert largest(by_column) < 4
    assert largest(by_cycle) < 4
    assert largest(by_frame) < 4
    assert largest(by_everything) < 6  # of 32,640 pairs
    assert largest(by_column**2) < 4  # nor do their sizes, which a bad radius would share
    neighbours = np.stack([by_everything[:, :-1].ravel(), by_everything[:, 1:].ravel()])
    assert largest(neighbours) < 4  # nor one candidate with the next


def test_frame_keys_do_not_repeat():
    counts = jnp.arange(200_000, dtype=jnp.uint32)
    keys_of = jax.jit(jax.vmap(frame_key, (None, 0)))
    keys = np.asarray(keys_of(jnp.asarray(seed_words(3)), counts))
    assert len(np.unique(keys, axis=0)) == len(keys)
    other = np.asarray(keys_of(jnp.asarray(seed_words(4)), counts))
    assert len(np.unique(np.concatenate([keys, other]), axis=0)) == 2 * len(keys)
    bits = np.unpackbits(keys.view(np.uint8), axis=1).mean(axis=0)
    assert abs(bits - 0.5).max() < 0.01
    flips = np.unpackbits((keys[1:] ^ keys[:-1]).view(np.uint8), axis=1).mean(axis=0)
    assert abs(flips - 0.5).max() < 0.01  # neighbours share nothing


@pytest.mark.parametrize("count", [1, 2, 5, 16])
def test_the_matrix_holds_the_same_normals(count):
    index = jnp.asarray([0, 5, 4095, 2**20, 17], jnp.uint32)
    words = jnp.asarray([123, 2**32 - 5], jnp.uint32)
    rows_of = jax.jit(counter_normals, static_argnums=2)
    rows = rows_of(index, words, count)
    matrix = jax.jit(counter_normal_matrix, static_argnums=2)(index, words, count)
    assert matrix.shape == (count, 5)
    np.testing.assert_allclose(np.stack(rows), matrix, atol=5e-7)  # one may fuse, one not
    alone = rows_of(index[1:2], words, count)  # a function of the index, not of its place
    np.testing.assert_allclose(np.stack(alone)[:, 0], np.stack(rows)[:, 1], atol=5e-7)


def test_quasi_normals():
    base = quasi_normals(16, 1024)
    assert base.shape == (16, 1024)
    assert base.dtype == np.float32
    assert np.isfinite(base).all()
    np.testing.assert_array_equal(base, quasi_normals(16, 1024))
    # with no direction preferred: the same set serves every frame, and a lean would last
    np.testing.assert_allclose(base.mean(axis=1), 0, atol=1e-5)
    np.testing.assert_allclose(base @ base.T / 1024, np.eye(16), atol=1e-5)
    assert quasi_normals(3, 100).shape == (3, 100)  # not a power of two
