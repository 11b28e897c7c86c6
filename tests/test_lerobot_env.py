"""The environment with the study's tasks: spaces, seeds, scores, limits of time."""

import shutil
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from lerobot_stand_in import ENVIRONMENT, PACKAGES, with_lerobot

from smooth_operator import load_hand
from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.poses import from_rotation_vectors, multiply
from smooth_operator.simulation.scenes import ScenePhysics
from smooth_operator.simulation.scenes.scene import OBJECT
from smooth_operator.simulation.tasks import TASKS

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed")

Make = Callable[..., Any]


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch) -> Iterator[Make]:
    monkeypatch.syspath_prepend(str(PACKAGES / ENVIRONMENT))
    from lerobot_env_smooth_hand import HandTask

    made = []

    def new(**settings: Any) -> Any:
        made.append(HandTask(**settings))
        return made[-1]

    yield new
    for environment in made:
        environment.close()


@pytest.mark.parametrize(
    ("hand", "side", "task"),
    [
        ("mimic_p050", "right", "card"),
        ("shadow_hand", "left", "cube"),
        ("leap_hand", "right", "screwdriver"),
        ("leap_hand", "right", "relocate"),
    ],
)
def test_each_task_is_an_environment_by_gymnasiums_own_check(make, hand, side, task):
    from gymnasium.utils.env_checker import check_env

    check_env(make(hand=hand, side=side, task=task), skip_render_check=True)
    made = gymnasium.make(f"smooth_hand/{task}", hand=hand, side=side)
    wrist = 6 if TASKS[task].moves_wrist else 0
    assert made.action_space.shape == (len(load_hand(hand).actuated) + wrist,)
    made.close()


def test_a_seed_repeats_a_world_and_another_one_is_another(make):
    environment = make(task="card")

    def starts(seed: int) -> np.ndarray:
        seen, _ = environment.reset(seed=seed)
        return np.concatenate([seen["agent_pos"], seen["environment_state"]])

    first = starts(1)
    np.testing.assert_array_equal(first, starts(1))
    assert np.abs(first - starts(2))[-7:].max() > 1e-4
    nominal = make(task="card", variation=0.0)
    seen = [nominal.reset(seed=seed)[0]["environment_state"] for seed in (1, 2)]
    np.testing.assert_array_equal(*seen)
    assert np.abs(first[-7:-5] - seen[0][:2]).max() <= 0.002 + 1e-6


def test_an_episode_begins_in_the_start_pose_and_follows_its_actions(make):
    hand = load_hand("mimic_p050")
    low, high = hand.limits.T
    start = 0.7 * hand.neutral + 0.3 * (low + high) / 2
    environment = make(task="screwdriver", start=start.tolist())
    seen, _ = environment.reset(seed=0)
    np.testing.assert_allclose(seen["agent_pos"], start, atol=0.05)
    for _ in range(25):
        seen, *_ = environment.step(hand.neutral.astype(np.float32))
    np.testing.assert_allclose(seen["agent_pos"], hand.neutral, atol=0.1)


def test_targets_move_linearly_from_one_action_to_the_next(make, monkeypatch):
    """A step of all targets at 25 Hz would shake an object out of the fingers."""
    environment = make(task="card", fps=25)
    environment.reset(seed=0)
    targets: list[np.ndarray] = []
    monkeypatch.setattr(
        ScenePhysics, "command", lambda self, joints: targets.append(np.array(joints))
    )
    hand = environment.hand
    middle = hand.limits.mean(axis=1)
    environment.step(middle)
    ways = np.array(targets)[:, list(hand.actuated)]
    assert len(ways) == 4
    np.testing.assert_allclose(ways[-1], middle, atol=1e-6)
    np.testing.assert_allclose(np.diff([hand.neutral, *ways], 2, axis=0), 0.0, atol=1e-6)
    environment.step(np.full(len(middle), np.nan))  # the targets stay
    np.testing.assert_allclose(targets[-1][list(hand.actuated)], ways[-1], atol=1e-6)


def test_a_moving_wrist_goes_where_the_action_says_within_its_speed(make):
    environment = make(task="relocate", hand="leap_hand")
    seen, _ = environment.reset(seed=0)
    assert seen["environment_state"].shape == (11,)
    np.testing.assert_allclose(seen["environment_state"][7:10], environment._physics.scene.target)
    np.testing.assert_allclose(seen["agent_pos"][-6:], 0.0, atol=1e-3)
    action = np.concatenate([environment.hand.neutral, [0.1, 0.0, 0.05, 0.3, -0.2, 0.1]])
    first, *_ = environment.step(action)
    assert 0.0 < np.linalg.norm(first["agent_pos"][-6:-3]) < 0.5 / 25
    for _ in range(30):
        seen, *_ = environment.step(action)
    np.testing.assert_allclose(seen["agent_pos"][-6:], action[-6:], atol=2e-3)
    action[-6:] = np.nan  # the wrist stays
    seen, *_ = environment.step(action)
    np.testing.assert_allclose(seen["agent_pos"][-6:-3], [0.1, 0.0, 0.05], atol=2e-3)


def test_fingers_that_close_feel_a_force(make):
    environment = make(task="card", tactile=True)
    seen, _ = environment.reset(seed=0)
    forces, done = [seen["tactile"]], False
    while not done and len(forces) < 50:
        seen, _, done, *_ = environment.step(environment.hand.limits[:, 1])
        forces.append(seen["tactile"])
    assert all(environment.observation_space["tactile"].contains(each) for each in forces)
    assert forces[0].shape == (len(environment.hand.fingers),)
    assert np.sum(forces[0]) < 0.5 < np.sum(forces[-1])


def test_time_is_truncated_and_a_lost_object_ends_an_episode(make):
    environment = make(task="card", seconds=0.2, fps=25)
    environment.reset(seed=0)
    rest = environment.hand.neutral.astype(np.float32)
    ends = [environment.step(rest)[1:] for _ in range(5)]
    assert [(done, late) for _, done, late, _ in ends] == [(False, False)] * 4 + [(False, True)]
    assert ends[-1][0] == 0.0
    assert ends[-1][3]["is_success"] is False
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.step(rest)

    environment = make(task="card")
    environment.reset(seed=0)
    _move_object(environment, (0.5, 0.5, 0.0))
    _, reward, done, late, info = environment.step(rest)
    assert (reward, done, late) == (0.0, True, False)
    assert info["reason"] == "the card fell"


def test_a_goal_that_is_met_is_a_success(make):
    """The cube, turned by a right angle as no hand could in an instant, and left alone."""
    environment = make(task="cube", variation=0.0)
    environment.reset(seed=0)
    physics: ScenePhysics = environment._physics
    rest = physics.positions[list(environment.hand.actuated)].astype(np.float32)
    address = physics.model.joint(OBJECT).qposadr[0]
    turn = from_rotation_vectors(np.array([0.0, 0.0, np.pi / 2]))  # about the world's z
    results = []
    for step in range(50):
        if step == 5:
            seen = physics.data.qpos[address + 3 : address + 7]
            seen[:] = multiply(turn, seen)
        results.append(environment.step(rest))
        if results[-1][2]:
            break
    _, reward, done, late, info = results[-1]
    assert (reward, done, late) == (1.0, True, False), info
    assert info["is_success"] is True
    assert sum(result[1] for result in results) == 1.0


def test_pictures_are_of_the_size_that_was_chosen(make):
    environment = make(task="cube", pictures=True, width=96, height=64, render_mode="rgb_array")
    try:
        seen, _ = environment.reset(seed=0)
    except ConfigError as error:
        pytest.skip(str(error))
    assert seen["pixels"].shape == (64, 96, 3)
    assert seen["pixels"].dtype == np.uint8
    assert np.ptp(seen["pixels"]) > 100
    _move_object(environment, (0.0, 0.0, 0.03))
    assert (environment.render() != seen["pixels"]).any()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"fps": 0}, "steps per second"),
        ({"seconds": 0.0}, "time limit"),
        ({"start": [0.0]}, "16 finite numbers"),
        ({"variation": -1.0}, "variation"),
    ],
)
def test_settings_out_of_range_are_refused(make, settings, words):
    with pytest.raises(ConfigError, match=words):
        make(**settings)
    with pytest.raises(UnknownNameError, match="card"):
        make(task="crad")


def _move_object(environment: Any, by: tuple[float, float, float]) -> None:
    physics = environment._physics
    address = physics.model.joint(OBJECT).qposadr[0]
    physics.data.qpos[address : address + 3] += by


@with_lerobot
def test_env_hub_loads_the_tasks_from_a_repository(tmp_path, monkeypatch):
    """From the cache of the Hub, in which the file lies as after a download."""
    from lerobot.envs import make_env

    monkeypatch.syspath_prepend(str(PACKAGES / ENVIRONMENT))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    repository, commit = tmp_path / "models--me--smooth_hand", "0" * 40
    (repository / "refs").mkdir(parents=True)
    (repository / "refs" / "main").write_text(commit)
    snapshot = repository / "snapshots" / commit
    snapshot.mkdir(parents=True)
    shutil.copy(PACKAGES / ENVIRONMENT / "env.py", snapshot)
    made = make_env(
        "me/smooth_hand", n_envs=2, hub_cache_dir=str(tmp_path), trust_remote_code=True
    )["smooth_hand"]
    tasks = [each.call("task") for each in made.values()]
    assert tasks == [(name, name) for name in TASKS]
    seen, _ = made[0].reset(seed=0)
    assert seen["agent_pos"].shape == (2, len(load_hand("mimic_p050").actuated))
    for each in made.values():
        each.close()
