"""Demonstrations as rows of a data set: what was recorded does the task in the environment, too."""

from pathlib import Path

import numpy as np
import pytest

from smooth_operator_research.demonstrations.perturbation import draw_perturbation

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def paths(monkeypatch) -> None:
    pytest.importorskip("gymnasium", reason="gymnasium is not installed")
    monkeypatch.syspath_prepend(str(ROOT / "packages" / "lerobot_env_smooth_hand"))
    monkeypatch.syspath_prepend(str(ROOT / "research" / "benchmarks"))


@pytest.mark.parametrize(
    ("task", "number"), [("card", 0), pytest.param("cube", 1, marks=pytest.mark.weekly)]
)
def test_recorded_actions_do_the_task_in_the_environment(task, number):
    """At a quarter of the rate, from the start pose, in the same world."""
    import policy_loop
    from lerobot_env_smooth_hand import HandTask

    trial = policy_loop.trial_in_world(task, "mimic_p050", "smooth", number - 1)
    assert trial.success
    assert len(trial.action) == len(trial.state) == len(trial.environment)
    world = draw_perturbation(number)
    environment = HandTask(task=task, variation=0.0, start=trial.state[0].tolist())
    environment._scene = world.scene(environment._scene)
    seen, _ = environment.reset(seed=0)
    world.prepare(environment._physics)
    apart = []
    for state, place, action in zip(trial.state, trial.environment, trial.action, strict=True):
        apart.append(np.abs(seen["agent_pos"] - state).mean())
        if len(apart) == 1:
            np.testing.assert_allclose(seen["environment_state"], place, atol=5e-3)
        seen, reward, done, _, info = environment.step(action.astype(np.float32))
        if done:
            break
    assert np.mean(apart) < 0.05  # [rad]; it begins a little later, at another phase
    for _ in range(50):  # a grip that swings is held for long enough a little later
        if done:
            break
        seen, reward, done, _, info = environment.step(trial.action[-1].astype(np.float32))
    assert (reward, info["is_success"]) == (1.0, True), info


def test_intervals_are_of_seeds_and_worlds():
    import policy_loop as loop

    success = np.array([[1.0] * 50 + [0.0] * 50] * 3)  # seeds agree: the worlds alone differ
    low, high = loop.interval(loop.resampled(success), 0.5, 100)
    assert low == pytest.approx(0.40, abs=0.02)  # binomial, 100 worlds
    assert high == pytest.approx(0.60, abs=0.02)
    seeds = np.array([[1.0] * 100, [0.0] * 100, [0.5] * 100])
    assert loop.interval(loop.resampled(seeds), 0.5, 100) == (
        pytest.approx(0.0, abs=0.01),
        pytest.approx(1.0, abs=0.01),
    )
    none = loop.interval(loop.resampled(np.zeros((3, 100))), 0.0, 100)
    assert none == (0.0, pytest.approx(0.037, abs=0.001))  # Wilson's, of 0 in 100
    assert loop.share_of_worlds([1, 1]) == (1.0, pytest.approx(0.342, abs=0.001), 1.0)
    low, high = loop.interval_of_difference(np.zeros(9), (0.0, 0.0, 0.04), (0.0, 0.0, 0.04))
    assert (low, high) == (pytest.approx(-0.04), pytest.approx(0.04))
