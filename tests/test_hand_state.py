"""Measured joints next to the command: in ticks, log, ZeroMQ, HDF5 and LeRobot datasets."""

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_time import PATIENCE_S
from protobuf_log import decoded, plain
from ticks import KeptTicks, make_tick, record

from smooth_operator.errors import RecordingError
from smooth_operator.formats.episode import StateTrajectory
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.recording import read_episode
from smooth_operator.teleop.recording.log import LogWriter
from smooth_operator.teleop.recording.log_reader import read_log
from smooth_operator.teleop.runtime.statistics import log_timing
from smooth_operator.teleop.sinks.sink import SinkRunner
from smooth_operator.teleop.sinks.tick import Contact, HandState, Tick
from smooth_operator.teleop.sinks.zmq_sink import command_message
from smooth_operator.teleop.sinks.zmq_sink import state_message as zmq_message


def measured(hand: Hand, number: int, stamp: float) -> HandState:
    count = len(hand.joint_names)
    positions = np.linspace(0.0, 1.0, count) + 0.01 * number
    positions[3] = np.nan
    return HandState(
        "right",
        hand.name,
        stamp,
        hand.joint_names,
        positions,
        np.full(count, 0.5),
        ("a", "b"),
        np.array([100.0 + number, np.nan]),
        np.array([31.0, 32.0]),
        np.array([0.1, 0.2, 0.3]),
        Contact(np.array([0.5, 0.1 * number, np.nan]), np.array([2.5, 0.0, np.nan])),
    )


def ticks(hand: Hand, count: int) -> list[Tick]:
    """Every state is in two ticks, as of a hand at half the loop's rate."""
    start, found = time.perf_counter(), []
    state = measured(hand, 0, start - 0.004)
    for number in range(count):
        at = start + 0.01 * number
        if number % 2 == 0:
            state = measured(hand, number, at - 0.004)
        found.append(replace(make_tick(hand, number, at=at), state=state))
    return found


@pytest.fixture
def log(tmp_path, hand) -> Path:
    record(tmp_path / "take.mcap", hand, ticks(hand, 10), {"hand": hand.name})
    return tmp_path / "take.mcap"


def test_a_log_has_each_measurement_once(log, hand):
    states = read_log(log).states
    assert states.positions.shape == (5, len(hand.joint_names))
    assert states.names == hand.joint_names
    assert np.isnan(states.positions[:, 3]).all()
    assert states.positions[:, 0] == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08])
    assert states.currents[:, 0].tolist() == [100.0, 102.0, 104.0, 106.0, 108.0]
    assert states.touch.shape == (5, 3)
    np.testing.assert_allclose(states.contact[:, :2], [[0.5, 0.1 * k] for k in range(0, 10, 2)])
    np.testing.assert_array_equal(states.newtons, [[2.5, 0.0, np.nan]] * 5)
    assert log_timing(read_log(log))["contact_rate_hz"] == pytest.approx(50.0)
    commands = read_log(log).commands
    assert len(commands) == 10


def test_a_dataset_observes_the_measured_joints(log, tmp_path, hand):
    pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    from smooth_operator.episode_files.lerobot.writer import write_dataset

    episode = read_episode(log)
    path = tmp_path / "dataset"
    write_dataset(path, [lambda: episode], fps=100)
    features = json.loads((path / "meta" / "info.json").read_text())["features"]
    keys = [f"{name}.pos" for name in hand.joint_names]
    assert features["observation.state"]["names"] == keys
    assert features["action"]["names"] == keys
    import pyarrow.parquet as parquet

    table = parquet.read_table(next(path.glob("data/*/*.parquet")))
    state = np.array(table["observation.state"].to_pylist())
    assert state[:, 0] == pytest.approx([0.0, 0.0, 0.02, 0.02, 0.04, 0.04, 0.06, 0.06, 0.08, 0.08])
    bare = replace(episode, states=None, name="bare")
    with pytest.raises(RecordingError, match="has measured joints but bare has none"):
        write_dataset(tmp_path / "mixed", [lambda: episode, lambda: bare], fps=100)


def test_states_of_an_episode_must_fit():
    with pytest.raises(RecordingError, match="positions must have shape"):
        StateTrajectory(np.zeros(2), np.zeros((2, 3)), ("a",))
    with pytest.raises(RecordingError, match="must not decrease"):
        StateTrajectory(np.array([1.0, 0.0]), np.zeros((2, 1)), ("a",))
    few = StateTrajectory(np.array([1.0, 2.0]), np.array([[5.0], [6.0]]), ("a",))
    positions, stamps = few.at(np.array([0.5, 1.5, 2.0, 9.0]))
    assert positions[:, 0].tolist() == [5.0, 5.0, 6.0, 6.0]
    assert stamps.tolist() == [1.0, 1.0, 2.0, 2.0]


def test_a_message_of_a_state_is_no_command(hand, tmp_path):
    state = measured(hand, 1, time.perf_counter())
    message = zmq_message(state)
    text = json.dumps(message, separators=(",", ":"), allow_nan=False)
    assert text.startswith('{"topic":"/state","side":"right",')
    command = command_message(make_tick(hand), 0.2)
    assert not text.startswith('{"side":"right"')  # what drivers subscribe to
    assert next(iter(command)) == "side"
    assert message["positions"][3] is None
    assert message["currents"] == [101.0, None]
    assert (message["contact"], message["newtons"]) == ([0.5, 0.1, None], [2.5, 0.0, None])
    assert abs(message["unix_time"] - time.time()) < PATIENCE_S
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write_state(state)
    ((_, _, logged),) = decoded(tmp_path / "a.mcap")
    assert plain(logged)["touch"] == [0.1, 0.2, 0.3]
    assert plain(logged)["velocities"] == [0.5] * len(hand.joint_names)
    assert plain(logged)["temperatures"] == [31.0, 32.0]


def test_the_simulation_measures_and_a_real_hand_goes_before_it(hand):
    class Real(KeptTicks):
        def state(self, side: str) -> HandState:
            return measured(hand, 0, 1.0)

    runner = SinkRunner([build_sink("mujoco")])
    runner.open({"right": hand}, {})
    state = runner.state("right")
    assert state.names == hand.joint_names
    assert state.positions.shape == (len(hand.joint_names),)
    assert runner.state("left") is None
    runner.add(Real())
    assert runner.state("right").stamp == 1.0
    runner.close()
    assert runner.state("right") is None
