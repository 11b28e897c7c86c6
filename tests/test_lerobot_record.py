"""Recording with the real LeRobot: our program, both plug-ins, a simulated hand, its data set.

Needs LeRobot and both plug-ins installed; CI has a job with them (``lerobot``).
"""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from free_port import free_port
from lerobot_stand_in import ROBOT, TELEOPERATOR, load_dataset, needs_lerobot, offline
from live_time import PATIENCE_S

from smooth_operator import load_hand
from smooth_operator.cli import main
from smooth_operator.poses import separation
from smooth_operator.teleop import read_log
from smooth_operator.teleop.arm.settings import read_arm

pytestmark = needs_lerobot("mink", "daqp", TELEOPERATOR, ROBOT)

FPS, SECONDS, EPISODES = 30, 3.0, 3
ADDRESS = f"tcp://127.0.0.1:{free_port()}"
TASK = "Move the fingers"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``dataset``, recorded in two runs, and ``take.mcap``, what was sent."""
    folder = tmp_path_factory.mktemp("lerobot")
    environment = offline(folder)
    # A machine that stands still for a moment must not turn into held actions: they are tested
    # elsewhere, and here each action must be a command that was sent.
    teleop = (
        "teleop --source synthetic:wrist=0.015 --hand mimic_p050 --method joint_angle --no-view"
        f" --sink zmq:{ADDRESS},valid_for_s=10 mujoco record:take.mcap"
    ).split()
    options = (
        "--robot.type=smooth_hand --robot.hand=mimic_p050 --robot.keys=all"
        " --robot.wrist=quaternion --robot.arm=panda --robot.tactile=newtons"
        f" --teleop.type=smooth_operator --teleop.address={ADDRESS} --teleop.wrist=quaternion"
        " --teleop.timeout_s=120 --dataset.repo_id=test/hand --dataset.root=dataset"
        f" --dataset.episode_time_s={SECONDS} --dataset.reset_time_s=1 --dataset.fps={FPS}"
        " --dataset.push_to_hub=false --dataset.video=false --play_sounds=false"
    ).split()
    options.append(f"--dataset.single_task={TASK}")

    def run(*more: str) -> str:
        """Run the program; returns its error, empty if there was none."""
        done = subprocess.run(
            [sys.executable, "-m", f"{TELEOPERATOR}.record", *options, *more],
            env=environment,
            cwd=folder,
            capture_output=True,
            encoding="utf-8",
            timeout=3000,
        )
        return done.stderr[-4000:] if done.returncode else ""

    with subprocess.Popen(
        [sys.executable, "-m", "smooth_operator", *teleop],
        env=environment,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
    ) as operator:
        error = run("--dataset.num_episodes=2") or run("--dataset.num_episodes=1", "--resume=true")
        operator.terminate()
        said, _ = operator.communicate(timeout=PATIENCE_S)
    assert not error, f"{error}\n{said[-2000:]}"
    return folder


def table(dataset: Any, column: str) -> np.ndarray:
    return np.asarray(dataset.hf_dataset.with_format("numpy")[:][column])


ARM = [f"arm_joint{number}.pos" for number in range(1, 8)]
HUMAN = {
    "stamp": ("float64", (1,)),
    "right_landmarks": ("float64", (63,)),
    "right_landmarks_valid": ("bool", (21,)),
    "right_human_wrist": ("float64", (7,)),
    "right_human_wrist_valid": ("bool", (1,)),
}
POSE = [f"tcp.{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz")]


def test_every_column_of_a_recorded_dataset_is_right(recorded):
    hand = load_hand("mimic_p050")
    dataset = load_dataset(recorded / "dataset")
    joints = [f"{name}.pos" for name in hand.joint_names]
    names = {
        "action": joints + POSE,
        "observation.state": joints + ARM + POSE,
        "observation.tactile": [f"tactile.{finger}.newtons" for finger in hand.fingers],
    }
    assert dataset.num_episodes == EPISODES
    assert dataset.fps == FPS
    assert dataset.meta.robot_type == "smooth_hand"
    indices = {"timestamp", "frame_index", "episode_index", "index", "task_index"}
    assert set(dataset.features) == names.keys() | indices | set(HUMAN)
    for name, keys in names.items():
        feature = dataset.features[name]
        assert feature["dtype"] == "float32"
        assert list(feature["names"]) == keys
        assert tuple(feature["shape"]) == (len(keys),)

    episode, frame = table(dataset, "episode_index"), table(dataset, "frame_index")
    counts = [int(np.sum(episode == number)) for number in range(EPISODES)]
    assert len(dataset) == sum(counts)
    assert min(counts) > 0.3 * FPS * SECONDS  # fewer than it should, on a machine that is busy
    np.testing.assert_array_equal(frame, np.concatenate([np.arange(n) for n in counts]))
    np.testing.assert_array_equal(table(dataset, "index"), np.arange(len(dataset)))
    np.testing.assert_allclose(table(dataset, "timestamp"), frame / FPS, atol=1e-6)
    assert not table(dataset, "task_index").any()
    assert dataset[0]["task"] == TASK

    action, state = table(dataset, "action"), table(dataset, "observation.state")
    for name, values in (("action", action), ("observation.state", state)):
        assert values.shape == (len(dataset), len(names[name]))
        assert np.isfinite(values).all()
        statistics = dataset.meta.stats[name]
        np.testing.assert_allclose(statistics["min"], values.min(0), atol=1e-5)
        np.testing.assert_allclose(statistics["max"], values.max(0), atol=1e-5)
    low, high = hand.limits.T
    actuated = list(hand.actuated)
    assert np.all((action[:, actuated] >= low - 1e-5) & (action[:, actuated] <= high + 1e-5))
    # a physical hand overshoots
    assert np.all((state[:, actuated] >= low - 0.1) & (state[:, actuated] <= high + 0.1))
    for values in (action, state):
        np.testing.assert_allclose(np.linalg.norm(values[:, -4:], axis=1), 1.0, atol=1e-5)


def test_each_action_is_a_command_that_was_sent_and_the_hand_follows(recorded):
    hand = load_hand("mimic_p050")
    dataset = load_dataset(recorded / "dataset")
    take = read_log(recorded / "take.mcap")
    sent = np.concatenate([take.commands.joint_positions, take.wrist.poses], axis=1)
    sent = sent[np.isfinite(sent).all(axis=1)]  # the first have no wrist
    action, state = table(dataset, "action"), table(dataset, "observation.state")
    nearest = np.array([np.abs(sent - row).max(axis=1).min() for row in action])
    assert nearest.max() < 1e-5
    assert np.unique(action, axis=0).shape[0] > 0.5 * len(action)
    assert np.ptp(action[:, -7:-4], axis=0).min() > 0.003  # the wrist moves too

    joints, episode = len(hand.joint_names), table(dataset, "episode_index")
    neutral = hand.full_configuration(hand.neutral)
    assert np.abs(state[0, :joints] - neutral).max() < 0.05  # it starts where it stands
    for number in range(EPISODES):
        late = np.flatnonzero(episode == number)[FPS:]  # after the approach
        wanted, seen = action[late[:-2], :joints], state[late[2:]]
        moving = np.ptp(wanted, axis=0) > 0.2
        assert moving.sum() >= 5
        for joint in np.flatnonzero(moving):
            assert np.corrcoef(wanted[:, joint], seen[:, joint])[0, 1] > 0.8
    # The arm moves, and its joints and its wrist are of one moment. How near it comes to the
    # action is up to its limits: on a slow machine the operator's clutch may wander out of reach.
    assert np.ptp(state[:, -7:-4], axis=0).max() > 0.003
    from smooth_operator.teleop.arm.controller import build_arms  # needs mink

    arm = build_arms(read_arm("panda"), {"right": hand})["right"].controller
    for row in state[::20]:
        wrist = arm.wrist_at(row[joints : joints + 7])
        np.testing.assert_allclose(separation(wrist, row[-7:].astype(float)), 0.0, atol=2e-3)


def test_a_log_becomes_a_dataset_with_the_same_keys(recorded):
    """The log of the same session, converted, has the robot's columns, for LeRobot's class too."""
    root = recorded / "converted"
    assert main(["convert", str(recorded / "take.mcap"), "--output", str(root)]) == 0
    converted, own = load_dataset(root), load_dataset(recorded / "dataset")
    for name in ("action", "observation.state"):
        names = list(converted.features[name]["names"])
        assert names == list(own.features[name]["names"])[: len(names)]  # without the arm
        assert converted.features[name]["dtype"] == own.features[name]["dtype"]
    take = read_log(recorded / "take.mcap")
    action, state = table(converted, "action"), table(converted, "observation.state")
    answered = np.isfinite(action).all(axis=1)
    assert answered.mean() > 0.9
    joints = len(load_hand("mimic_p050").joint_names)
    column = table(converted, "joint_positions")
    np.testing.assert_allclose(action[answered, :joints], column[answered], atol=1e-6)
    np.testing.assert_allclose(
        action[answered, joints:], table(converted, "wrist_command")[answered], atol=1e-6
    )
    assert np.isfinite(state[len(state) // 2 :]).all()
    assert len(converted) == len(take.recording)
    assert set(converted[len(converted) // 2]) >= {"action", "observation.state", "task"}


def test_the_human_hand_is_kept_and_drives_another_hand(recorded):
    """The hand of each frame is one that the tracker saw; from it come the actions of LEAP."""
    dataset, take = load_dataset(recorded / "dataset"), read_log(recorded / "take.mcap")
    for name, (dtype, shape) in HUMAN.items():
        feature = dataset.features[name]
        assert (feature["dtype"], tuple(feature["shape"])) == (dtype, shape)
        assert np.isfinite(dataset.meta.stats[name]["mean"]).all()
    from lerobot.utils.feature_utils import dataset_to_policy_features

    assert not set(HUMAN) & set(dataset_to_policy_features(dataset.features))  # no policy input
    valid = table(dataset, "right_landmarks_valid").all(axis=1)
    assert valid.mean() > 0.9
    seen = take.recording.landmarks.reshape(len(take.recording), -1)
    stored = table(dataset, "right_landmarks")[valid]
    assert np.array([np.abs(seen - row).max(axis=1).min() for row in stored]).max() < 1e-7
    assert table(dataset, "right_human_wrist_valid").mean() > 0.9

    command = f"retarget --dataset {recorded / 'dataset'} --hand leap_hand --method joint_angle"
    assert main([*command.split(), "--output", str(recorded / "leap"), "--quiet"]) == 0
    made = load_dataset(recorded / "leap")
    joints = [f"{name}.pos" for name in load_hand("leap_hand").actuated_names]
    assert list(made.features["action"]["names"]) == joints + POSE
    assert list(made.features["observation.state"]["names"]) == joints + ARM + POSE
    assert (len(made), made.num_episodes) == (len(dataset), EPISODES)
    assert made[0]["task"] == TASK
    action = table(made, "action")
    np.testing.assert_array_equal(action[:, -7:], table(dataset, "action")[:, -7:])
    assert np.ptp(action[:, : len(joints)], axis=0).max() > 0.3
    np.testing.assert_allclose(made.meta.stats["action"]["max"], action.max(axis=0), atol=1e-5)
    np.testing.assert_array_equal(table(made, "right_landmarks"), table(dataset, "right_landmarks"))
