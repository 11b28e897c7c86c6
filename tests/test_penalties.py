"""Penalties of Eq. (1) and their derivatives, against plain NumPy and automatic differentiation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trees import float64

from smooth_operator import load_hand
from smooth_operator.baselines.ako import AkoObjectiveConfig, NormKeyvectors
from smooth_operator.errors import ConfigError
from smooth_operator.retargeting.objective import FrameGoal, Keyvectors, Objective
from smooth_operator.retargeting.sbr.published import KEYVECTORS, ObjectiveConfig
from smooth_operator.retargeting.targets import KeyvectorLayout

TRANSITION = 0.02


def errors() -> tuple[np.ndarray, np.ndarray]:
    """Six errors, some beyond the transition, and weights."""
    rng = np.random.default_rng(0)
    return rng.normal(size=(6, 3)) * 0.004 * 2.0 ** np.arange(6)[:, None], rng.uniform(0.5, 10, 6)


TERMS: dict[str, type[Keyvectors]] = {**KEYVECTORS, "smooth_l1_norm": NormKeyvectors}


def written_out(error: np.ndarray, weight: float, loss: str) -> float:
    def smooth_l1(x: float) -> float:
        return x**2 / (2 * TRANSITION) if abs(x) < TRANSITION else abs(x) - TRANSITION / 2

    if loss == "squared":
        return float(weight * (error**2).sum())
    if loss == "smooth_l1":
        return float(weight * sum(map(smooth_l1, error)))
    return smooth_l1(float(weight * np.linalg.norm(error)))


def keyvectors(loss: str) -> Keyvectors:
    return TERMS[loss](KeyvectorLayout(load_hand().fingers), TRANSITION)


@pytest.mark.parametrize("loss", TERMS)
def test_price_and_slopes(loss):
    with float64():
        vectors, weights = map(jnp.asarray, errors())

        term = keyvectors(loss)
        goal = FrameGoal(vectors, weights, np.zeros(0), 0.0)

        def price(e: jax.Array, weight: jax.Array) -> jax.Array:
            return term.price([e[0], e[1], e[2]], weight)

        prices = jax.jit(jax.vmap(price))(vectors, weights)
        expected = [written_out(e, w, loss) for e, w in zip(*errors(), strict=True)]
        np.testing.assert_allclose(prices, expected, rtol=1e-6)
        cost, force, bend = jax.jit(lambda v: term.slopes(v, goal))(vectors)
        np.testing.assert_allclose(cost, prices.sum())
        slopes = jax.jit(jax.vmap(jax.grad(price)))(vectors, weights)
        np.testing.assert_allclose(force, slopes, rtol=1e-9)
        full = bend if bend.ndim == 3 else np.asarray(bend)[..., None] * np.eye(3)
        second = jax.jit(jax.vmap(jax.hessian(price)))(vectors, weights)
        np.testing.assert_allclose(full, second, rtol=1e-9, atol=1e-9)


def test_a_vector_at_its_target_has_no_force_and_the_curvature_of_the_parabola():
    goal = FrameGoal(np.zeros((1, 3)), jnp.ones(1), np.zeros(0), 0.0)
    _, force, bend = keyvectors("smooth_l1").slopes(jnp.zeros((1, 3)), goal)
    np.testing.assert_array_equal(force, 0.0)
    np.testing.assert_allclose(bend, 1 / TRANSITION)


def test_the_length_of_an_error_counts_and_not_its_components():
    """3, 4 and 5 mm: with components of their own, the parts would add up to 7."""
    error = [jnp.asarray(0.03), jnp.asarray(0.04), jnp.asarray(0.0)]
    price = keyvectors("smooth_l1_norm").price(error, jnp.asarray(2.0))
    assert float(price) == pytest.approx(2 * 0.05 - TRANSITION / 2, rel=1e-5)


@pytest.mark.parametrize("centre", ["neutral", "zero"])
@pytest.mark.parametrize("velocity", ["squared", "smooth_l1"])
def test_regularisation(centre, velocity):
    hand = load_hand()
    kind = AkoObjectiveConfig if velocity == "smooth_l1" else ObjectiveConfig
    config = kind(pose_centre=centre)
    objective = Objective(hand, config)
    rng = np.random.default_rng(1)
    q = rng.uniform(*hand.limits.T)
    before = q + rng.normal(size=len(q)) * 0.4  # beyond 0.2 rad smooth-L1 of 0.1 dq is linear
    pose = ((q - (hand.neutral if centre == "neutral" else 0)) ** 2).sum()
    change, size = 0.1 * (q - before) ** 2, np.abs(q - before)
    if velocity == "smooth_l1":
        change = np.where(size < 0.2, 0.25 * size**2, 0.1 * size - 0.01)
        assert 0 < (size < 0.2).sum() < len(q)
    expected = 0.05 * pose + change.sum()
    goal = FrameGoal(np.zeros((0, 3)), np.zeros(0), before, 0.1)
    assert objective.regularisation(q, goal).cost == pytest.approx(expected, rel=1e-9)
    with float64():
        at, goal = jnp.asarray(q), goal._replace(previous=jnp.asarray(before))

        def cost(x: jax.Array) -> jax.Array:
            return objective.regularisation(x, goal).cost

        _, slope, bend = jax.jit(lambda x: objective.regularisation(x, goal))(at)
        np.testing.assert_allclose(slope, jax.jit(jax.grad(cost))(at), rtol=1e-9)
        second = jax.jit(jax.hessian(cost))(at)
        np.testing.assert_allclose(bend * np.eye(len(q)), second, rtol=1e-9, atol=1e-12)


def test_unknown_words_are_refused():
    with pytest.raises(ConfigError, match="'smooth_l1' or 'squared', not 'l2'"):
        ObjectiveConfig(loss="l2")
    with pytest.raises(ConfigError, match="'neutral' or 'zero', not 'middle'"):
        ObjectiveConfig(pose_centre="middle")
