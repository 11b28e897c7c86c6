"""DexPilot, keyvector, AKO and hybrid: what each minimises, and how all of them answer."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from smooth_operator import HandSpec, Retargeter, Status, method_config
from smooth_operator.baselines import slsqp_method
from smooth_operator.baselines.ako import AkoTargets, PinchLayout
from smooth_operator.baselines.slsqp_method import (
    SlsqpConfig,
    SlsqpMethod,
    SlsqpMethodConfig,
    slsqp_minimise,
)
from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.synthetic import SyntheticOperator

METHODS = ("keyvector", "hybrid", "dexpilot", "ako")
FINGERS = ("thumb", "index", "middle", "ring", "pinky")


@pytest.fixture(
    scope="module",
    # ``hybrid`` has the vectors of ``keyvector``
    params=[pytest.param(m, marks=[pytest.mark.weekly] * (m == "hybrid")) for m in METHODS],
)
def retargeter(request, hand) -> Retargeter:
    built = Retargeter(hand, method=request.param, preset="fast", rate=100.0)
    built.warm_up()
    return built


def posed(hand: Hand, share: float) -> np.ndarray:
    """Landmarks of a human hand that is the robot's own, some way from neutral to its far limit."""
    q = hand.neutral + share * (hand.limits[:, 1] - hand.neutral)
    at = dict(zip(hand.tree.names, hand.landmark_positions(q), strict=True))
    from smooth_operator.landmarks import LANDMARKS

    return np.stack([at.get(name, hand.wrist) for name in LANDMARKS])


def ako_vectors(gaps: list[float]) -> np.ndarray:
    vectors = np.zeros((14, 3))
    vectors[:5, 0] = 0.1
    vectors[5:9, 1] = gaps
    vectors[9:, 2] = 0.02
    return vectors


def test_ako_pinch_target_closes_below_10_mm_and_is_the_humans_above_20():
    human = jnp.asarray(ako_vectors([0.005, 0.01, 0.015, 0.03]), jnp.float32)
    targets, _ = AkoTargets()((), PinchLayout(FINGERS), human)
    lengths = np.linalg.norm(targets.vectors[5:9], axis=1)
    np.testing.assert_allclose(lengths, [0.0, 0.0, 0.01, 0.03], atol=1e-7)  # 2 (15 - 10) mm = 10
    np.testing.assert_array_equal(targets.vectors[:5], human[:5])


def test_ako_switches_between_wrist_and_pinch_at_20_mm():
    """Each pinch vector by its own distance, all wrist vectors by the nearest finger."""
    human = jnp.asarray(ako_vectors([0.02, 0.005, 0.12, 0.02]), jnp.float32)
    weights = np.asarray(AkoTargets()((), PinchLayout(FINGERS), human)[0].weights)
    s = 1 / (1 + np.exp(-10 * (np.array([0.02, 0.005, 0.12, 0.02]) - 0.02)))
    np.testing.assert_allclose(weights[:5], np.array([10, 1, 1, 1, 1]) * s[1], rtol=1e-6)
    np.testing.assert_allclose(weights[5:9], 10 * (1 - s), rtol=1e-6)
    np.testing.assert_allclose(weights[9:], 10)


def test_ako_refuses_a_hand_without_last_joints(hand):
    spec = hand.spec
    stub = dataclasses.replace(
        spec.fingers[1], points=(spec.fingers[1].points[0], None, None, spec.fingers[1].points[3])
    )
    poor: HandSpec = dataclasses.replace(
        spec, name="poor", fingers=(spec.fingers[0], stub, *spec.fingers[2:])
    )
    with pytest.raises(ConfigError, match=r"AkoTargets needs .*index_dip.*'poor'"):
        Retargeter(poor, method="ako")
    Retargeter(poor, method="dexpilot")  # asks for tips only


def test_commands_stay_within_limits_and_bad_frames_hold(hand, retargeter):
    recording = SyntheticOperator(seed=4, rate_hz=30.0).record(2.0)
    landmarks = recording.landmarks.copy()
    landmarks[10:13, 8] = np.nan
    landmarks[20, [1, 5, 17]] = 0.0  # a palm that is a point
    state, held = retargeter.init(), []
    for i, points in enumerate(landmarks):
        before = state
        state, result = retargeter.step(state, points)
        low, high = hand.joint_limits.T
        assert (result.command.joint_positions >= low - 1e-9).all()
        assert (result.command.joint_positions <= high + 1e-9).all()
        if result.status != Status.OK:
            held.append(i)
            assert state.words is before.words  # nothing of the frame is remembered
    assert held == [10, 11, 12, 20]


def test_dexpilots_latch_lives_in_the_state_and_resets(hand):
    """Human thumb-to-index distances of 25, 40 and 60 mm: closes under 30, opens above 50."""
    retargeter = Retargeter(hand, method="dexpilot", rate=100.0)
    assert isinstance(retargeter.method, SlsqpMethod)
    neutral = posed(hand, 0.0)

    def frame(gap: float) -> np.ndarray:
        points = neutral.copy()
        away = points[8] - points[4]
        points[8] = points[4] + away / np.linalg.norm(away) * gap
        return points

    state = retargeter.init()
    seen = []
    for gap in (0.06, 0.04, 0.025, 0.04, 0.06, 0.04):
        state, _ = retargeter.step(state, frame(gap))
        seen.append(bool(state.method.targets.latched[0]))
    assert seen == [False, False, True, True, False, False]
    state, _ = retargeter.step(retargeter.init(), frame(0.025))
    assert state.method.targets.latched[0]
    assert not retargeter.init().method.targets.latched.any()


@pytest.mark.parametrize(
    "name",
    [
        "ako",
        *(pytest.param(name, marks=pytest.mark.weekly) for name in METHODS if name != "ako"),
    ],
)
def test_fast_finds_the_minima_of_the_published_objective_in_fewer_evaluations(
    hand, name, monkeypatch
):
    """Against SLSQP alone without the published limit of 20 iterations."""
    evaluations: list[int] = []

    def counted(*arguments: Any) -> slsqp_method.SlsqpResult:
        result = slsqp_minimise(*arguments)
        evaluations.append(result.evaluations)
        return result

    monkeypatch.setattr(slsqp_method, "slsqp_minimise", counted)
    published, fast = method_config(name, "published"), method_config(name, "fast")
    assert isinstance(published, SlsqpMethodConfig)
    assert isinstance(fast, SlsqpMethodConfig)
    assert fast.objective == published.objective
    assert fast.start == published.start
    alone = dataclasses.replace(published, solver=SlsqpConfig(1e-12, max_iterations=500))
    recording = SyntheticOperator(seed=3).record(0.6)
    losses, counts = [], []
    for config in (alone, fast):
        evaluations.clear()
        _, loss = Retargeter(hand, config=config).run(recording)
        losses.append(np.mean(loss))
        counts.append(sum(evaluations) / len(recording))
    assert losses[1] < 1.01 * losses[0]
    assert counts[1] < 0.7 * counts[0]


def test_a_search_stays_within_its_limits_and_its_iterations():
    def rosenbrock(x: np.ndarray) -> np.ndarray:
        a, b = x
        value = (1 - a) ** 2 + 100 * (b - a * a) ** 2
        return np.array([value, -2 * (1 - a) - 400 * a * (b - a * a), 200 * (b - a * a)])

    limits, start = np.array([[-3.0, 0.5], [-3.0, 3.0]]), np.array([-1.2, 1.0])
    few = slsqp_minimise(rosenbrock, start, limits, SlsqpConfig(max_iterations=3))
    assert few.value == rosenbrock(few.x)[0] > 1.0  # the value is that of the answer
    outside = np.array([-9.0, 1.0])
    assert (slsqp_minimise(rosenbrock, outside, limits, SlsqpConfig()).x >= limits[:, 0]).all()
    many = slsqp_minimise(rosenbrock, start, limits, SlsqpConfig(1e-12, max_iterations=200))
    assert many.evaluations > few.evaluations
    np.testing.assert_allclose(many.x, [0.5, 0.25], atol=1e-4)
    lost = slsqp_minimise(lambda x: np.full(3, np.nan), start, limits, SlsqpConfig())
    assert np.isnan(lost.value)
