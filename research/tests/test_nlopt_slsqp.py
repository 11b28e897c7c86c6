"""NLopt's SLSQP on functions whose minima are known, and its ways to stop."""

import builtins

import nlopt
import numpy as np
import pytest

from smooth_operator_research.paper.nlopt_slsqp import NloptConfig, nlopt_minimise

WIDE = np.tile([-3.0, 3.0], (4, 1))
CENTRE = np.array([0.5, -1.0, 2.0, 0.0])


def bowl(x: np.ndarray) -> np.ndarray:
    stiffness = np.array([1.0, 4.0, 9.0, 30.0])
    return np.concatenate([[(stiffness * (x - CENTRE) ** 2).sum()], 2 * stiffness * (x - CENTRE)])


def rosenbrock(x: np.ndarray) -> np.ndarray:
    a, b = x
    value = (1 - a) ** 2 + 100 * (b - a * a) ** 2
    return np.array([value, -2 * (1 - a) - 400 * a * (b - a * a), 200 * (b - a * a)])


def test_minimum_of_rosenbrocks_valley():
    start = np.array([-1.2, 1.0])
    result = nlopt_minimise(rosenbrock, start, WIDE[:2], NloptConfig(tolerance=1e-14))
    np.testing.assert_allclose(result.x, [1, 1], atol=1e-4)


def test_active_bounds_hold_exactly():
    limits = np.array([[1.0, 2.0], [-3.0, -2.0], [-1.0, 1.0], [0.25, 3.0]])  # none holds the centre
    result = nlopt_minimise(bowl, np.full(4, 99.0), limits, NloptConfig(tolerance=1e-12))
    np.testing.assert_allclose(result.x, [1.0, -2.0, 1.0, 0.25], atol=1e-9)
    assert (result.x >= limits[:, 0]).all()
    assert (result.x <= limits[:, 1]).all()


def test_a_limit_of_evaluations_gives_the_best_point():
    start = np.array([-1.2, 1.0])
    result = nlopt_minimise(rosenbrock, start, WIDE[:2], NloptConfig(max_evaluations=6))
    assert result.evaluations <= 7
    assert result.value == rosenbrock(result.x)[0] <= rosenbrock(start)[0]


def test_an_objective_that_breaks_gives_the_best_finite_point():
    calls = 0

    def breaking(x: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        return rosenbrock(x) if calls < 4 else np.full(3, np.nan)

    result = nlopt_minimise(breaking, np.array([-1.2, 1.0]), WIDE[:2], NloptConfig())
    assert calls == 4
    assert result.value == rosenbrock(result.x)[0]


def test_an_objective_that_is_nowhere_finite_gives_nan():
    result = nlopt_minimise(lambda x: np.full(5, np.nan), np.zeros(4), WIDE, NloptConfig())
    assert np.isnan(result.value)


@pytest.mark.parametrize("name", ["RuntimeError", "RoundoffLimited", "runtime_error"])
def test_a_failed_line_search_gives_the_best_point(name, monkeypatch):
    """NLopt raises one exception or another, depending on its version."""
    failure = getattr(builtins, name, None) or getattr(nlopt, name, None)
    if failure is None:
        pytest.skip(f"this NLopt has no {name}")
    optimize = nlopt.opt.optimize

    def fail(solver: nlopt.opt, start: np.ndarray) -> None:
        optimize(solver, start)
        raise failure("nlopt failure")

    monkeypatch.setattr(nlopt.opt, "optimize", fail)
    result = nlopt_minimise(bowl, np.full(4, 2.5), WIDE, NloptConfig())
    np.testing.assert_allclose(result.x, CENTRE, atol=0.01)
