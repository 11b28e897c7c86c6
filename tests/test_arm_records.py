"""The arm's command in what leaves the loop: ZeroMQ, the log, HDF5."""

import json
from pathlib import Path

import numpy as np
import pytest

from smooth_operator.errors import RecordingError
from smooth_operator.formats.episode import ArmTrack
from smooth_operator.teleop.recording.log import LogWriter
from smooth_operator.teleop.recording.log_episode import read_log_episode
from smooth_operator.teleop.recording.log_reader import read_log
from smooth_operator.teleop.sinks.tick import ArmCommand, Mode, Tick
from smooth_operator.teleop.sinks.zmq_sink import command_message
from smooth_operator.types import JointCommand, Status

JOINTS = ("a", "b", "c")


def _arm(number: int, measured: bool) -> ArmCommand:
    q = np.array([0.1, 0.2, 0.3]) * number
    pose = np.array([0.5, 0.0, 0.4, 1.0, 0.0, 0.0, 0.0])
    return ArmCommand(
        "ur5e",
        JOINTS,
        q,
        q / 2,
        pose,
        0.001,
        0.002,
        0.05,
        "following",
        q + 0.01 if measured else None,
    )


@pytest.fixture
def log(tmp_path) -> Path:
    path = tmp_path / "take.mcap"
    with LogWriter(path) as writer:
        for number in range(4):
            command = JointCommand(np.zeros(2), ("x", "y"), 0.01 * number)
            arm = None if number == 2 else _arm(number, measured=number > 0)
            writer.write_command(command, Status.OK, 1.0, arm=arm)
    return path


def _check(track: ArmTrack | None) -> None:
    assert (track.name, track.joint_names, len(track)) == ("ur5e", JOINTS, 4)
    np.testing.assert_array_equal(track.positions[3], _arm(3, False).positions)
    np.testing.assert_allclose(track.measured[1], [0.11, 0.21, 0.31])
    assert np.isnan(track.positions[2]).all()
    assert np.isnan(track.measured[0]).all()
    assert track.poses[1][2] == 0.4


def test_a_log_gives_back_what_the_arm_was_sent_and_where_it_was(log):
    _check(read_log(log).arm)


def test_hdf5_keeps_the_arm(log, tmp_path):
    pytest.importorskip("h5py", reason="the extra hdf5 is not installed")
    from smooth_operator.episode_files.hdf5 import read_hdf5_episode, write_hdf5_episode

    episode = read_log_episode(log)
    _check(episode.arm)
    path = tmp_path / "take.h5"
    write_hdf5_episode(path, episode)
    _check(read_hdf5_episode(path).arm)


def test_lerobot_keeps_the_arm(log, tmp_path):
    pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    from smooth_operator.episode_files.lerobot import (
        open_dataset,
        read_dataset_episode,
        write_dataset,
    )

    path = tmp_path / "dataset"
    write_dataset(path, [lambda: read_log_episode(log)], fps=100)
    dataset = open_dataset(path)
    assert dataset.info["features"]["arm_positions"]["names"] == list(JOINTS)
    assert dataset.info["features"]["arm_wrist"]["shape"] == [7]
    _check(read_dataset_episode(dataset, 0).arm)


def test_a_message_of_another_number_of_joints_is_refused(tmp_path):
    path = tmp_path / "bad.mcap"
    with LogWriter(path) as writer:
        arm = ArmCommand("ur5e", JOINTS, np.zeros(2), np.zeros(2), np.eye(7)[3])
        writer.write_command(JointCommand(np.zeros(1), ("x",), 0.0), Status.OK, 1.0, arm=arm)
    with pytest.raises(RecordingError):
        read_log(path)


def test_zeromq_carries_the_arm_with_the_hand():
    command = JointCommand(np.zeros(2), ("x", "y"), 1.0)
    tick = Tick("right", "hand", command, np.zeros(2), Mode.TRACKING, 2.0, 7, arm=_arm(2, True))
    message = json.loads(json.dumps(command_message(tick, 0.2)))
    assert message["arm"]["names"] == list(JOINTS)
    assert message["arm"]["positions"] == pytest.approx([0.2, 0.4, 0.6])
    assert message["arm"]["measured"] == pytest.approx([0.21, 0.41, 0.61])
    assert message["arm"]["state"] == "following"
    without = Tick("right", "hand", command, np.zeros(2), Mode.TRACKING, 2.0, 7)
    assert "arm" not in command_message(without, 0.2)
