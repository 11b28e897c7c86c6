"""Logs of versions 1 and 2, whose messages are JSON, are read as today's, and converted to them."""

from __future__ import annotations

import dataclasses
import random
from pathlib import Path
from typing import Any

import fuzzing
import numpy as np
import pytest
from json_log import JsonLogWriter
from made_hands import hand_points
from mcap.reader import make_reader
from protobuf_log import decoded, plain

from smooth_operator.cli import main
from smooth_operator.errors import RecordingError
from smooth_operator.formats.readers import read_recording
from smooth_operator.teleop.recording import Log, LogWriter, read_log
from smooth_operator.teleop.recording.log_reader import count_log_frames
from smooth_operator.teleop.recording.loop_state import LoopState
from smooth_operator.teleop.runtime.log_timing import log_timing
from smooth_operator.teleop.sinks.tick import ArmCommand, HandState, WristCommand
from smooth_operator.types import HandFrame, JointCommand, Status

FRAMES = 30
NAMES = ("base", "tip", "späte")


def fill(log: Any) -> None:
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


def assert_same(a: Any, b: Any, where: str = "log") -> None:
    """Two values of dataclasses, arrays and containers, bit for bit."""
    assert type(a) is type(b), where
    if dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            if field.name not in ("name", "meta"):
                place = f"{where}.{field.name}"
                assert_same(getattr(a, field.name), getattr(b, field.name), place)
    elif isinstance(a, np.ndarray):
        assert (a.shape, a.dtype) == (b.shape, b.dtype), where
        np.testing.assert_array_equal(a, b, err_msg=where)
    elif isinstance(a, dict):
        assert a.keys() == b.keys(), where
        for key in a:
            assert_same(a[key], b[key], f"{where}[{key!r}]")
    elif isinstance(a, tuple) and len(a) == len(b):
        for i, (left, right) in enumerate(zip(a, b, strict=True)):
            assert_same(left, right, f"{where}[{i}]")
    else:
        assert a == b, where


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same session as it was written before, and as it is written now."""
    folder = tmp_path_factory.mktemp("logs")
    with JsonLogWriter(folder / "old.mcap", chunk_bytes=20_000) as old:
        fill(old)
    with LogWriter(folder / "new.mcap", chunk_bytes=20_000) as new:
        fill(new)
    return folder / "old.mcap", folder / "new.mcap"


def test_an_old_log_holds_what_a_new_one_does(logs: tuple[Path, Path]) -> None:
    old, new = map(read_log, logs)
    assert_same(old, new)
    assert new.recording is not None
    assert len(new.recording) == count_log_frames(logs[0]) == count_log_frames(logs[1]) == 24
    assert_everything(new)
    assert log_timing(old) == log_timing(new)


def assert_everything(log: Log) -> None:
    """Against what was written, not only against each other."""
    assert log.commands is not None
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
    assert log.loop is not None
    assert log.loop.events == {k: (f"event {k}", "twice") for k in (0, 11, 22)}
    assert log.loop.modes[:6] == ("holding", *["tracking"] * 4, "holding")
    np.testing.assert_array_equal(log.loop.numbers, np.arange(FRAMES))
    np.testing.assert_array_equal(log.loop.answers, np.arange(FRAMES) % 5 > 0)
    assert log.wrist is not None
    assert np.isnan(log.wrist.poses[:2]).all()
    assert log.wrist.engaged.tolist() == [k > 9 for k in range(FRAMES)]
    assert log.arm is not None
    assert np.isnan(log.arm.positions[20]).all()
    assert np.isfinite(log.arm.measured[[8, 29]]).all()
    assert np.isnan(log.arm.measured[:8]).all()
    assert log.states is not None
    assert log.states.actuators == ("m1", "m2")
    assert log.states.touch is not None
    assert np.isnan(log.states.touch[:3]).all()
    assert log.states.touch.shape == (15, 5)
    recording = log.recording
    assert recording is not None
    assert recording.side == "left"
    assert recording.world == "room"
    assert recording.T_world_wrist is not None
    assert np.isfinite(recording.T_world_wrist[-1]).all()
    assert recording.metacarpals is not None
    assert np.isnan(recording.metacarpals[0]).all()


def test_live_messages_are_decoded_by_the_types_in_the_file(tmp_path: Path) -> None:
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
    np.testing.assert_equal(
        found["/loop"],
        {
            "stamp": 3.0, "number": 2**40, "mode": "holding", "time": 1.5, "received": np.nan,
            "tracker_stamp": np.nan, "session": -2, "tracking_loss": np.nan, "scale": 1.1,
            "events": ["späte", "b"],
        },
    )  # fmt: skip
    assert found["/wrist"] == {
        "stamp": 3.0, "pose": pose.tolist(), "engaged": True, "valid": False, "world": "base",
    }  # fmt: skip
    np.testing.assert_equal(
        found["/arm"],
        {
            "stamp": 3.0, "name": "ur5e", "names": ["a", "b"], "positions": [0.1, np.nan],
            "velocities": [0.0, 0.0], "measured": [], "pose": pose.tolist(), "state": "following",
            "clearance": np.inf, "position_error": 0.5, "rotation_error": np.nan,
        },
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*_time is deprecated:DeprecationWarning")
def test_a_part_of_a_log_is_found_by_its_index(logs: tuple[Path, Path]) -> None:
    """The index of the messages, as a viewer uses it that jumps to a time."""
    everything = [(topic, m.log_time, m.data) for topic, m, _ in decoded(logs[1])]
    times = sorted({at for _, at, _ in everything})
    start, end = times[len(times) // 3], times[len(times) // 2]
    with logs[1].open("rb") as stream:
        found = [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(stream).iter_messages(
                start_time=start, end_time=end
            )
        ]
    assert len(found) > 20
    assert sorted(found) == sorted(one for one in everything if start <= one[1] < end)


def test_the_status_of_version_1_is_in_the_command(tmp_path: Path, logs: tuple[Path, Path]) -> None:
    with JsonLogWriter(tmp_path / "a.mcap", version="1") as log:
        fill(log)
    assert_same(read_log(tmp_path / "a.mcap"), read_log(logs[1]))


def test_an_old_log_is_converted(tmp_path: Path, logs: tuple[Path, Path]) -> None:
    target = tmp_path / "new.mcap"
    assert main(["convert", str(logs[0]), "--output", str(target), "--quiet"]) == 0
    old, new = read_log(logs[0]), read_log(target)
    for name in ("recording", "commands", "config", "stages_ms", "wrist", "arm"):
        assert_same(getattr(old, name), getattr(new, name), name)
    assert old.states is not None
    assert new.states is not None
    assert_same(old.states.positions, new.states.positions)
    assert new.loop is None  # mode and events stay in the log of the session


def test_an_old_log_that_was_cut_off_is_read(tmp_path: Path, logs: tuple[Path, Path]) -> None:
    content = logs[0].read_bytes()
    whole = read_log(logs[0])
    assert whole.commands is not None
    seen = set()
    for length in np.linspace(10, len(content) - 1, 12, dtype=int):
        (tmp_path / "cut.mcap").write_bytes(content[:length])
        log = read_log(tmp_path / "cut.mcap")
        assert log.truncated
        if log.commands is not None:
            seen.add(len(log.commands))
            expected = whole.commands.joint_positions[: len(log.commands)]
            np.testing.assert_array_equal(log.commands.joint_positions, expected)
    assert len(seen) > 2


@pytest.mark.parametrize("which", [0, 1])
def test_damaged_logs_are_refused_or_read_in_part(
    tmp_path: Path, logs: tuple[Path, Path], which: int
) -> None:
    content, rng = logs[which].read_bytes(), random.Random(which)
    outcomes = set()
    for _ in range(25):
        (tmp_path / "a.mcap").write_bytes(fuzzing.mutate_bytes(rng, content))
        try:
            outcomes.add(len(read_recording(tmp_path / "a.mcap")))
        except RecordingError as error:
            outcomes.add(str(error).count("\n"))
    assert max(outcomes) > 0
