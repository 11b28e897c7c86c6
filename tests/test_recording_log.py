"""The project's own log: exact round trips, all kinds of message, what is left after a crash."""

import errno
import os
import re
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from made_hands import hand_points
from mcap.reader import make_reader
from mcap.writer import Writer
from protobuf_log import decoded, plain

from smooth_operator.errors import ConfigError, OutputError, RecordingError
from smooth_operator.formats.readers import read_recording
from smooth_operator.teleop import recording as recording_package
from smooth_operator.teleop.recording import LogWriter, read_log
from smooth_operator.teleop.recording.messages import LoopState
from smooth_operator.teleop.sinks.tick import ArmCommand, HandState, WristCommand
from smooth_operator.types import HandFrame, HandRecording, JointCommand, Side, Status

NAMES = ("base", "tip")
PROTO = Path(recording_package.__file__).parent / "proto"


def recording(frames: int = 40, *, side: Side = "right", rich: bool = True) -> HandRecording:
    rng = np.random.default_rng(0)
    points = hand_points(frames, 0, side)
    points[3:5, 8] = np.nan
    points[5:6, 4, 1] = -0.0
    valid = rng.random((frames, 21)) > 0.02
    valid[:, [0, 9]] = True
    return HandRecording(
        points,
        1.7e9 + np.cumsum(rng.uniform(0.005, 0.015, frames)),
        side,
        valid=valid,
        metacarpals=rng.normal(size=(frames, 4, 3)) if rich else None,
        orientations=rng.normal(size=(frames, 21, 4)) if rich else None,
    )


def command(stamp: float, value: float = 0.1) -> JointCommand:
    return JointCommand(np.array([value, np.pi * value]), NAMES, stamp)


def write(path: Path, hands: HandRecording, **options: object) -> Path:
    with LogWriter(path, **options) as log:
        log.write_config({"method": "sbr", "limit": float("inf")})
        for i, frame in enumerate(hands):
            log.write_hand(frame)
            status = Status.OK if i % 3 else Status.INVALID_LANDMARKS
            log.write_command(command(frame.stamp, i / 7), status, 0.1 * i, {"solve": 0.03 * i})
    return path


def assert_same(a: HandRecording, b: HandRecording) -> None:
    for name in ("landmarks", "stamps", "valid", "metacarpals", "orientations"):
        left, right = getattr(a, name), getattr(b, name)
        assert (left is None) == (right is None), name
        if left is not None:
            np.testing.assert_array_equal(left, right, err_msg=name)
    for name in ("landmarks", "stamps"):  # the sign of zero too
        np.testing.assert_array_equal(np.signbit(getattr(a, name)), np.signbit(getattr(b, name)))
    assert a.side == b.side


@pytest.mark.parametrize(
    ("compression", "side", "rich"),
    [
        ("zstd", "right", True),
        ("zstd", "left", False),
        ("lz4", "left", True),
        ("none", "left", True),
    ],
)
def test_round_trip_is_exact(tmp_path, compression, side, rich):
    hands = recording(side=side, rich=rich)
    path = write(tmp_path / "a.mcap", hands, compression=compression)
    log = read_log(path)
    assert log.truncated is False
    assert log.config == {"method": "sbr", "limit": "inf"}
    assert_same(hands, log.recording)
    i = np.arange(len(hands))
    assert log.commands.joint_names == NAMES
    expected = np.stack([i / 7, np.pi * (i / 7)], axis=1)
    np.testing.assert_array_equal(log.commands.joint_positions, expected)
    np.testing.assert_array_equal(log.commands.stamps, hands.stamps)
    np.testing.assert_array_equal(log.commands.latency_ms, 0.1 * i)
    np.testing.assert_array_equal(log.commands.status, np.where(i % 3, 0, 1))
    np.testing.assert_array_equal(log.stages_ms["solve"], 0.03 * i)
    assert_same(hands, read_recording(path))
    assert read_recording(path).meta == {"format": "log", "truncated": False, "side_assumed": False}


def test_opens_in_the_mcap_library(tmp_path):
    hands = recording(10)
    path = write(tmp_path / "a.mcap", hands)
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    counts = summary.statistics.channel_message_counts
    topics = {c.topic: counts[c.id] for c in summary.channels.values()}
    own = {topic: n for topic, n in topics.items() if not topic.startswith("/foxglove/")}
    assert own == {"/hand": 10, "/command": 10, "/status": 10, "/timing": 10, "/config": 1}
    messages = list(decoded(path))
    assert len(messages) == summary.statistics.message_count == sum(topics.values())
    times = [message.log_time for _, message, _ in messages]
    assert times == sorted(times)
    assert times[0] == round(hands.stamps[0] * 1e9)  # the configuration comes with it
    assert (summary.statistics.message_start_time, times[-1]) == (
        times[0],
        summary.statistics.message_end_time,
    )

    found = {topic: [plain(m) for t, _, m in messages if t == topic] for topic in own}
    first = found["/hand"][0]
    np.testing.assert_array_equal(first["landmarks"], hands.landmarks[0].ravel())
    np.testing.assert_array_equal(first["metacarpals"], hands.metacarpals[0].ravel())
    np.testing.assert_array_equal(first["orientations"], hands.orientations[0].ravel())
    assert first["valid"] == hands.valid[0].tolist()
    assert (first["side"], first["stamp"], first["wrist"]) == ("right", hands.stamps[0], [])
    third = {topic: rows[3] for topic, rows in found.items() if topic != "/config"}
    stamp = hands.stamps[3]
    assert third["/command"] == {
        "stamp": stamp,
        "names": list(NAMES),
        "positions": [3 / 7, np.pi * (3 / 7)],
    }
    reason = Status.INVALID_LANDMARKS.reason
    assert third["/status"] == {"stamp": stamp, "status": 1, "reason": reason}
    stages = [{"name": "solve", "ms": 0.03 * 3}]
    assert third["/timing"] == {"stamp": stamp, "latency_ms": 0.1 * 3, "stages": stages}
    assert found["/config"] == [{"configuration": '{"method": "sbr", "limit": "inf"}'}]


def test_types_carry_their_units(tmp_path):
    path = write(tmp_path / "a.mcap", recording(1))
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    own = [s for s in summary.schemas.values() if s.name.startswith("smooth_operator.")]
    for schema in own:
        (file,) = FileDescriptorSet.FromString(schema.data).file
        notes = {
            tuple(at.path): at.leading_comments or at.trailing_comments
            for at in file.source_code_info.location
        }
        (message,) = file.message_type
        described = sum(bool(notes.get((4, 0, 2, i))) for i in range(len(message.field)))
        assert described >= len(message.field) - 2, schema.name
        assert (4, 0) in notes
    assert len(own) == 5


def test_descriptors_are_those_of_the_proto_files():
    files = FileDescriptorSet.FromString((PROTO / "messages.binpb").read_bytes()).file
    own = {file.name: file for file in files if not file.name.startswith("google/")}
    assert own.keys() == {path.name for path in PROTO.glob("*.proto")}
    for name, file in own.items():
        found = set()
        left = list(file.message_type)
        for message in left:  # which grows
            left += message.nested_type
            found |= {(field.name, field.number) for field in message.field}
            found |= {(v.name, v.number) for enum in message.enum_type for v in enum.value}
        text = re.sub("//.*", "", (PROTO / name).read_text())
        assert found == {(n, int(k)) for n, k in re.findall(r"(\w+) = (\d+);", text)}, name
    (code,) = own["status.proto"].message_type[0].enum_type
    assert {v.name: v.number for v in code.value} == {s.name: int(s) for s in Status}


def test_numbers_that_are_not_finite_come_back_as_unknown(tmp_path):
    hands = recording(4)
    points = hands.landmarks.copy()
    points[2, 5, 0] = np.inf
    with LogWriter(tmp_path / "a.mcap") as log:
        for frame, row in zip(hands, points, strict=True):
            log.write_hand(HandFrame(row, frame.stamp))
            log.write_command(
                JointCommand(np.array([np.inf, 1.0]), NAMES, frame.stamp), Status.OK, float("inf")
            )
    back = read_log(tmp_path / "a.mcap")
    assert np.isnan(back.recording.landmarks[2, 5, 0])
    np.testing.assert_array_equal(back.commands.joint_positions[0], [np.nan, 1.0])
    assert np.isnan(back.commands.latency_ms).all()


def test_partial_logs(tmp_path):
    with LogWriter(tmp_path / "empty.mcap"):
        pass
    log = read_log(tmp_path / "empty.mcap")
    assert (log.recording, log.commands, log.config, log.truncated) == (None, None, None, False)
    with pytest.raises(RecordingError, match="contains no hand frames"):
        read_recording(tmp_path / "empty.mcap")

    with LogWriter(tmp_path / "config.mcap") as writer:
        writer.write_config({"a": [1, (2,)]})
    assert read_log(tmp_path / "config.mcap").config == {"a": [1, [2]]}

    with LogWriter(tmp_path / "commands.mcap") as writer:
        writer.write_command(command(1.0), Status.OK, 0.5)
        writer.write_config({"late": True})
        writer.write_command(command(1.0), Status.SOLVER_FAILED, float("nan"), {"solve": 1.0})
    log = read_log(tmp_path / "commands.mcap")
    assert log.recording is None
    assert log.config == {"late": True}
    np.testing.assert_array_equal(log.commands.latency_ms, [0.5, np.nan])
    np.testing.assert_array_equal(log.stages_ms["solve"], [np.nan, 1.0])


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_cut_log_gives_its_complete_chunks(tmp_path, compression):
    hands, path, ends = recording(60), tmp_path / "a.mcap", []
    with LogWriter(path, compression=compression, flush_seconds=3600.0) as writer:
        writer.write_config({})
        for i, frame in enumerate(hands):
            writer.write_hand(frame)
            writer.write_command(command(frame.stamp), Status.OK, 0.1)
            if i % 6 == 5:
                writer.flush()
                ends.append(path.stat().st_size)
    content, cut, rng = path.read_bytes(), tmp_path / "cut.mcap", np.random.default_rng(5)
    edges = [len(content) - 1, len(content) - 8, len(content) - 9, ends[0], 8]
    for length in {*rng.integers(8, len(content), 20).tolist(), *edges}:
        cut.write_bytes(content[:length])
        log = read_log(cut)
        assert log.truncated is True
        complete = 6 * sum(end <= length for end in ends)
        if log.recording is None:
            assert complete == 0
            with pytest.raises(RecordingError, match="cut off before its first frames"):
                read_recording(cut)
            continue
        frames = len(log.recording)
        assert frames in (complete, complete + 6)  # one more if only the chunk's index is cut
        assert_same(hands[:frames], log.recording)
        np.testing.assert_array_equal(log.commands.stamps, hands.stamps[:frames])
        assert np.isfinite(log.commands.latency_ms).all()
        assert log.config is not None
        assert read_recording(cut).meta["truncated"] is True


def test_damage_in_the_middle_keeps_the_part_before_it(tmp_path):
    hands = recording(60)
    whole = write(tmp_path / "a.mcap", hands, chunk_bytes=20_000)
    content = whole.read_bytes()
    rng = np.random.default_rng(6)
    for _ in range(25):
        broken = bytearray(content)
        place = int(rng.integers(8, len(content)))
        broken[place : place + 4] = rng.bytes(4)
        whole.write_bytes(broken)
        try:
            log = read_log(whole)
        except RecordingError:
            continue
        if log.recording is not None:
            assert_same(hands[: len(log.recording)], log.recording)
            assert log.truncated or len(log.recording) == len(hands)
    # A crash of the machine can leave zeros where the last blocks should be.
    whole.write_bytes(content[: len(content) // 2] + bytes(5000))
    log = read_log(whole)
    assert log.truncated
    assert 10 < len(log.recording) < 40


def test_flush_and_time_bring_frames_to_the_file(tmp_path):
    hands = recording(8)
    log = LogWriter(tmp_path / "a.mcap", flush_seconds=3600.0)
    assert read_log(log.path).truncated  # readable from the first moment on
    log.write_hand(hands[0])
    assert read_log(log.path).recording is None
    log.flush(sync=True)
    assert len(read_recording(log.path)) == 1
    log.write_hand(hands[1])
    assert len(read_recording(log.path)) == 1
    log.close()
    log.close()
    assert len(read_recording(log.path)) == 2
    with pytest.raises(OutputError, match="log is closed"):
        log.write_hand(hands[2])

    with LogWriter(tmp_path / "b.mcap", flush_seconds=1e-9) as log:
        log.write_hand(hands[0])
        log.write_hand(hands[1])
        assert len(read_recording(log.path)) == 2


def test_exception_in_the_block_still_ends_the_log(tmp_path):
    def crash() -> None:
        with LogWriter(tmp_path / "a.mcap") as log:
            log.write_hand(recording(1)[0])
            raise RuntimeError("robot")

    with pytest.raises(RuntimeError, match="robot"):
        crash()
    assert read_log(tmp_path / "a.mcap").truncated is False


def test_writer_refuses_unreadable_values(tmp_path):
    hands = recording(5)
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write_hand(hands[1])
        for stamp in (hands.stamps[1], hands.stamps[0], np.nan, np.inf):
            with pytest.raises(RecordingError, match="timestamps must increase"):
                log.write_hand(HandFrame(hands.landmarks[0], stamp))
        with pytest.raises(RecordingError, match="log of a right hand, but the frame is of a left"):
            log.write_hand(HandFrame(hands.landmarks[0], hands.stamps[2], "left"))
        log.write_command(command(1.0), Status.OK, 1.0)
        with pytest.raises(RecordingError, match="joints of the command differ from those"):
            log.write_command(JointCommand(np.zeros(1), ("x",), 1.0), Status.OK, 1.0)
        with pytest.raises(RecordingError, match="one position for each of its 2 joints"):
            log.write_command(JointCommand(np.zeros(3), NAMES, 1.0), Status.OK, 1.0)
        with pytest.raises(RecordingError, match="must be finite"):
            log.write_command(command(np.nan), Status.OK, 1.0)
        with pytest.raises(ConfigError, match=r"configuration\.f is a function"):
            log.write_config({"f": lambda: None})
        log.write_config({})
        with pytest.raises(ConfigError, match="already has its configuration"):
            log.write_config({})
        log.write_hand(hands[2])
    result = read_log(tmp_path / "a.mcap")  # none of it left a trace
    assert (len(result.recording), len(result.commands), result.config) == (2, 1, {})


@pytest.mark.parametrize(
    "options", [{"compression": "gzip"}, {"chunk_bytes": 0}, {"flush_seconds": float("nan")}]
)
def test_bad_options(tmp_path, options):
    with pytest.raises(ConfigError):
        LogWriter(tmp_path / "a.mcap", **options)
    assert not list(tmp_path.iterdir())


def test_paths_that_can_not_be_written(tmp_path):
    with pytest.raises(OutputError, match="does not exist; create it first"):
        LogWriter(tmp_path / "no" / "a.mcap")
    with pytest.raises(OutputError, match="it is a folder"):
        LogWriter(tmp_path)
    (tmp_path / "a.mcap").write_text("precious")
    with pytest.raises(OutputError, match="exists already") as caught:
        LogWriter(tmp_path / "a.mcap")
    assert caught.value.errno == errno.EEXIST
    assert (tmp_path / "a.mcap").read_text() == "precious"
    write(tmp_path / "a.mcap", recording(2), overwrite=True)
    assert len(read_recording(tmp_path / "a.mcap")) == 2
    with pytest.raises(OutputError, match="part of the path is a file"):
        LogWriter(tmp_path / "a.mcap" / "b.mcap")


def test_the_file_of_another_running_recording_is_refused(tmp_path):
    """Two runs into one file lost the first one, and both ended with exit status 0."""
    path, take = tmp_path / "a.mcap", recording(30)
    with LogWriter(path) as first:
        first.write_hand(take[0])
        first.flush()
        with pytest.raises(OutputError, match=r"another run is writing it.*another name") as caught:
            LogWriter(path, overwrite=True)
        if sys.platform == "linux":
            assert f"(process {os.getpid()})" in str(caught.value)
        for frame in list(take)[1:]:
            first.write_hand(frame)
    assert len(read_log(path).recording) == 30
    write(path, recording(2), overwrite=True)  # the first one has ended
    assert len(read_log(path).recording) == 2


def test_disk_that_fills_up_on_the_way(tmp_path, monkeypatch):
    hands = recording(30)
    log = LogWriter(tmp_path / "a.mcap", chunk_bytes=1)
    for frame in hands[:10]:
        log.write_hand(frame)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Writer, "flush", full)
    with log, pytest.raises(OutputError, match="no space is left on the device; free some space"):
        log.write_hand(hands[10])
    with pytest.raises(OutputError, match="stopped after an error"):
        log.write_hand(hands[11])
    monkeypatch.undo()
    assert_same(hands[:10], read_recording(tmp_path / "a.mcap"))


ONE_COMMAND = b"\x12\x01a\x1a\x08" + bytes(8)
"""The joint ``a`` at 0 rad, in Protocol Buffers."""


def foreign(path: Path, topic: str, data: bytes, version: str | None) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b'{"type":"object"}')
        metadata = {} if version is None else {"version": version}
        if topic == "/status":
            channel = writer.register_channel("/command", "protobuf", schema, metadata)
            writer.add_message(channel, 0, ONE_COMMAND, 0)
        channel = writer.register_channel(topic, "protobuf", schema, metadata)
        writer.add_message(channel, 0, data, 0)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("topic", "data", "version", "match"),
    [
        ("/camera", b"{}", None, "MCAP file from another program, with the topics /camera"),
        ("/hand", b"{}", None, "MCAP file from another program"),
        ("/hand", b"{}", "4", "version 4, but this program reads version 3; .* upgrade"),
        ("/hand", b"{}", "2", "version 2, but this program reads version 3"),
        ("/hand", b"{}", "3", "a message on /hand is not a valid smooth_operator.Hand"),
        ("/hand", b"", "3", "side must be .right. or .left., not"),
        ("/config", b"\x0a\x01{", "3", "or a field is wrong"),
        (
            "/command",
            ONE_COMMAND.replace(b"\x1a\x08", b"\x1a\x10") + bytes(8),
            "3",
            "a field is wrong",
        ),
        ("/status", b"\x10\x4d", "3", "77 is not a valid Status"),
    ],
)
def test_logs_of_others(tmp_path, topic, data, version, match):
    path = foreign(tmp_path / "a.mcap", topic, data, version)
    with pytest.raises(RecordingError, match=match):
        read_log(path)


def test_read_log_of_another_format(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros(3))
    with pytest.raises(RecordingError, match="not a log, but a file in another format"):
        read_log(tmp_path / "a.npy")
    with pytest.raises(RecordingError, match="no such file"):
        read_log(tmp_path / "b.mcap")


def test_parts_of_a_live_session_may_come_and_go(tmp_path):
    hands = recording(3)
    states = HandState("right", "hand", 0.5, NAMES, np.array([0.1, np.nan]), actuators=("m1",))
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write_origin({"name": "take", "task": "pinch", "meta": '{"glove": 3}'})
        log.write_hand(HandFrame(hands.landmarks[0], -2.5))  # before zero is a time as well
        log.write_hand(hands[1])
        log.write_method(1.0, "sbr", "live", {"weight": 0.5})
        log.write_state(states)
        log.write_state(replace(states, stamp=0.6, touch=np.ones(5)))
        for k in range(3):
            loop = LoopState(number=k, mode="holding", time=k + 0.1, events=("twice",) * k)
            wrist = WristCommand(np.arange(7.0), engaged=True, valid=k > 1)
            stages = {"solve": 1.0, **({"limit": 0.2} if k else {})}
            log.write_command(command(k), Status.OK, 1.0, stages, loop, wrist if k else None)
    back = read_log(tmp_path / "a.mcap")
    assert back.origin["task"] == "pinch"
    assert [(use.method, use.preset, use.config) for use in back.methods] == [
        ("sbr", "live", {"weight": 0.5})
    ]
    assert np.isnan(back.recording.metacarpals[0]).all()
    np.testing.assert_array_equal(back.recording.metacarpals[1], hands.metacarpals[1])
    assert back.recording.stamps[0] == -2.5
    np.testing.assert_array_equal(back.stages_ms["limit"], [np.nan, 0.2, 0.2])
    assert back.loop.events == {1: ("twice",), 2: ("twice", "twice")}
    assert back.loop.times.tolist() == [0.1, 1.1, 2.1]
    assert np.isnan(back.wrist.poses[0]).all()
    assert back.wrist.valid.tolist() == [False, False, True]
    assert back.states.actuators == ("m1",)
    np.testing.assert_array_equal(back.states.touch, [[np.nan] * 5, [1.0] * 5])


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
def test_a_part_of_a_log_is_found_by_its_index(tmp_path):
    """The index of the messages, as a viewer uses it that jumps to a time."""
    path = write(tmp_path / "a.mcap", recording(), chunk_bytes=20_000)
    everything = [(topic, m.log_time, m.data) for topic, m, _ in decoded(path)]
    times = sorted({at for _, at, _ in everything})
    start, end = times[len(times) // 3], times[len(times) // 2]
    with path.open("rb") as stream:
        part = make_reader(stream).iter_messages(start_time=start, end_time=end)
        found = [(channel.topic, one.log_time, one.data) for _, channel, one in part]
    assert len(found) > 20
    assert sorted(found) == sorted(one for one in everything if start <= one[1] < end)
