"""SLSQP on functions whose minima are known, and its ways to stop."""

import numpy as np
import pytest

from smooth_operator.baselines.slsqp_method import SlsqpConfig, slsqp_minimise
from smooth_operator.errors import ConfigError

WIDE = np.tile([-3.0, 3.0], (4, 1))
CENTRE = np.array([0.5, -1.0, 2.0, 0.0])
TIGHT = SlsqpConfig(tolerance=1e-12, max_iterations=200)


def bowl(x: np.ndarray) -> np.ndarray:
    stiffness = np.array([1.0, 4.0, 9.0, 30.0])
    return np.concatenate([[(stiffness * (x - CENTRE) ** 2).sum()], 2 * stiffness * (x - CENTRE)])


def rosenbrock(x: np.ndarray) -> np.ndarray:
    a, b = x
    value = (1 - a) ** 2 + 100 * (b - a * a) ** 2
    return np.array([value, -2 * (1 - a) - 400 * a * (b - a * a), 200 * (b - a * a)])


def test_minimum_of_a_quadratic():
    result = slsqp_minimise(bowl, np.full(4, 2.5), WIDE, TIGHT)
    np.testing.assert_allclose(result.x, CENTRE, atol=1e-5)
    assert result.value < 1e-9


def test_active_bounds_hold_exactly():
    limits = np.array([[1.0, 2.0], [-3.0, -2.0], [-1.0, 1.0], [0.25, 3.0]])  # none holds the centre
    result = slsqp_minimise(bowl, np.zeros(4), limits, TIGHT)
    np.testing.assert_allclose(result.x, [1.0, -2.0, 1.0, 0.25], atol=1e-9)
    assert (result.x >= limits[:, 0]).all()
    assert (result.x <= limits[:, 1]).all()


def test_a_start_outside_the_bounds_is_brought_in():
    points: list[np.ndarray] = []

    def watched(x: np.ndarray) -> np.ndarray:
        points.append(x.copy())
        return bowl(x)

    slsqp_minimise(watched, np.full(4, 99.0), WIDE, SlsqpConfig())
    np.testing.assert_array_equal(points[0], np.full(4, 3.0))


def test_the_limit_of_iterations_ends_the_search_short_of_the_minimum():
    start = np.array([-1.2, 1.0])
    few = slsqp_minimise(rosenbrock, start, WIDE[:2], SlsqpConfig(max_iterations=3))
    assert 0.1 < few.value < rosenbrock(start)[0]
    assert few.value == rosenbrock(few.x)[0]  # the value is that of the answer
    many = slsqp_minimise(rosenbrock, start, WIDE[:2], TIGHT)
    assert many.evaluations > few.evaluations
    np.testing.assert_allclose(many.x, [1, 1], atol=1e-4)


def test_an_objective_that_is_nowhere_finite_gives_nan():
    result = slsqp_minimise(lambda x: np.full(5, np.nan), np.zeros(4), WIDE, SlsqpConfig())
    assert np.isnan(result.value)


@pytest.mark.parametrize("changes", [{"tolerance": 0.0}, {"max_iterations": 0}])
def test_a_bad_configuration_is_refused(changes):
    with pytest.raises(ConfigError, match=f"{next(iter(changes))} must be positive"):
        SlsqpConfig(**changes)
