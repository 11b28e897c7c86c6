"""SLSQP on functions whose minima are known, and all its ways to stop."""

import builtins
import time

import nlopt
import numpy as np
import pytest

from smooth_operator.baselines.slsqp import (
    ScipySlsqpConfig,
    SlsqpConfig,
    scipy_slsqp_minimise,
    slsqp_minimise,
)
from smooth_operator.errors import ConfigError

WIDE = np.tile([-3.0, 3.0], (4, 1))
CENTRE = np.array([0.5, -1.0, 2.0, 0.0])


def bowl(x: np.ndarray) -> np.ndarray:
    stiffness = np.array([1.0, 4.0, 9.0, 30.0])
    return np.concatenate([[(stiffness * (x - CENTRE) ** 2).sum()], 2 * stiffness * (x - CENTRE)])


def rosenbrock(x: np.ndarray) -> np.ndarray:
    a, b = x
    value = (1 - a) ** 2 + 100 * (b - a * a) ** 2
    return np.array([value, -2 * (1 - a) - 400 * a * (b - a * a), 200 * (b - a * a)])


def test_minimum_of_a_quadratic():
    found = slsqp_minimise(bowl, np.full(4, 2.5), WIDE, SlsqpConfig(tolerance=1e-12))
    np.testing.assert_allclose(found.x, CENTRE, atol=1e-5)
    assert found.value < 1e-9
    assert found.stopped_by == "tolerance"


def test_minimum_of_rosenbrocks_valley():
    found = slsqp_minimise(
        rosenbrock, np.array([-1.2, 1.0]), WIDE[:2], SlsqpConfig(tolerance=1e-14)
    )
    np.testing.assert_allclose(found.x, [1, 1], atol=1e-4)


def test_active_bounds_hold_exactly():
    limits = np.array([[1.0, 2.0], [-3.0, -2.0], [-1.0, 1.0], [0.25, 3.0]])  # none holds the centre
    found = slsqp_minimise(bowl, np.zeros(4), limits, SlsqpConfig(tolerance=1e-12))
    np.testing.assert_allclose(found.x, [1.0, -2.0, 1.0, 0.25], atol=1e-9)
    assert (found.x >= limits[:, 0]).all()
    assert (found.x <= limits[:, 1]).all()


def test_a_start_outside_the_bounds_is_brought_in():
    seen: list[np.ndarray] = []

    def watched(x: np.ndarray) -> np.ndarray:
        seen.append(x.copy())
        return bowl(x)

    slsqp_minimise(watched, np.full(4, 99.0), WIDE, SlsqpConfig())
    np.testing.assert_array_equal(seen[0], np.full(4, 3.0))


def test_a_cap_on_evaluations_gives_the_best_so_far():
    found = slsqp_minimise(
        rosenbrock, np.array([-1.2, 1.0]), WIDE[:2], SlsqpConfig(max_evaluations=6)
    )
    assert found.stopped_by == "evaluations"
    assert found.evaluations <= 7
    assert found.value <= rosenbrock(np.array([-1.2, 1.0]))[0]
    assert found.value == rosenbrock(found.x)[0]


def test_a_time_budget_is_honoured():
    def slow(x: np.ndarray) -> np.ndarray:
        time.sleep(0.02)
        return rosenbrock(x)

    config = SlsqpConfig(tolerance=1e-14, time_budget_ms=50)
    found = slsqp_minimise(slow, np.array([-1.2, 1.0]), WIDE[:2], config)
    assert found.stopped_by == "time"
    assert 1 <= found.evaluations <= 6  # it looks at the clock between evaluations
    assert np.isfinite(found.value)


def test_an_objective_that_breaks_gives_the_best_finite_point():
    calls = 0

    def breaking(x: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        return rosenbrock(x) if calls < 4 else np.full(3, np.nan)

    found = slsqp_minimise(breaking, np.array([-1.2, 1.0]), WIDE[:2], SlsqpConfig())
    assert calls == 4
    assert found.value == rosenbrock(found.x)[0]


def test_an_objective_that_is_nowhere_finite_says_so():
    found = slsqp_minimise(lambda x: np.full(5, np.nan), np.zeros(4), WIDE, SlsqpConfig())
    assert np.isnan(found.value)


def test_a_start_that_is_a_minimum_is_looked_at_once():
    found = slsqp_minimise(bowl, CENTRE, WIDE, SlsqpConfig(optimality=1e-6))
    assert (found.stopped_by, found.evaluations) == ("optimality", 1)
    np.testing.assert_array_equal(found.x, CENTRE)


def test_a_gradient_against_a_bound_does_not_count():
    limits = np.array([[1.0, 2.0], [-3.0, -2.0], [-1.0, 1.0], [0.25, 3.0]])  # none holds the centre
    corner = np.array([1.0, -2.0, 1.0, 0.25])
    config = SlsqpConfig(optimality=1e-6)
    at_once = slsqp_minimise(bowl, corner, limits, config)
    assert (at_once.stopped_by, at_once.evaluations) == ("optimality", 1)
    inside = corner + np.array([0.1, 0, 0, 0])  # one component may still go down
    found = slsqp_minimise(bowl, inside, limits, config)
    assert found.evaluations > 1
    np.testing.assert_allclose(found.x, corner, atol=1e-6)


def test_a_gradient_away_from_a_bound_counts():
    """A start in the corner from which all components go down inwards is no minimum."""
    start = np.where(bowl(WIDE[:, 0])[1:] < 0, WIDE[:, 0], WIDE[:, 1])
    found = slsqp_minimise(bowl, start, WIDE, SlsqpConfig(optimality=1e-6))
    np.testing.assert_allclose(found.x, CENTRE, atol=1e-6)


@pytest.mark.parametrize(
    "bad",
    [{"tolerance": 0.0}, {"max_evaluations": 0}, {"time_budget_ms": 0.0}, {"optimality": -1.0}],
)
def test_a_bad_configuration_is_refused(bad):
    with pytest.raises(ConfigError, match=next(iter(bad))):
        SlsqpConfig(**bad)


@pytest.mark.parametrize("name", ["RuntimeError", "RoundoffLimited", "runtime_error"])
def test_a_line_search_that_fails_gives_the_best_so_far(name, monkeypatch):
    """NLopt says so with one exception or another, by its version."""
    failure = getattr(builtins, name, None) or getattr(nlopt, name, None)
    if failure is None:
        pytest.skip(f"this NLopt has no {name}")
    optimize = nlopt.opt.optimize

    def fail(solver: nlopt.opt, start: np.ndarray) -> None:
        optimize(solver, start)
        raise failure("nlopt failure")

    monkeypatch.setattr(nlopt.opt, "optimize", fail)
    found = slsqp_minimise(bowl, np.full(4, 2.5), WIDE, SlsqpConfig())
    assert found.stopped_by == "rounding"
    np.testing.assert_allclose(found.x, CENTRE, atol=0.01)


def test_scipys_finds_the_minimum_within_bounds():
    tight = ScipySlsqpConfig(tolerance=1e-12, max_iterations=200)
    found = scipy_slsqp_minimise(bowl, np.full(4, 2.5), WIDE, tight)
    np.testing.assert_allclose(found.x, CENTRE, atol=1e-5)
    assert found.stopped_by == "tolerance"
    limits = np.array([[1.0, 2.0], [-3.0, -2.0], [-1.0, 1.0], [0.25, 3.0]])
    held = scipy_slsqp_minimise(bowl, np.zeros(4), limits, tight)
    np.testing.assert_allclose(held.x, [1.0, -2.0, 1.0, 0.25], atol=1e-9)


def test_scipys_ends_at_its_limit_of_iterations_short_of_the_minimum():
    start = np.array([-1.2, 1.0])
    few = scipy_slsqp_minimise(rosenbrock, start, WIDE[:2], ScipySlsqpConfig(max_iterations=3))
    assert few.stopped_by == "evaluations"
    assert 0.1 < few.value < rosenbrock(start)[0]
    assert few.value == rosenbrock(few.x)[0]  # the value is that of the answer
    many = scipy_slsqp_minimise(
        rosenbrock, start, WIDE[:2], ScipySlsqpConfig(tolerance=1e-12, max_iterations=100)
    )
    assert many.evaluations > few.evaluations
    np.testing.assert_allclose(many.x, [1, 1], atol=1e-4)


def test_scipys_says_that_an_objective_is_not_finite():
    found = scipy_slsqp_minimise(
        lambda x: np.full(5, np.nan), np.zeros(4), WIDE, ScipySlsqpConfig()
    )
    assert np.isnan(found.value)


@pytest.mark.parametrize("changes", [{"tolerance": 0.0}, {"max_iterations": 0}])
def test_scipys_settings_that_can_not_be(changes):
    with pytest.raises(ConfigError, match=f"{next(iter(changes))} must be positive"):
        ScipySlsqpConfig(**changes)
