"""Wrist, arm and measured joints: from each source to each file and message, and back."""

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from glove_simulator import write_manus
from live_time import Kept, until
from protobuf_log import decoded
from ticks import make_tick, record

from smooth_operator import load_hand, poses, read_recording
from smooth_operator.errors import RecordingError
from smooth_operator.formats.episode import ArmTrack, Episode, StateTrajectory, WristTrack
from smooth_operator.landmarks import FROM_OPENXR_26
from smooth_operator.retargeting.flat_hand import FLAT_HAND
from smooth_operator.synthetic import SyntheticOperator, WristMotion
from smooth_operator.teleop.recording import read_episode, write_episode
from smooth_operator.teleop.recording.log import LogWriter
from smooth_operator.teleop.recording.log_episode import write_log_episode
from smooth_operator.teleop.recording.log_reader import read_log
from smooth_operator.teleop.sinks.tick import ArmCommand, WristCommand
from smooth_operator.teleop.sinks.zmq_sink import command_message, encode
from smooth_operator.teleop.sources.live import ThreadedSource
from smooth_operator.teleop.sources.payload import read_payload
from smooth_operator.teleop.sources.played import Replay, SyntheticSource
from smooth_operator.teleop.sources.programs import read_manus
from smooth_operator.teleop.sources.webxr.link import HEADER, read_packet
from smooth_operator.types import (
    CommandTrajectory,
    HandFrame,
    HandRecording,
    JointCommand,
    Status,
)
from smooth_operator_research.paper.follow import led

POSE = [0.3, -0.2, 1.1, 0.6, 0.0, 0.8, 0.0]


ARRAYS = (
    *(f"wrist.{name}" for name in ("poses", "engaged", "valid")),
    *(f"arm.{name}" for name in ("positions", "measured", "poses", "name", "joint_names")),
    *(f"states.{name}" for name in ("stamps", "positions", "currents", "touch")),
    *(f"states.{name}" for name in ("names", "actuators", "contact", "newtons")),
)
"""Arrays and names of an episode besides its recording and its commands."""


def operator(side: str = "right", seconds: float = 0.4) -> HandRecording:
    motion = WristMotion(0.1, 0.4, seed=3)
    return SyntheticOperator(seed=1, side=side, wrist=motion).record(seconds)


def episode() -> Episode:
    """A hand whose wrist is lost for a while, with commands for some frames."""
    hand = operator()
    wrists = np.array(hand.T_world_wrist)
    wrists[5:9] = np.nan
    hand = replace(hand, T_world_wrist=wrists, name="wrist", meta={})
    count = len(hand) - 2
    rng = np.random.default_rng(0)
    commands = CommandTrajectory(
        rng.normal(size=(count, 2)),
        ("a", "b"),
        hand.stamps[:count],
        np.full(count, 1.0),
        np.zeros(count, np.int8),
    )
    track = poses.from_rotation_vectors(rng.normal(size=(count, 3)))
    placed = np.concatenate([rng.normal(size=(count, 3)), track], axis=1)
    placed[0] = np.nan  # before the first wrist
    flags = rng.random((2, count)) < 0.5
    flags[:, 0] = False
    wrist = WristTrack(placed, flags[0], flags[1], "table")
    q, measured, at = rng.normal(size=(count, 3)), rng.normal(size=(count, 3)), placed.copy()
    at[0], measured[:4] = placed[1], np.nan
    for rows in (q, measured, at):
        rows[2] = np.nan  # a command without one for the arm
    arm = ArmTrack("ur5e", ("j1", "j2", "j3"), q, measured, at)
    states = StateTrajectory(
        hand.stamps[1:count] - 0.004,
        np.where(rng.random((count - 1, 2)) < 0.2, np.nan, rng.normal(size=(count - 1, 2))),
        ("a", "b"),
        ("m1", "m2", "m3"),
        rng.normal(size=(count - 1, 3)),
        rng.normal(size=(count - 1, 5)),
        rng.random((count - 1, 5)),
        rng.random((count - 1, 5)),
    )
    return Episode(
        hand, commands, {"method": "x"}, name="wrist", wrist=wrist, arm=arm, states=states
    )


def same(back: Episode, sent: Episode, arrays: Sequence[str] = ARRAYS) -> None:
    for path in arrays:
        part, name = path.split(".")
        values = [getattr(getattr(one, part), name) for one in (back, sent)]
        np.testing.assert_array_equal(*values, path)
    np.testing.assert_array_equal(back.recording.T_world_wrist, sent.recording.T_world_wrist)
    assert back.recording.world == sent.recording.world == "synthetic"
    assert back.wrist.world == "table"


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_operator_knows_its_wrist(side):
    hand = operator(side)
    world = poses.points_to_ours(hand.landmarks, poses.axes("z", "y", "-x"))
    found = poses.wrist_from_landmarks(world, hand.side)
    apart = poses.separation(hand.T_world_wrist, found)
    assert apart[:, 0].max() < 1e-12
    assert apart[:, 1].max() < 0.06  # its own axes, and those of its knuckles
    assert np.ptp(hand.T_world_wrist[:, :3], axis=0).max() > 0.005
    plain = SyntheticOperator(seed=1, side=hand.side).record(0.4)
    assert plain.T_world_wrist is None


def test_the_live_operator_moves_its_wrist_and_not_its_landmarks():
    moved, still = (played(SyntheticSource(duration=0.2, wrist=wrist)) for wrist in (0.05, 0.0))
    assert len(moved) == len(still) == 20
    for a, b in zip(moved, still, strict=True):
        np.testing.assert_array_equal(a.landmarks, b.landmarks)
        assert poses.is_valid(a.T_world_wrist)
        assert b.T_world_wrist is None
    speed = np.diff([f.T_world_wrist[:3] for f in moved], axis=0) * 100
    assert 0.001 < np.linalg.norm(speed, axis=1).max() < 1.0
    assert moved[0].world == "synthetic"


def played(source: ThreadedSource) -> list[HandFrame]:
    """All frames of a source."""
    mailbox = Kept()
    source.start(mailbox)
    until(lambda: source.health().state == "ended")
    source.stop()
    return [arrival.frame for arrival in mailbox.all]


def test_a_replay_has_the_wrist_of_its_recording(tmp_path):
    sent = episode()
    write_log_episode(tmp_path / "a.mcap", sent)
    frames = played(Replay(tmp_path / "a.mcap", speed=100.0))
    np.testing.assert_array_equal([f.T_world_wrist for f in frames], sent.recording.T_world_wrist)


def test_a_headset_sends_its_wrist_in_its_reference_space():
    # Palm down, pointing ahead, 1.2 m up, 0.3 m to the right and 0.4 m ahead of the headset.
    joints = np.full((25, 8), 0.01, np.float32)
    joints[:, 0] = 0.01 * np.arange(25)
    joints[0, :7] = 0.3, 1.2, -0.4, 0, 0, 0, 1
    for space, world in ((0, "webxr/local"), (1, "webxr/local-floor"), (7, "webxr")):
        message = HEADER.pack(b"XRH1", 0, 1.0, 2, space) + joints.tobytes()
        (frame,) = read_packet(message).frames
        np.testing.assert_allclose(frame.T_world_wrist, [0.4, -0.3, 1.2, 1, 0, 0, 0], atol=1e-6)
        assert frame.world == world
    joints[0, :7] = 0, 0, 0, 0, 2**-0.5, 0, 2**-0.5  # turned to the left, as seen from above
    (frame,) = read_packet(HEADER.pack(b"XRH1", 0, 1.0, 2, 0) + joints.tobytes()).frames
    turned = poses.rotate(frame.T_world_wrist[3:], np.array([1.0, 0, 0]))
    np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-6)
    joints[0, 3:7] = np.nan
    (frame,) = read_packet(HEADER.pack(b"XRH1", 0, 1.0, 2, 0) + joints.tobytes()).frames
    assert np.isnan(frame.T_world_wrist).all()
    assert frame.valid[0]


def test_26_poses_of_openxr_hold_a_wrist():
    rows = np.zeros((26, 7))
    rows[list(FROM_OPENXR_26), :3] = FLAT_HAND
    rows[:, 3] = 1.0
    rows[:, :3] += [0.3, 1.2, -0.4]
    (reading,) = read_payload(json.dumps(rows.tolist()).encode(), "right")
    np.testing.assert_allclose(reading.frame.T_world_wrist, [0.4, -0.3, 1.2, 1, 0, 0, 0])
    given = json.dumps({"joints": rows.tolist(), "wrist": POSE, "world": "cell"}).encode()
    (reading,) = read_payload(given, "right")
    np.testing.assert_allclose(reading.frame.T_world_wrist, POSE)
    assert reading.frame.world == "cell"
    points = json.dumps(rows[:, :3].tolist()).encode()
    assert read_payload(points, "right")[0].frame.T_world_wrist is None


def test_a_bridge_may_add_a_trackers_wrist_to_a_glove():
    nodes = json.loads(write_manus(HandFrame(FLAT_HAND, 0.0)))
    message = json.dumps({"side": "right", "nodes": nodes, "wrist": POSE, "world": "vive"})
    (reading,) = read_manus(message.encode(), gloves={}, side=None)
    np.testing.assert_allclose(reading.frame.T_world_wrist, POSE)
    assert reading.frame.world == "vive"
    bare = json.dumps({"side": "right", "nodes": nodes}).encode()
    (reading,) = read_manus(bare, gloves={}, side=None)
    assert reading.frame.T_world_wrist is None


@pytest.mark.parametrize(
    ("suffix", "arrays"), [("npz", ARRAYS[:3]), ("h5", ARRAYS), ("mcap", ARRAYS)]
)
def test_files_hold_both_wrists_and_most_hold_all_of_it(tmp_path, suffix, arrays):
    if suffix == "h5":
        pytest.importorskip("h5py", reason="needs the extra hdf5")
    sent, path = episode(), tmp_path / f"a.{suffix}"
    write_episode(path, sent)
    same(read_episode(path), sent, arrays)
    plain = read_recording(path)
    np.testing.assert_array_equal(plain.T_world_wrist, sent.recording.T_world_wrist)
    assert (b"foxglove.PoseInFrame" in path.read_bytes()) == (suffix == "mcap")


def test_a_lerobot_dataset_holds_all_of_it(tmp_path):
    pytest.importorskip("pyarrow", reason="needs the extra lerobot")
    from smooth_operator.episode_files.lerobot.reader import open_dataset, read_dataset_episode
    from smooth_operator.episode_files.lerobot.writer import write_dataset

    sent = episode()
    bare = replace(
        sent, recording=replace(sent.recording, T_world_wrist=None, world=None), wrist=None
    )
    write_dataset(tmp_path / "set", [lambda: sent, lambda: bare])
    dataset = open_dataset(tmp_path / "set")
    same(read_dataset_episode(dataset, 0), sent, (*ARRAYS[:10], "states.names"))
    features = dataset.info["features"]
    assert features["wrist_command"]["names"] == ["x", "y", "z", "qw", "qx", "qy", "qz"]
    assert features["arm_positions"]["names"] == ["j1", "j2", "j3"]
    assert features["arm_wrist"]["shape"] == [7]
    back = read_dataset_episode(dataset, 1)
    assert back.wrist is None
    assert back.recording.T_world_wrist is None


def test_parts_of_an_episode_and_of_a_recording_keep_the_wrist(tmp_path):
    sent = episode()
    cut = sent.sliced(slice(3, 11))
    np.testing.assert_array_equal(cut.recording.T_world_wrist, sent.recording.T_world_wrist[3:11])
    np.testing.assert_array_equal(cut.wrist.poses, sent.wrist.poses[3:11])
    longer = led(replace(sent.recording, meta={}))
    assert len(longer.T_world_wrist) == len(longer)
    write_episode(tmp_path / "c.npz", cut)
    assert read_episode(tmp_path / "c.npz").wrist is not None


def test_a_live_command_carries_both_wrists_to_log_and_message(tmp_path):
    hand = load_hand("mimic_p050")
    sent = []
    for k in range(4):
        tick = make_tick(hand, k, frame=k != 2)
        command = WristCommand(np.add(POSE, [0.01 * k, 0, 0, 0, 0, 0, 0]), k > 0, k > 1)
        if tick.arrival is not None:
            pose = np.full(7, np.nan) if k == 1 else wrist_at(k)
            frame = replace(tick.arrival.frame, T_world_wrist=pose, world="room")
            tick = replace(tick, arrival=replace(tick.arrival, frame=frame))
        sent.append(replace(tick, wrist=command))
    record(tmp_path / "take.mcap", hand, sent)
    log = read_log(tmp_path / "take.mcap")
    np.testing.assert_allclose(log.wrist.poses[:, 0], [0.3, 0.31, 0.32, 0.33])
    assert log.wrist.engaged.tolist() == [False, True, True, True]
    assert log.wrist.valid.tolist() == [False, False, True, True]
    assert log.wrist.world == "base"
    assert log.recording.world == "room"
    assert poses.is_valid(log.recording.T_world_wrist).tolist() == [True, False, True]

    messages = [json.loads(encode(command_message(tick, 0.2))) for tick in sent]
    assert messages[0]["wrist"] == {"pose": POSE, "engaged": False, "valid": False, "world": "base"}
    assert messages[0]["operator_wrist"] == {"pose": wrist_at(0).tolist(), "world": "room"}
    assert messages[1]["operator_wrist"] == {"pose": None, "world": "room"}
    assert messages[0]["landmarks"] == sent[0].arrival.frame.landmarks.tolist()
    assert not {"operator_wrist", "landmarks"} & messages[2].keys()
    bare = command_message(make_tick(hand), 0.2)
    assert "wrist" not in bare
    assert "operator_wrist" not in bare


def test_zeromq_carries_the_arm_with_the_hand():
    q, pose = np.array([0.2, 0.4, 0.6]), np.array(POSE)
    arm = ArmCommand("ur5e", ("a", "b", "c"), q, q / 2, pose, measured=q + 0.01)
    tick = replace(make_tick(load_hand("mimic_p050")), arm=arm)
    message = json.loads(encode(command_message(tick, 0.2)))["arm"]
    assert (message["names"], message["state"]) == (["a", "b", "c"], "following")
    assert message["positions"] == pytest.approx([0.2, 0.4, 0.6])
    assert message["measured"] == pytest.approx([0.21, 0.41, 0.61])
    assert "arm" not in command_message(replace(tick, arm=None), 0.2)


def test_an_arm_with_another_number_of_joints_is_refused(tmp_path):
    with LogWriter(tmp_path / "bad.mcap") as writer:
        arm = ArmCommand("ur5e", ("a", "b", "c"), np.zeros(2), np.zeros(2), np.eye(7)[3])
        writer.write_command(JointCommand(np.zeros(1), ("x",), 0.0), Status.OK, 1.0, arm=arm)
    with pytest.raises(RecordingError):
        read_log(tmp_path / "bad.mcap")


def test_the_wrist_and_the_fingers_of_a_row_have_one_stamp(tmp_path):
    sent = episode()
    write_log_episode(tmp_path / "a.mcap", sent)
    rows: dict[str, list[tuple[int, float]]] = {"/wrist": [], "/command": []}
    for topic, message, content in decoded(tmp_path / "a.mcap", rows):
        rows[topic].append((message.sequence, content.stamp))
    assert set(rows["/wrist"]) == set(rows["/command"][1:])  # the first command had no wrist


def wrist_at(k: int) -> np.ndarray:
    return np.array([0.1 * k, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
