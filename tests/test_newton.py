"""The projected Newton polish against bounded reference solvers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import lsq_linear
from trees import float64

from smooth_operator.retargeting.sbr.newton import NewtonConfig, newton_minimise


def expansion(cost):
    """Cost, gradient and Hessian, by automatic differentiation."""
    return lambda q: (cost(q), jax.grad(cost)(q), jax.hessian(cost)(q))


def solve(cost, start, limits, config=NewtonConfig(iterations=20)):  # noqa: B008
    """The point found; the cost that comes with it is checked here."""
    with float64():
        run = jax.jit(lambda start: newton_minimise(expansion(cost), start, limits, config))
        found, value, gradient = run(jnp.asarray(start, jnp.float64))
        if np.isfinite(value):
            np.testing.assert_allclose(value, cost(found), rtol=1e-12)
            slope = jax.jit(jax.grad(cost))(found)
            np.testing.assert_allclose(gradient, slope, rtol=1e-9, atol=1e-12)
        return np.asarray(found)


@pytest.mark.parametrize("seed", range(3))
def test_a_convex_quadratic_within_bounds(seed):
    rng = np.random.default_rng(seed)
    matrix, goal = rng.standard_normal((8, 6)), rng.standard_normal(8)
    limits = np.sort(rng.uniform(-1.0, 1.2, (6, 2)), axis=1)
    reference = lsq_linear(matrix, goal, limits.T, tol=1e-14)
    found = solve(lambda q: ((matrix @ q - goal) ** 2).sum(), limits.mean(axis=1), limits)
    assert 0 < (reference.active_mask != 0).sum() < 6  # some limits bind, some do not
    np.testing.assert_allclose(found, reference.x, atol=1e-7)


def wavy(q):
    return (jnp.cos(3 * q) * jnp.array([1.0, 2.0, 0.5])).sum() + 0.1 * (q**2).sum()


def test_it_never_rises_not_even_where_the_hessian_is_indefinite():
    rng = np.random.default_rng(5)
    limits = np.tile([-2.0, 2.0], (3, 1))
    with float64():
        config = NewtonConfig(iterations=1, damping=(0.0, 1.0, 20.0))
        step = jax.jit(lambda start: newton_minimise(expansion(wavy), start, limits, config)[0])
        curvature = jax.jit(jax.hessian(wavy))
        descended = 0
        for start in rng.uniform(-2, 2, (50, 3)):
            indefinite = np.linalg.eigvalsh(curvature(start)).min() < 0
            q, costs = start, [float(wavy(start))]
            for _ in range(8):
                q = np.asarray(step(q))
                costs.append(float(wavy(q)))
            assert (np.diff(costs) <= 0).all()
            assert (abs(q) <= 2).all()
            descended += indefinite and costs[-1] < costs[0] - 0.1
        assert descended > 10


def test_a_start_from_which_no_step_descends_is_kept():
    """An undamped step from a hilltop goes nowhere, and a Hessian without a factor gives none."""
    limits = np.tile([-1.0, 1.0], (2, 1))
    start = np.array([0.3, -0.2])
    found = solve(lambda q: -(q**2).sum(), start, limits, NewtonConfig(3, (0.0,)))
    np.testing.assert_array_equal(found, start)
    found = solve(lambda q: jnp.nan * q.sum(), start, limits)
    np.testing.assert_array_equal(found, start)
