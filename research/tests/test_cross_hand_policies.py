"""Policies from human recordings: what was derived does the task, and intervals are honest."""

import json
from pathlib import Path

import numpy as np
import pytest

from smooth_operator_research.cross_hand import policies
from smooth_operator_research.cross_hand.policies import Condition, Settings
from smooth_operator_research.demonstrations.demonstration import load_demonstration
from smooth_operator_research.run_report import BenchmarkError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def environment(monkeypatch):
    pytest.importorskip("gymnasium", reason="gymnasium is not installed")
    monkeypatch.syspath_prepend(str(ROOT / "packages" / "lerobot_env_smooth_hand"))
    import lerobot_env_smooth_hand

    return lerobot_env_smooth_hand


def small(folder: Path, **changes) -> Settings:
    return Settings(
        task="card",
        conditions=("mimic_p050/smooth",),
        recordings=4,
        steps=2,
        seeds=2,
        worlds=2,
        seconds=8.0,
        output=folder,
        **changes,
    )


@pytest.mark.weekly
def test_actions_of_a_recording_do_the_task_in_the_environment(environment):
    condition = Condition("mimic_p050", "smooth")
    (actions,) = policies.derive_actions("card", condition, [2000], "headset")
    env = environment.HandTask("card", fps=policies.FPS, start=actions[0].tolist())
    assert policies.play(env, actions, 2000).success


def test_an_episode_has_an_observation_before_each_action(environment):
    own = load_demonstration("card")
    actions = np.stack([own.pose(time) for time in np.arange(0.0, own.times[-1], 1 / policies.FPS)])
    env = environment.HandTask("card", fps=policies.FPS, start=actions[0].tolist())
    episode = policies.play(env, actions, 2000)
    assert episode.success
    assert len(episode.observations) == len(episode.actions) < len(actions) + policies.FPS
    np.testing.assert_allclose(episode.observations[0]["agent_pos"], actions[0], atol=0.05)
    at_rest = np.tile(actions[:1], (50, 1))
    assert not policies.play(env, at_rest, 2000).success


def test_a_human_recording_is_the_same_for_every_hand_and_differs_between_worlds():
    first, again, other = (policies.record("card", world, "headset") for world in (5, 5, 6))
    np.testing.assert_array_equal(first.recording.landmarks, again.recording.landmarks)
    count = min(len(first.recording), len(other.recording))
    assert not np.allclose(first.recording.landmarks[:count], other.recording.landmarks[:count])


def test_a_condition_is_a_hand_and_a_method():
    assert policies.condition_named("leap_hand/sbr:paper") == ("leap_hand", "sbr:paper")
    with pytest.raises(BenchmarkError, match="HAND/METHOD"):
        policies.condition_named("leap_hand")


def test_another_size_needs_another_folder(tmp_path):
    policies.claim_folder(small(tmp_path))
    policies.claim_folder(small(tmp_path))
    with pytest.raises(BenchmarkError, match="another --output"):
        policies.claim_folder(small(tmp_path, batch=3))


def test_the_interval_of_a_condition_is_over_its_seeds():
    equal = np.array([[1.0] * 50 + [0.0] * 50] * 3)
    assert policies.share_of_seeds(equal) == (0.5, *policies.wilson(50, 100))
    seeds = np.array([[1.0] * 100, [0.0] * 100, [0.5] * 100])  # Student's t covers all
    assert policies.share_of_seeds(seeds) == (0.5, 0.0, 1.0)
    near = np.array([[1.0] * k + [0.0] * (100 - k) for k in (45, 50, 55)])
    share = policies.share_of_seeds(near)
    assert share.low == pytest.approx(0.5 - 4.303 * 0.05 / np.sqrt(3), abs=1e-3)
    alone = policies.share_of_seeds(np.ones((1, 2)))
    assert alone == (1.0, pytest.approx(0.342, abs=1e-3), 1.0)  # Wilson, 2 of 2


def test_a_difference_has_newcombes_interval():
    # Newcombe 1998, table II: 56 of 70 minus 48 of 80, method 10
    first, second = (
        policies.share_of_worlds([1] * k + [0] * (n - k)) for k, n in ((48, 80), (56, 70))
    )
    assert policies.difference(first, second) == pytest.approx((0.2, 0.0524, 0.3339), abs=1e-4)


def test_the_table_shows_what_is_finished(tmp_path):
    settings = small(tmp_path)
    assert policies.table(settings).splitlines()[2].count("–") == 8
    folder = Condition("mimic_p050", "smooth").folder(settings)
    folder.mkdir(parents=True)
    (folder / "demonstrations.json").write_text(
        json.dumps({"successes": [1, 0, 1, 1], "frames": [50, 50, 100]})
    )
    (folder / "seed-0.json").write_text(json.dumps({"scores": [1.0, 0.5]}))
    cells = [cell.strip() for cell in policies.table(settings).splitlines()[2].split("|")]
    half, whole = "50 (9 to 91)", "100 (34 to 100)"
    assert cells[3:11] == ["3 of 4 (1.3)", "2.0", half, half, "–", whole, whole, "–"]


def test_the_same_seed_gives_the_same_policy(environment, tmp_path):
    pytest.importorskip("lerobot", reason="lerobot is not installed")
    settings = small(tmp_path)
    policies.main(settings)
    folder = Condition("mimic_p050", "smooth").folder(settings)
    scores = json.loads((folder / "seed-0.json").read_text())
    assert scores["scores"] == [0.0, 0.0]
    assert (folder / "policy-1" / "model.safetensors").exists()
    loss = policies.train(settings, folder, 0)[-1]
    assert loss == scores["loss"] != policies.train(settings, folder, 1)[-1]
    before = (folder / "seed-0.json").stat().st_mtime_ns
    policies.main(settings)  # a finished run does nothing again
    assert (folder / "seed-0.json").stat().st_mtime_ns == before
