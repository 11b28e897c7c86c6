"""The log of a live loop: every kind of message, its index, damage."""

from dataclasses import asdict
from pathlib import Path

import fuzzing
import numpy as np
import pytest
from made_hands import hand_points
from mcap.reader import make_reader
from protobuf_log import decoded, plain

from smooth_operator.errors import RecordingError
from smooth_operator.formats.readers import read_recording
from smooth_operator.teleop.recording import Log, LogWriter, read_log
from smooth_operator.teleop.recording.messages import LoopState
from smooth_operator.teleop.sinks.tick import ArmCommand, HandState, WristCommand
from smooth_operator.types import HandFrame, JointCommand, Status

FRAMES = 30
NAMES = ("base", "tip", "späte")


def fill(log: LogWriter) -> None:
    """A live session in which everything comes and goes."""
    rng = np.random.default_rng(4)
    log.write_origin({"name": "take", "task": "pinch", "meta": '{"glove": 3}'})
    log.write_config({"method": "sbr", "deep": {"list": [1, 2.5, None]}})
    for k in range(FRAMES):
        stamp = 1.7e9 + 0.01 * k + 1e-6 * float(rng.uniform())
        points = hand_points(FRAMES, 0, "left")[k].copy()
        if k == 4:
            points[8] = np.nan
        pose = np.array([*rng.normal(size=3), 1.0, 0.0, 0.0, 0.0])
        if k % 5:
            log.write_hand(
                HandFrame(
                    points,
                    stamp,
                    "left",
                    metacarpals=rng.normal(size=(4, 3)) if k > 2 else None,
                    orientations=rng.normal(size=(21, 4)) if k > 3 else None,
                    T_world_wrist=None if k < 6 else np.full(7, np.nan) if k == 8 else pose,
                    world=None if k < 6 else "room",
                )
            )
        if k == 0:
            log.write_method(stamp, "sbr", "live", {"weight": 0.5})
        if k % 2:
            log.write_state(
                HandState(
                    "left",
                    "hand",
                    stamp - 0.004,
                    NAMES,
                    np.array([0.1, np.nan, 0.3]),
                    actuators=("m1", "m2"),
                    currents=rng.normal(size=2),
                    touch=rng.normal(size=5) if k > 6 else None,
                )
            )
        loop = LoopState(
            number=k,
            mode="tracking" if k % 5 else "holding",
            time=stamp + 0.002,
            received=stamp + 0.001 if k % 5 else None,
            tracker_stamp=0.01 * k if k % 5 else None,
            session=None if k < 3 else k // 10,
            tracking_loss=0.01 if k % 5 else float("nan"),
            scale=1.1,
            events=(f"event {k}", "twice") if k % 11 == 0 else (),
        )
        wrist = WristCommand(pose, engaged=k > 9, valid=k != 12) if k > 1 else None
        measured = rng.normal(size=6) if k > 7 else None
        joints = tuple(f"j{i}" for i in range(6))
        arm = ArmCommand("ur5e", joints, rng.normal(size=6), np.zeros(6), pose, measured=measured)
        log.write_command(
            JointCommand(rng.normal(size=3), NAMES, stamp),
            Status(k % 4),
            0.1 * k if k else float("nan"),
            {"solve": 0.03 * k, **({"limit": 0.2} if k % 2 else {})},
            loop,
            wrist,
            None if k == 20 else arm,
        )


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "a.mcap"
    with LogWriter(path, chunk_bytes=20_000) as log:
        fill(log)
    return path


def test_a_log_gives_what_was_written(path):
    log = read_log(path)
    assert len(log.recording) == 24
    assert_everything(log)


def assert_everything(log: Log) -> None:
    assert log.commands.joint_names == NAMES
    assert log.commands.status.tolist() == [k % 4 for k in range(FRAMES)]
    np.testing.assert_array_equal(log.commands.latency_ms[1:], 0.1 * np.arange(1, FRAMES))
    np.testing.assert_array_equal(log.stages_ms["solve"], 0.03 * np.arange(FRAMES))
    assert np.isnan(log.stages_ms["limit"][::2]).all()
    assert log.config == {"method": "sbr", "deep": {"list": [1, 2.5, None]}}
    assert log.origin["task"] == "pinch"
    assert [(use.method, use.preset, use.config) for use in log.methods] == [
        ("sbr", "live", {"weight": 0.5})
    ]
    assert log.loop.events == {k: (f"event {k}", "twice") for k in (0, 11, 22)}
    assert log.loop.modes[:6] == ("holding", *["tracking"] * 4, "holding")
    np.testing.assert_array_equal(log.loop.numbers, np.arange(FRAMES))
    np.testing.assert_array_equal(log.loop.answers, np.arange(FRAMES) % 5 > 0)
    assert np.isnan(log.wrist.poses[:2]).all()
    assert log.wrist.engaged.tolist() == [k > 9 for k in range(FRAMES)]
    assert np.isnan(log.arm.positions[20]).all()
    assert np.isfinite(log.arm.measured[[8, 29]]).all()
    assert np.isnan(log.arm.measured[:8]).all()
    assert log.states.actuators == ("m1", "m2")
    assert np.isnan(log.states.touch[:3]).all()
    assert log.states.touch.shape == (15, 5)
    recording = log.recording
    assert recording.side == "left"
    assert recording.world == "room"
    assert np.isfinite(recording.T_world_wrist[-1]).all()
    assert np.isnan(recording.metacarpals[0]).all()


def test_live_messages_are_decoded_by_the_types_in_the_file(tmp_path):
    pose = np.arange(7.0)
    loop = LoopState(
        number=2**40, mode="holding", time=1.5, session=-2, scale=1.1, events=("späte", "b")
    )
    arm = ArmCommand("ur5e", ("a", "b"), np.array([0.1, np.nan]), np.zeros(2), pose, 0.5)
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write_command(
            JointCommand(np.zeros(1), ("x",), 3.0),
            Status.OK,
            1.0,
            {},
            loop,
            WristCommand(pose, engaged=True, valid=False),
            arm,
        )
    found = {topic: plain(message) for topic, _, message in decoded(tmp_path / "a.mcap")}
    unknown = {"received": np.nan, "tracker_stamp": np.nan, "events": ["späte", "b"]}
    np.testing.assert_equal(found["/loop"], {"stamp": 3.0, **asdict(loop), **unknown})
    flags = {"engaged": True, "valid": False, "world": "base"}
    assert found["/wrist"] == {"stamp": 3.0, "pose": pose.tolist(), **flags}
    fields = {name: getattr(arm, name) for name in ("name", "state", "clearance")}
    errors = {"position_error": 0.5, "rotation_error": np.nan}
    rows = {"names": ["a", "b"], "positions": [0.1, np.nan], "velocities": [0.0, 0.0]}
    rows |= {"measured": [], "pose": pose.tolist()}
    np.testing.assert_equal(found["/arm"], {"stamp": 3.0, **fields, **errors, **rows})


@pytest.mark.filterwarnings("ignore:.*_time is deprecated:DeprecationWarning")
def test_a_part_of_a_log_is_found_by_its_index(path):
    """The index of the messages, as a viewer uses it that jumps to a time."""
    everything = [(topic, m.log_time, m.data) for topic, m, _ in decoded(path)]
    times = sorted({at for _, at, _ in everything})
    start, end = times[len(times) // 3], times[len(times) // 2]
    with path.open("rb") as stream:
        found = [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(stream).iter_messages(
                start_time=start, end_time=end
            )
        ]
    assert len(found) > 20
    assert sorted(found) == sorted(one for one in everything if start <= one[1] < end)


def test_damaged_logs_are_refused_or_read_in_part(tmp_path, path):
    outcomes = set()

    def read(mutant: bytes) -> None:
        (tmp_path / "a.mcap").write_bytes(mutant)
        try:
            outcomes.add(len(read_recording(tmp_path / "a.mcap")))
        except RecordingError as error:
            outcomes.add(str(error).count("\n"))

    fuzzing.each(fuzzing.damaged_bytes(path.read_bytes()), 50, read)
    assert max(outcomes) > 0
