"""Recordings and commands through every format and back: nothing is lost or overwritten."""

import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from made_hands import hand_points
from mcap.writer import Writer

from smooth_operator import read_commands, read_recording, write_commands
from smooth_operator.episode_files.lerobot import write_dataset
from smooth_operator.episode_files.lerobot.tables import (
    column_statistics,
    joint_statistics,
    standard_fps,
)
from smooth_operator.errors import ConfigError, MissingExtraError, OutputError, RecordingError
from smooth_operator.extras import install_command
from smooth_operator.formats.checks import reading_notes
from smooth_operator.formats.episode import Episode
from smooth_operator.landmarks import LAYOUTS
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.recording import LogWriter, read_episode, write_episode
from smooth_operator.teleop.recording.convert import Format
from smooth_operator.types import CommandTrajectory, HandFrame, HandRecording, Side, Status

FRAMES = 40
JOINTS = ("base", "middle", "tip")
CONFIG = {
    "program": "smooth-operator",
    "hand": "mimic_p050",
    "limit": "inf",
    "list": [1, 2.5, None],
}

Run = Callable[..., tuple[int, str]]


def hand(
    *, side: Side = "right", rich: bool = True, seed: int = 0, name: str = "a"
) -> HandRecording:
    """Irregular stamps, missing landmarks, flags that only the tracker knows."""
    rng = np.random.default_rng(seed)
    points = hand_points(FRAMES, seed, side)
    points[3:5, 8] = np.nan
    points[6] = np.nan  # a frame without any
    points[7, 4, 1] = -0.0
    valid = rng.random((FRAMES, 21)) > 0.02
    valid[:, [0, 9]] = True
    orientations = rng.normal(size=(FRAMES, 21, 4))
    orientations[2, 5] = np.nan
    return HandRecording(
        points,
        1.7e9 + np.cumsum(rng.uniform(0.005, 0.015, FRAMES)),
        side,
        valid=valid,
        metacarpals=rng.normal(size=(FRAMES, 4, 3)) if rich else None,
        orientations=orientations if rich else None,
        name=name,
        meta={"glove_ids": [7], "format": "manus"},
    )


def answers(stamps: np.ndarray, seed: int = 0) -> CommandTrajectory:
    rng = np.random.default_rng(seed)
    latency = rng.uniform(0.1, 2.0, len(stamps))
    latency[1] = np.nan
    return CommandTrajectory(
        rng.normal(size=(len(stamps), len(JOINTS))),
        JOINTS,
        stamps,
        latency,
        rng.integers(0, len(Status), len(stamps)).astype(np.int8),
    )


def episode(
    *, side: Side = "right", rich: bool = True, parts: str = "both", seed: int = 0, name: str = "a"
) -> Episode:
    recording = hand(side=side, rich=rich, seed=seed, name=name)
    commands = answers(recording.stamps, seed)
    stages = {
        "align/scale": np.where(np.arange(FRAMES) % 3, 0.25, np.nan),
        "solve": np.linspace(0, 1, FRAMES),
    }
    return Episode(
        recording=None if parts == "commands" else recording,
        commands=None if parts == "hand" else commands,
        config=CONFIG if rich else None,
        stages_ms=stages if rich and parts != "hand" else {},
        task="pinch — daumen" if rich else None,
        name=name,
    )


def assert_same(a: Episode, b: Episode) -> None:
    """Compares to the last bit, with NaN and the sign of zero."""

    def content(each: Episode) -> dict[str, Any]:
        hand, commands = each.recording, each.commands
        found: dict[str, Any] = {f"stage {name}": times for name, times in each.stages_ms.items()}
        if hand is not None:
            names = ("landmarks", "stamps", "valid", "metacarpals", "orientations", "side", "name")
            found |= {f"hand {name}": getattr(hand, name) for name in names}
        if commands is not None:
            names = ("joint_positions", "joint_names", "stamps", "latency_ms", "status")
            found |= {f"command {name}": getattr(commands, name) for name in names}
        return found

    assert (a.config, a.task, a.name, a.meta) == (b.config, b.task, b.name, b.meta)
    left, right = content(a), content(b)
    assert left.keys() == right.keys()
    for name, value in left.items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value, right[name], err_msg=name)
            np.testing.assert_array_equal(np.signbit(value), np.signbit(right[name]), err_msg=name)
        else:
            assert value == right[name], name


NAMES: dict[Format, str] = {"mcap": "e.mcap", "npz": "e.npz", "hdf5": "e.h5", "lerobot": "e"}


def write(folder: Path, value: Episode, to: Format) -> Path:
    path = folder / NAMES[to]
    if to == "lerobot":
        write_dataset(path, [lambda: value])
    else:
        write_episode(path, value)
    return path


@pytest.fixture
def run(run) -> Run:
    """``smooth-operator convert`` in this process: exit status and standard error."""

    def call(*arguments: object) -> tuple[int, str]:
        status, out, err = run("convert", *arguments)
        assert out == ""
        return status, err

    return call


@pytest.mark.parametrize(("side", "rich"), [("right", False), ("left", True)])
def test_an_episode_through_every_format_one_after_the_other(tmp_path, side, rich):
    value = last = episode(side=side, rich=rich)
    for to in NAMES:
        last = read_episode(write(tmp_path, last, to))
        assert_same(value, last)
        assert last.notes == ()


def some_commands(value: Episode, frames: list[int]) -> Episode:
    """The episode with the commands of some frames, and one stage."""
    names = ("joint_positions", "stamps", "latency_ms", "status")
    kept = {name: getattr(value.commands, name)[frames] for name in names}
    stages = {"solve": np.arange(float(len(frames)))}
    return replace(value, commands=replace(value.commands, **kept), stages_ms=stages)


@pytest.mark.parametrize("to", NAMES)
@pytest.mark.parametrize(
    "value",
    [episode(parts="hand"), episode(parts="commands"), some_commands(episode(), [2, 3, 9, 30])],
    ids=["no commands", "no hand", "commands of some frames"],
)
def test_a_part_of_an_episode(tmp_path, to, value):
    assert_same(value, read_episode(write(tmp_path, value, to)))


@pytest.mark.parametrize("to", NAMES)
def test_one_frame(tmp_path, to):
    value = some_commands(episode(), [0]).sliced(slice(0, 1))
    if to == "lerobot":
        with pytest.raises(ConfigError, match="set it with --fps"):
            write_dataset(tmp_path / "e", [lambda: value])
        write_dataset(tmp_path / "e", [lambda: value], fps=30)
    else:
        write_episode(tmp_path / NAMES[to], value)
    assert_same(value, read_episode(tmp_path / NAMES[to]))


@pytest.mark.parametrize("to", ["mcap", "npz", "hdf5"])
def test_commands_with_other_stamps_than_the_frames(tmp_path, to):
    value = episode()
    stamps = value.commands.stamps.copy()
    stamps[20:] += 0.001
    value = replace(value, commands=replace(value.commands, stamps=stamps))
    path = write(tmp_path, value, to)
    assert_same(value, read_episode(path))
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.stamps, value.recording.stamps)
    with pytest.raises(
        RecordingError, match=r"20 commands do not belong to any frame.*\.mcap or \.h5"
    ):
        write_dataset(tmp_path / "d", [lambda: value])
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize(
    ("rate", "fps"), [(95.3, 100), (97, 100), (29.97, 30), (118.5, 120), (22.7, 23), (44.0, 44)]
)
def test_a_data_set_has_a_standard_rate(rate, fps):
    assert standard_fps(rate) == fps


def test_held_commands_of_a_live_loop_are_not_rows_of_a_dataset(tmp_path):
    value = episode()
    stamps = value.commands.stamps.copy()
    stamps[20:23] += 0.001  # the tracker was silent
    commands = replace(value.commands, stamps=stamps)
    notes = write_dataset(tmp_path / "d", [lambda: replace(value, commands=commands, live=True)])
    assert any(note.startswith("skipped 3 commands for which") for note in notes)
    assert any(note.startswith(f"3 of {len(value)} frames have no command") for note in notes)
    back = read_episode(tmp_path / "d")
    kept = np.delete(np.arange(len(stamps)), np.arange(20, 23))
    np.testing.assert_array_equal(
        back.commands.joint_positions, value.commands.joint_positions[kept]
    )
    assert back.answered().tolist() == kept.tolist()


IMPOSSIBLE = [
    ("joint_positions", (5, 1), np.nan, r"command 5 has 'middle' at nan rad \(1 of 40"),
    ("joint_positions", (5, 1), np.inf, "command 5 has 'middle' at inf rad"),
    ("joint_positions", (5, 1), 1e15, "command 5 has 'middle' at 1e[+]15 rad"),
    ("stamps", 6, episode().commands.stamps[5], "commands 5 and 6 have the same timestamp"),
    ("stamps", 6, 1.7e9, "the timestamps go backwards at command 6"),
    ("stamps", -1, 1.2e10, "1.03e[+]10 s, but at most 1e[+]09 s"),
]


@pytest.mark.parametrize(("name", "at", "value", "said"), IMPOSSIBLE)
def test_impossible_commands_are_refused(tmp_path, run, name, at, value, said):
    good = episode().commands
    arrays = {"joint_positions": good.joint_positions, "stamps": good.stamps}
    arrays = {key: array.copy() for key, array in arrays.items()}
    arrays |= {"status": np.full(FRAMES, int(Status.OK), np.int8), "latency_ms": good.latency_ms}
    arrays[name][at] = value
    if value == 1e15:
        arrays["status"][5] = int(Status.INVALID_LANDMARKS)  # of a command that is held, too
    with pytest.raises(RecordingError, match=said):
        Episode(commands=replace(good, **arrays))
    path = tmp_path / "bad.npz"
    stored = {"timestamps" if key == "stamps" else key: array for key, array in arrays.items()}
    np.savez(path, joint_names=np.array(good.joint_names), **stored)
    status, err = run(path, "--to", "mcap", "--output", tmp_path / "out")
    assert status == 2
    assert re.search(rf"bad\.npz: .*{said}", err), err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("to", ["mcap", "hdf5"])
def test_files_of_other_programs_with_impossible_commands_are_refused(tmp_path, to, monkeypatch):
    commands = episode().commands
    commands.joint_positions[5, 1] = 1e15
    write(tmp_path, episode(), to)  # imports the module of the format, with the check
    with monkeypatch.context() as patch:
        patch.setattr("smooth_operator.formats.episode.check_commands", lambda *_: None)
        path = write(tmp_path, Episode(commands=commands), to)
    with pytest.raises(RecordingError, match=f"{path.name}: command 5 has 'middle'"):
        read_episode(path)


def test_a_command_that_answers_no_frame_may_be_unknown(tmp_path):
    value = episode().commands
    positions, status = value.joint_positions.copy(), np.array(value.status)
    positions[5], status[5] = np.nan, int(Status.INVALID_LANDMARKS)
    commands = replace(value, joint_positions=positions, status=status)
    path = write(tmp_path, Episode(commands=commands), "mcap")
    assert np.isnan(read_episode(path).commands.joint_positions[5]).all()


def test_infinities_in_a_log_are_reported(tmp_path, run):
    value = episode()
    value.commands.latency_ms[4] = np.inf
    write_episode(tmp_path / "a.h5", value)
    assert_same(value, read_episode(tmp_path / "a.h5"))
    status, err = run(tmp_path / "a.h5", "--output", tmp_path / "a.mcap", "--quiet")
    assert status == 0
    assert "1 infinite values of latency_ms become NaN" in err


def test_npz_is_what_the_other_commands_read(tmp_path):
    value = episode(side="left")
    path = write(tmp_path, value, "npz")
    back = read_recording(path)
    assert back.side == "left"
    np.testing.assert_array_equal(back.landmarks, value.recording.landmarks)
    np.testing.assert_array_equal(back.valid, value.recording.valid)
    np.testing.assert_array_equal(read_commands(path).status, value.commands.status)
    assert json.loads((tmp_path / "e.json").read_text()) == CONFIG
    with np.load(path, allow_pickle=False) as arrays:
        assert arrays["landmarks"].dtype == np.float64
        assert "landmark_timestamps" not in arrays


def test_arrays_of_other_shapes_are_ignored(tmp_path):
    points = hand(side="left").landmarks
    path = tmp_path / "a.npz"
    odd = {"metacarpals": np.ones((FRAMES, 3, 3)), "orientations": np.ones((FRAMES, 21, 3, 3))}
    np.savez(path, landmarks=points, timestamps=hand().stamps, side="left", **odd)
    back = read_recording(path)
    assert back.orientations is None
    assert back.metacarpals is None
    (note,) = reading_notes(back, "a.npz")
    assert "ignored: metacarpals, orientations" in note


def test_a_log_whose_stamps_do_not_increase_is_refused(tmp_path):
    landmarks = SyntheticOperator(seed=1).record(1.0).landmarks
    with LogWriter(tmp_path / "a.mcap") as log:
        for stamp, points in zip((0.2, 0.3, 0.1), landmarks, strict=False):
            log._hand_stamp = -np.inf  # another program's writer may not look at it
            log.write_hand(HandFrame(points, stamp))
    with pytest.raises(RecordingError, match=r"a\.mcap: .*go backwards"):
        read_episode(tmp_path / "a.mcap")


def test_hdf5_as_it_is_documented(tmp_path):
    value = episode()
    assert value.commands is not None
    with h5py.File(write(tmp_path, value, "hdf5")) as file:
        found: dict[str, Any] = {}
        file.visititems(lambda name, item: found.update({name: item}))
        arrays = {
            k: (v.shape, v.attrs.get("units")) for k, v in found.items() if hasattr(v, "shape")
        }
        assert dict(file.attrs)["format"] == "smooth-operator"
        assert file["commands/status"].attrs["status_names"][1] == "INVALID_LANDMARKS"
        assert json.loads(file["configuration"][()]) == CONFIG
        stage = file["commands/stages_ms/align_scale"].attrs["stage"]
    assert stage == "align/scale"
    assert arrays == {
        "hand/landmarks": ((40, 21, 3), "m"),
        "hand/stamps": ((40,), "s"),
        "hand/valid": ((40, 21), None),
        "hand/metacarpals": ((40, 4, 3), "m"),
        "hand/orientations": ((40, 21, 4), "quaternion wxyz"),
        "commands/joint_positions": ((40, 3), "rad"),
        "commands/joint_names": ((3,), None),
        "commands/stamps": ((40,), "s"),
        "commands/latency_ms": ((40,), "ms"),
        "commands/status": ((40,), None),
        "commands/stages_ms/align_scale": ((40,), "ms"),
        "commands/stages_ms/solve": ((40,), "ms"),
        "configuration": ((), None),
    }


def test_hdf5_of_other_programs(tmp_path):
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["hand/landmarks"] = hand().landmarks.astype(np.float32)
    with pytest.raises(RecordingError, match="40 frames and no timestamps; give the number"):
        read_recording(path)
    with pytest.raises(RecordingError, match="judging by its shape, this is a right hand"):
        read_recording(path, rate=50.0, side="left")
    found = read_episode(path, rate=50.0)
    assert "does not state the side" in found.notes[0]
    with h5py.File(path, "r+") as file:
        file["hand/landmarks"][...] *= 1000.0
    with pytest.raises(RecordingError, match="millimetres"):
        read_episode(path, rate=50.0)


def test_dataset_read_with_pyarrow_alone(tmp_path):
    """Against the layout of LeRobot v3.0, which its loader reads by these names and types."""
    values = [episode(name="a"), episode(name="b", seed=1, rich=False)]
    root = tmp_path / "set"
    notes = write_dataset(root, [lambda v=v: v for v in values])
    info = json.loads((root / "meta" / "info.json").read_text())
    data = pq.read_table(root / info["data_path"].format(chunk_index=0, file_index=0))
    listed = {
        "observation.state": ("float", 63),
        "action": ("float", 3),
        "stamp": ("double", None),
        "right_landmarks": ("double", 63),
        "right_landmarks_valid": ("bool", 21),
        "right_metacarpals": ("double", 12),
        "right_orientations": ("double", 84),
        "joint_positions": ("double", 3),
        "command_stamp": ("double", None),
        "status": ("int64", None),
        "latency_ms": ("double", None),
        "stages_ms": ("double", 2),
        "timestamp": ("float", None),
        "frame_index": ("int64", None),
        "episode_index": ("int64", None),
        "index": ("int64", None),
        "task_index": ("int64", None),
    }
    assert data.column_names == list(listed) == list(info["features"])
    for name, (kind, width) in listed.items():
        found = data.schema.field(name).type
        if width is not None:
            assert (found.list_size, len(info["features"][name]["names"])) == (width, width), name
            found = found.value_type
        assert str(found) == kind, name
        dtype = {"float": "float32", "double": "float64"}.get(kind, kind)
        assert info["features"][name]["dtype"] == dtype, name
        assert info["features"][name]["shape"] == [width or 1], name
        assert data[name].null_count == 0
    assert pq.ParquetFile(root / "data/chunk-000/file-000.parquet").num_row_groups == 2

    fps = info["fps"]
    spans = [float(value.stamps[-1] - value.stamps[0]) for value in values]
    assert fps == standard_fps(float(np.median([(FRAMES - 1) / span for span in spans])))
    for number in (0, 1):
        rows = data.filter(pa.compute.equal(data["episode_index"], number))
        assert rows["frame_index"].to_pylist() == list(range(FRAMES))
        nominal = (np.arange(FRAMES) / fps).astype(np.float32)
        np.testing.assert_array_equal(rows["timestamp"].to_numpy(), nominal)
        recording = values[number].recording
        np.testing.assert_array_equal(rows["stamp"].to_numpy(), recording.stamps)
    assert data["index"].to_pylist() == list(range(2 * FRAMES))
    state = np.array(data["observation.state"].to_pylist(), np.float32).reshape(-1, 21, 3)
    np.testing.assert_array_equal(state[:FRAMES], values[0].recording.landmarks.astype(np.float32))
    assert any(f"(frame_index / {fps})" in note for note in notes)
    assert any("6 of 80 frames have missing landmarks" in note for note in notes)

    totals = {k: info[k] for k in ("total_episodes", "total_frames", "total_tasks", "splits")}
    assert totals == {
        "total_episodes": 2,
        "total_frames": 80,
        "total_tasks": 2,
        "splits": {"train": "0:2"},
    }
    assert (info["codebase_version"], info["video_path"]) == ("v3.0", None)
    tasks = pq.read_table(root / "meta" / "tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0, 1], "task": ["pinch — daumen", "unnamed"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    episodes = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pydict()
    assert episodes["dataset_from_index"] == [0, FRAMES]
    assert episodes["dataset_to_index"] == [FRAMES, 2 * FRAMES]
    assert episodes["tasks"] == [["pinch — daumen"], ["unnamed"]]
    assert episodes["meta/episodes/file_index"] == episodes["data/file_index"] == [0, 0]
    assert episodes["stats/action/count"] == [[FRAMES], [FRAMES]]
    stats = json.loads((root / "meta" / "stats.json").read_text(), parse_constant=pytest.fail)
    assert stats.keys() == info["features"].keys()
    np.testing.assert_allclose(
        stats["observation.state"]["mean"], np.nanmean(state.reshape(80, 63), axis=0), atol=1e-7
    )


def test_dataset_in_several_files(tmp_path, monkeypatch):
    monkeypatch.setattr("smooth_operator.episode_files.lerobot.writer.FILE_MB", 0)
    monkeypatch.setattr("smooth_operator.episode_files.lerobot.writer.FILES_A_CHUNK", 2)
    monkeypatch.setattr("smooth_operator.episode_files.lerobot.writer._KEPT_BYTES", 0)
    values = [episode(seed=i, name=f"take {i}") for i in range(3)]
    write_dataset(tmp_path / "d", [lambda v=v: v for v in values])
    files = sorted((tmp_path / "d" / "data").rglob("*.parquet"))
    names = [file.relative_to(tmp_path / "d" / "data").as_posix() for file in files]
    assert names == [
        "chunk-000/file-000.parquet",
        "chunk-000/file-001.parquet",
        "chunk-001/file-000.parquet",
    ]
    for i, value in enumerate(values):
        assert_same(value, read_episode(tmp_path / "d", episode=i))


def test_dataset_whose_extra_metadata_another_tool_dropped(tmp_path):
    value = episode(side="left")
    root = write(tmp_path, value, "lerobot")
    file = root / "meta/episodes/chunk-000/file-000.parquet"
    rewritten(lambda t: t.drop_columns(["smooth_operator"]))(file)
    data = root / "data/chunk-000/file-000.parquet"
    table = pq.read_table(data)
    # Lists of any length and null for NaN, as pandas writes them.
    lists = {
        name: pa.array(table[name].to_pylist(), from_pandas=True) for name in table.column_names
    }
    pq.write_table(pa.table(lists), data)
    back = read_episode(root)
    expected = replace(value, config=None, name="episode_000000")
    recording = replace(expected.recording, name="episode_000000", meta={})
    assert_same(replace(expected, recording=recording), back)
    with pytest.raises(RecordingError, match="a left hand, but side 'right' was requested"):
        read_episode(root, side="right")


def test_a_dataset_of_another_tool_is_checked(tmp_path):
    landmarks = SyntheticOperator(seed=3).record(0.5).landmarks

    def read(points: np.ndarray, side: Side, name: str, **asked: Any) -> HandRecording:
        """What comes back of points in a dataset that lacks this program's own column."""
        stamps = np.arange(len(points)) / 100
        value = Episode(HandRecording(points, stamps, side, name=name), name=name)
        root = tmp_path / name
        write_dataset(root, [lambda: value])
        file = root / "meta/episodes/chunk-000/file-000.parquet"
        rewritten(lambda t: t.drop_columns(["smooth_operator"]))(file)
        return read_episode(root, **asked).recording

    np.testing.assert_array_equal(read(landmarks, "right", "fine").landmarks, landmarks)
    with pytest.raises(RecordingError, match="the file says left hand: correct the side"):
        read(landmarks, "left", "side")
    with pytest.raises(RecordingError, match=r"millimetres \(multiply by 0.001\)"):
        read(1e3 * landmarks, "right", "units")
    points = np.empty_like(landmarks)
    points[:, LAYOUTS["mano"]] = landmarks
    with pytest.raises(RecordingError, match="use --layout mano"):
        read(points, "right", "order")
    back = read_episode(tmp_path / "order", layout="mano").recording
    np.testing.assert_array_equal(back.landmarks, landmarks)


def test_statistics_ignore_missing_values():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(50, 3))
    values[:20, 1] = np.nan
    values[:, 2] = np.nan
    parts = [column_statistics(values[:30]), column_statistics(values[30:])]
    whole, joint = column_statistics(values), joint_statistics(parts)
    assert whole.to_lists()["count"] == joint.to_lists()["count"] == [50]
    for name, reduce in (("mean", np.mean), ("std", np.std), ("min", np.min), ("max", np.max)):
        expected = [reduce(values[:, 0]), reduce(values[20:, 1]), 0.0]
        np.testing.assert_allclose(whole.values[name], expected, atol=1e-12)
        np.testing.assert_allclose(joint.values[name], expected, atol=1e-12)
    assert whole.values["q50"][1] == np.median(values[20:, 1])
    assert column_statistics(np.array([True, False, False])).values["mean"] == pytest.approx(1 / 3)


def save(path: Path, value: Episode) -> Path:
    """A recording as the trackers' files are: arrays, and nothing that is this program's own."""
    recording = value.recording
    arrays = {"landmarks": recording.landmarks, "timestamps": recording.stamps}
    np.savez(path, **arrays, side=recording.side)
    return path


def results(path: Path, value: Episode) -> Path:
    path.parent.mkdir(exist_ok=True)
    write_commands(path, value.commands, CONFIG)
    return path


@pytest.mark.parametrize("to", NAMES)
def test_commands_beside_a_recording(tmp_path, run, to):
    value = episode(side="left")
    glove = save(tmp_path / "glove.npz", value)
    out = results(tmp_path / "out.npz", value)
    target = tmp_path / NAMES[to]
    status, err = run(glove, "--commands", out, "--output", target, "--task", "turn")
    assert (status, f"wrote {target}" in err) == (0, True), err
    back = read_episode(target)
    assert (back.config, back.task, back.recording.side) == (CONFIG, "turn", "left")
    np.testing.assert_array_equal(back.commands.joint_positions, value.commands.joint_positions)
    np.testing.assert_array_equal(back.commands.status, value.commands.status)


def test_frames_keep_their_commands(tmp_path, run):
    value = episode()
    write_episode(tmp_path / "a.h5", value)
    assert run(tmp_path / "a.h5", "--frames", "10:25", "--output", tmp_path / "b.mcap")[0] == 0
    assert_same(value.sliced(slice(10, 25)), read_episode(tmp_path / "b.mcap"))
    back = read_episode(tmp_path / "b.mcap")
    assert back.answered().tolist() == list(range(15))

    glove = save(tmp_path / "glove.npz", value)
    out = results(tmp_path / "out.npz", value.sliced(slice(10, 25)))
    status, err = run(glove, "--commands", out, "--output", tmp_path / "c.h5")
    assert status == 0
    assert "has commands for 15 of the 40 frames" in err
    assert read_episode(tmp_path / "c.h5").answered().tolist() == list(range(10, 25))


def test_commands_of_another_recording_are_refused(tmp_path, run):
    glove = save(tmp_path / "glove.npz", episode())
    out = results(tmp_path / "out.npz", episode(seed=5))
    status, err = run(glove, "--commands", out, "--output", tmp_path / "a.mcap")
    assert status == 2
    assert "was not made from" in err
    assert "0 of its 40 timestamps" in err
    assert run(glove, "--commands", glove, "--output", tmp_path / "a.mcap")[1].count("no commands")
    status, err = run(out, "--commands", out, "--output", tmp_path / "a.mcap")
    assert "this contains no hand frames" in err
    assert not (tmp_path / "a.mcap").exists()


def test_folder_to_dataset_and_back(tmp_path, run):
    source, outcome = tmp_path / "in", tmp_path / "in" / "results"
    (source / "day 2").mkdir(parents=True)
    values = {"one": episode(seed=1), "day 2/two": episode(seed=2, side="left")}
    for name, value in values.items():
        save(source / f"{name}.npz", value)
        (outcome / name).parent.mkdir(parents=True, exist_ok=True)
        results(outcome / f"{name}.npz", value)
    (source / "notes.txt").write_text("x")
    (source / ".hidden.npz").write_text("x")
    root = tmp_path / "set"
    status, err = run(source, "--commands", outcome, "--task", "pinch", "--output", root)
    assert status == 0, err
    assert "skipped (unknown format): notes.txt" in err
    assert "wrote" in err
    assert "2 episodes, 80 frames" in err

    assert run(root, "--to", "hdf5", "--output", tmp_path / "back", "--quiet") == (0, "")
    files = sorted((tmp_path / "back").iterdir())
    assert [file.name for file in files] == ["episode_000000_two.h5", "episode_000001_one.h5"]
    for file, value in zip(files, (values["day 2/two"], values["one"]), strict=True):
        found = read_episode(file)
        assert (found.recording.side, found.task) == (value.recording.side, "pinch")
        np.testing.assert_array_equal(found.recording.landmarks, value.recording.landmarks)

    assert run(root, "--episode", 1, "--output", tmp_path / "one.mcap")[0] == 0
    assert read_episode(tmp_path / "one.mcap").name == "one"
    assert (
        "there is no episode 2; the data set has 2, with the numbers 0 to 1"
        in run(root, "--episode", 2, "--output", tmp_path / "no.npz")[1]
    )
    status, err = run(source, "--to", "mcap", "--output", tmp_path / "logs")
    assert status == 0, err
    made = {p.relative_to(tmp_path / "logs").as_posix() for p in tmp_path.glob("logs/**/*.mcap")}
    assert made == {"one.mcap", "day 2/two.mcap", "results/one.mcap", "results/day 2/two.mcap"}


def test_datasets_and_damaged_files_in_a_folder(tmp_path, run):
    source = tmp_path / "in"
    source.mkdir()
    write(source, episode(name="x y"), "lerobot")
    write_episode(source / "b.mcap", episode(name="b", seed=1))
    assert run(source, "--to", "npz", "--output", tmp_path / "out")[0] == 0
    made = {p.relative_to(tmp_path / "out").as_posix() for p in tmp_path.glob("out/**/*.npz")}
    assert made == {"b.npz", "e/episode_000000_x_y.npz"}
    assert_same(episode(name="b", seed=1), read_episode(tmp_path / "out" / "b.npz"))

    (source / "c.npz").write_bytes((tmp_path / "out" / "b.npz").read_bytes()[:-60])
    status, err = run(source, "--output", tmp_path / "set")
    assert (status, "c.npz: the file is damaged or incomplete" in err) == (2, True), err
    assert {p.name for p in tmp_path.iterdir()} == {"in", "out"}


def test_a_log_of_another_program_is_not_replaced(tmp_path, run):
    path = write(tmp_path, episode(), "hdf5")
    with (tmp_path / "ros.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/camera", "json", 0)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    status, err = run(path, "--output", tmp_path / "ros.mcap", "--overwrite")
    assert (status, "was not written by this program as mcap" in err) == (2, True)


def test_episodes_of_a_dataset_must_have_the_same_parts(tmp_path):
    first, other = episode(name="a"), episode(name="b", seed=1)
    joints = replace(other.commands, joint_names=("x", "y", "z"))
    for second, match in (
        (replace(other, commands=None, stages_ms={}), "a has commands but b has none"),
        (replace(other, recording=None), "a has hand frames but b has none"),
        (replace(other, commands=joints), "commands for different joints"),
    ):
        with pytest.raises(RecordingError, match=match):
            write_dataset(tmp_path / "set", [lambda: first, lambda second=second: second])
    assert not list(tmp_path.iterdir())


def test_existing_outputs(tmp_path, run):
    value = episode()
    for to in NAMES:
        source = write(tmp_path, value, "hdf5" if to != "hdf5" else "mcap")
        target = tmp_path / f"x{Path(NAMES[to]).suffix}"
        assert run(source, "--output", target, "--quiet")[0] == 0
        before = read_episode(target)
        status, err = run(source, "--output", target, "--task", "new")
        assert (status, "it already exists; add --overwrite" in err) == (2, True), err
        assert_same(before, read_episode(target))
        assert run(source, "--output", target, "--task", "new", "--overwrite")[0] == 0
        assert read_episode(target).task == "new"

        # What this program did not write stays, whatever is said.
        if to == "lerobot":
            (target / "mine.txt").write_text("x")
        else:
            target.write_bytes(save(tmp_path / "glove.npz", value).read_bytes())
        status, err = run(source, "--output", target, "--overwrite")
        assert (status, "was not written by this program" in err) == (2, True), err
    assert not list(tmp_path.glob(".*")), "no debris"


def test_the_rate_applies_to_files_without_stamps(tmp_path, run):
    """As for ``retarget FOLDER``: files with stamps keep theirs, the others are counted."""
    folder = tmp_path / "in"
    folder.mkdir()
    stamped = save(folder / "a.npz", episode(parts="hand"))
    np.save(folder / "b.npy", hand(rich=False).landmarks)
    out = tmp_path / "out"
    status, err = run(folder, "--to", "npz", "--output", out)
    assert (status, "no timestamps; give the number" in err) == (2, True)
    assert run(folder, "--to", "npz", "--rate", 30, "--output", out, "--overwrite")[0] == 0
    kept, counted = (read_episode(out / f"{name}.npz").recording for name in "ab")
    np.testing.assert_array_equal(kept.stamps, read_recording(stamped).stamps)
    np.testing.assert_allclose(counted.stamps, np.arange(FRAMES) / 30.0)
    # one file that is named is another matter: there the two contradict each other
    status, err = run(stamped, "--rate", 30, "--output", tmp_path / "x.npz")
    assert (status, "contradict --rate 30" in err) == (2, True)


def test_a_dataset_becomes_another_only_on_request(tmp_path, run):
    root = write(tmp_path, episode(), "lerobot")
    status, err = run(root, "--output", tmp_path / "back")
    assert (status, "use --to npz, mcap or hdf5" in err) == (2, True)
    assert not (tmp_path / "back").exists()
    assert run(root, "--to", "npz", "--output", tmp_path / "back")[0] == 0
    assert run(root, "--to", "lerobot", "--output", tmp_path / "again")[0] == 0
    assert (tmp_path / "again" / "meta" / "info.json").is_file()


def test_an_input_is_never_the_output(tmp_path, run):
    for to in ("npz", "lerobot"):
        path = write(tmp_path, episode(), to)
        status, err = run(path, "--output", path, "--overwrite")
        assert (status, "it is an input" in err) == (2, True)
        assert_same(episode(), read_episode(path))


def test_foreign_configuration_beside_an_npz(tmp_path, run):
    path = write(tmp_path, episode(), "hdf5")
    (tmp_path / "out.json").write_text("{}")
    status, err = run(path, "--output", tmp_path / "out.npz", "--overwrite")
    assert (status, "the configuration file of out.npz" in err) == (2, True)
    assert not (tmp_path / "out.npz").exists()


@pytest.mark.parametrize("to", NAMES)
def test_a_failed_write_keeps_the_former_file(tmp_path, monkeypatch, to):
    former = episode(seed=3)
    path = write(tmp_path, former, to)
    names = {p.name for p in tmp_path.iterdir()}

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    where = {
        "mcap": "mcap.writer.Writer.finish",
        "npz": "numpy.savez",
        "hdf5": "h5py.Group.create_dataset",
        "lerobot": "pyarrow.parquet.ParquetWriter.write_table",
    }
    with monkeypatch.context() as patch:
        patch.setattr(where[to], fail)
        with pytest.raises(OutputError, match="no space is left on the device") as caught:
            write(tmp_path, episode(), to)
    assert path.name in str(caught.value)
    assert ".tmp" not in str(caught.value)
    assert {p.name for p in tmp_path.iterdir()} == names
    assert_same(former, read_episode(path))


def test_invalid_requests(tmp_path, run):
    a, b = tmp_path / "a.h5", tmp_path / "b.mcap"
    write_episode(a, episode(name="a"))
    write_episode(b, episode(name="b"))
    for arguments, match in (
        (
            (a, "--output", tmp_path / "x.csv"),
            "does not belong to any format: use .mcap, .npz, .h5",
        ),
        (
            (a, "--output", tmp_path / "x.npz", "--to", "mcap"),
            "the suffix of npz, but --to is mcap",
        ),
        ((a, b, "--output", tmp_path / "x.npz"), "2 episodes, which do not fit into"),
        ((a, "--fps", 30, "--output", tmp_path / "x.npz"), "--fps applies only to LeRobot"),
        ((a, "--fps", 0, "--output", tmp_path / "x"), "fps must be a whole number"),
        ((a, "--episode", 0, "--output", tmp_path / "x.npz"), "--episode applies only to LeRobot"),
        ((a, b, "--commands", a, "--output", tmp_path / "x"), "contains the commands of only one"),
        ((a, "--commands", tmp_path / "no", "--output", tmp_path / "x"), "no such file"),
        ((a, "--commands", tmp_path, "--output", tmp_path / "x"), "1 of 1 recordings have no"),
        ((tmp_path / "none", "--output", tmp_path / "x"), "no such file"),
        (("--output", tmp_path / "x"), "give at least one INPUT"),
        ((a, "--side", "left", "--output", tmp_path / "x.npz"), "a recording of a right hand"),
        ((a, "--rate", 30, "--output", tmp_path / "x.npz"), "contradict --rate 30"),
        ((a, "--frames", "90:", "--output", tmp_path / "x.npz"), "selects nothing"),
        ((a, "--output", b / "x.npz"), "it is a file, but a folder"),
    ):
        status, err = run(*arguments)
        assert status == 2, arguments
        assert match in err.replace("\n", " "), (match, err)
    assert {p.name for p in tmp_path.iterdir()} == {"a.h5", "b.mcap"}
    (tmp_path / "empty").mkdir()
    assert "contain no recordings" in run(tmp_path / "empty", "--output", tmp_path / "x")[1]


@pytest.mark.parametrize(
    ("module", "name", "extra"), [("h5py", "e.h5", "hdf5"), ("pyarrow", "e", "lerobot")]
)
def test_missing_extras(tmp_path, run, monkeypatch, module, name, extra):
    path = write(tmp_path, episode(), "hdf5" if extra == "hdf5" else "lerobot")
    log = write(tmp_path, episode(), "mcap")
    for loaded in [m for m in sys.modules if m.split(".")[0] == module]:
        monkeypatch.setitem(sys.modules, loaded, None)
    hint = install_command(extra)
    status, err = run(path, "--output", tmp_path / "x.npz")
    assert (status, hint in err, err.count("\n")) == (2, True, 1), err
    status, err = run(log, "--output", tmp_path / f"new{path.suffix}")
    assert (status, hint in err) == (2, True), err
    with pytest.raises(MissingExtraError, match="needs the extra"):
        read_episode(path)
    assert not (tmp_path / f"new{path.suffix}").exists()


@pytest.mark.parametrize(
    ("key", "value", "match"),
    [
        ("hand/landmarks", np.zeros((40, 20, 3)), r"shape \(any, 21, 3\), not \(40, 20, 3\)"),
        ("hand/landmarks", None, "lacks the array /hand/landmarks"),
        ("hand/stamps", np.zeros(3), r"shape \(40\), not \(3,\)"),
        ("hand/stamps", np.zeros(40), "they are not times"),
        ("hand/valid", np.zeros((40, 21)), "must hold true or false"),
        ("commands/joint_names", ["a"], "joint_names must have shape"),
        ("commands/joint_names", ["a", "a", "b"], "a joint name occurs twice"),
        ("commands/status", np.full(40, 77), "status .77. is not one of"),
        ("commands/stamps", np.full(40, np.nan), "command 0 is nan"),
        ("commands/latency_ms", ["x"] * 40, "must hold numbers"),
        ("configuration", "{", "is not JSON"),
        ("configuration", "[]", "must be a JSON object"),
    ],
)
def test_wrong_hdf5(tmp_path, key, value, match):
    path = write(tmp_path, episode(), "hdf5")
    with h5py.File(path, "r+") as file:
        labels = file["commands/status"].attrs["status_names"]
        del file[key]
        if value is not None:
            file[key] = value
        if key == "commands/status":
            file[key].attrs["status_names"] = labels
    with pytest.raises(RecordingError, match=match):
        read_episode(path)


def test_hdf5_of_another_program_or_time(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["observations/qpos"] = np.zeros((3, 7))
    with pytest.raises(RecordingError, match="no group 'hand' or 'commands', only observations"):
        read_recording(path)
    path = write(tmp_path, episode(parts="commands"), "hdf5")
    with pytest.raises(RecordingError, match="contains commands, but no hand frames"):
        read_recording(path)
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 9
    with pytest.raises(
        RecordingError, match="version 9, but this program reads version 1; upgrade"
    ):
        read_episode(path)
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(RecordingError, match="damaged or incomplete"):
        read_episode(path)


Change = Callable[[Path], object]


def info_with(**changes: Any) -> Change:
    return lambda path: path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def rewritten(change: Callable[[pa.Table], pa.Table]) -> Change:
    return lambda path: pq.write_table(change(pq.read_table(path)), path)


def with_column(name: str, make: Callable[[pa.Table], Any]) -> Change:
    return rewritten(lambda t: t.set_column(t.column_names.index(name), name, make(t)))


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-50])


INFO = "meta/info.json"
DATA = "data/chunk-000/file-000.parquet"
ROWS = "meta/episodes/chunk-000/file-000.parquet"


@pytest.mark.parametrize(
    ("name", "change", "match"),
    [
        (INFO, lambda p: p.write_text("{"), "can't be read as the description"),
        (INFO, lambda p: p.write_text("[]"), "can't be read as the description"),
        (INFO, info_with(codebase_version="v2.1"), "v2.1, but only v3.0"),
        (INFO, info_with(features={}), "with no columns: it contains no human"),
        (INFO, info_with(data_path="../{chunk_index}"), "outside the dataset"),
        (INFO, info_with(data_path="{x}"), "do not say where episode 0 is"),
        (DATA, Path.unlink, "no such file, so the dataset is incomplete"),
        (DATA, truncate, "damaged or incomplete"),
        (ROWS, truncate, "damaged or incomplete"),
        (ROWS, Path.unlink, "meta/episodes holds no episodes"),
        (DATA, rewritten(lambda t: t.slice(5)), "holds 35 frames of episode 0"),
        (
            DATA,
            rewritten(lambda t: t.drop_columns(["right_landmarks_valid"])),
            "lacks the column 'right_landmarks_valid'",
        ),
        (
            DATA,
            with_column("right_landmarks", lambda t: t["stamp"]),
            "the column 'right_landmarks' must hold 63 numbers per row, not double",
        ),
        (
            DATA,
            with_column("status", lambda t: pa.array([9] * t.num_rows)),
            r"status \[9\] is not one of",
        ),
    ],
)
def test_wrong_datasets(tmp_path, name, change, match):
    root = write(tmp_path, episode(), "lerobot")
    change(root / name)
    with pytest.raises(RecordingError, match=match):
        read_episode(root)


def test_read_recording_advises_to_convert_a_dataset(tmp_path):
    root = write(tmp_path, episode(), "lerobot")
    with pytest.raises(RecordingError, match="LeRobot dataset; convert one of its episodes first"):
        read_recording(root)
    with pytest.raises(RecordingError, match="this is a Parquet file; pass the whole"):
        read_recording(root / DATA)


def test_a_cut_log_is_converted_with_a_note(tmp_path, run):
    path = write(tmp_path, episode(), "mcap")
    path.write_bytes(path.read_bytes()[:-200])
    status, err = run(path, "--output", tmp_path / "a.h5", "--quiet")
    assert status == 0
    assert "the end of the log is missing" in err
    assert len(read_episode(tmp_path / "a.h5")) == FRAMES


def test_parts_that_do_not_fit():
    with pytest.raises(RecordingError, match="neither hand frames nor commands"):
        Episode()
    with pytest.raises(RecordingError, match="stage 'solve' must have one time for each"):
        replace(episode(), stages_ms={"solve": np.zeros(3)})
