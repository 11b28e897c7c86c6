"""Logs as data sets with the columns that LeRobot records of our robot."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator import load_hand
from smooth_operator.episode_files.lerobot import write_dataset
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.formats.episode import Episode, StateTrajectory, WristTrack
from smooth_operator.types import CommandTrajectory

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")

HAND = load_hand("mimic_p050")
ACTUATED = list(HAND.actuated)


def episode(seconds: float = 2.0, wrist: bool = False, hand: str = "mimic_p050") -> Episode:
    """Commands at 97 Hz that count up in tenths, measured 5 ms later, from 0.1 s on."""
    stamps = 1e6 + np.arange(int(97 * seconds)) / 97
    joints = np.arange(len(stamps))[:, None] / 10 + np.arange(len(HAND.joint_names)) / 100
    count = len(stamps)
    commands = CommandTrajectory(
        joints, HAND.joint_names, stamps, np.zeros(count), np.zeros(count, int)
    )
    states = StateTrajectory(stamps[10:] + 0.005, joints[10:] + 0.5, HAND.joint_names)
    track = None
    if wrist:
        poses = np.tile([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0], (len(stamps), 1))
        there = np.ones(len(stamps), bool)
        track = WristTrack(poses, there, there)
    return Episode(
        commands=commands,
        states=states,
        wrist=track,
        task="count",
        name="take",
        config={"hand": hand, "side": "right"},
        live=True,
    )


def read(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray], Any]:
    info = json.loads((folder / "meta/info.json").read_text())
    file = parquet.ParquetFile(folder / "data/chunk-000/file-000.parquet")
    table = file.read()
    columns = {n: np.array(table.column(n).to_pylist()) for n in table.column_names}
    return info, columns, file


def test_a_row_is_a_moment_of_lerobots_clock(tmp_path):
    takes = [episode(), episode(1.0)]
    written: list[int] = []
    write_dataset(
        tmp_path / "set",
        [lambda v=v: v for v in takes],
        columns="robot",
        environment_state=True,
        done=written.append,
    )
    info, columns, file = read(tmp_path / "set")
    assert (info["fps"], info["robot_type"], info["total_tasks"]) == (30, "smooth_hand", 1)
    keys = [f"{name}.pos" for name in HAND.actuated_names]
    assert info["features"]["action"]["names"] == keys
    assert info["features"]["observation.state"] == info["features"]["action"]
    every = [f"environment.{name}.pos" for name in HAND.joint_names]
    assert info["features"]["observation.environment_state"]["names"] == every
    assert set(columns) == set(info["features"])
    assert file.metadata.num_row_groups == 2  # one an episode
    assert written == [file.metadata.row_group(k).num_rows for k in range(2)]
    assert info["total_frames"] == sum(written) == len(columns["index"])

    first = columns["episode_index"] == 0
    begin = takes[0].states.stamps[0]
    moments = begin + columns["frame_index"][first] / 30
    sent = np.floor((moments - 1e6) * 97 + 1e-6) / 10 + ACTUATED[0] / 100
    np.testing.assert_allclose(columns["action"][first][:, 0], sent, atol=1e-4)
    seen = np.floor((moments - 1e6 - 0.005) * 97 + 1e-6) / 10 + 0.5
    np.testing.assert_allclose(columns["observation.state"][first][:, 0], seen, atol=1e-4)
    np.testing.assert_array_equal(
        columns["observation.environment_state"][:, ACTUATED], columns["observation.state"]
    )
    np.testing.assert_allclose(columns["timestamp"], columns["frame_index"] / 30, atol=1e-6)


def test_the_wrist_is_left_out_or_written_with_the_robots_keys(tmp_path):
    take = episode(wrist=True)
    for name, size in (("robot", 16), ("robot-wrist", 23)):
        write_dataset(tmp_path / name, [lambda: take], columns=name)
        info, columns, _ = read(tmp_path / name)
        assert columns["action"].shape[1] == size
        assert "observation.environment_state" not in info["features"]
    assert info["features"]["action"]["names"][16:] == [
        f"tcp.{key}" for key in ("x", "y", "z", "qw", "qx", "qy", "qz")
    ]
    np.testing.assert_allclose(
        columns["action"][:, 16:19], [[0.1, 0.2, 0.3]] * len(columns["index"])
    )


def test_what_the_columns_need_is_named_where_it_is_lacking(tmp_path):
    take = episode()

    def refused(value: Episode, words: str, **options: Any) -> None:
        with pytest.raises(RecordingError, match=words):
            write_dataset(tmp_path / "no", [lambda: value], columns="robot", **options)
        assert not (tmp_path / "no").exists()

    refused(replace(take, states=None), "measured joints; record with a sink that measures")
    refused(replace(take, config=None), "name of its robot hand")
    refused(replace(take, config={"hand": "leap_hand", "side": "right"}), "of the hand leap_hand")
    blind = replace(take.states, positions=np.full_like(take.states.positions, np.nan))
    refused(replace(take, states=blind), "no complete measurement")
    with pytest.raises(RecordingError, match="a commanded wrist"):
        write_dataset(tmp_path / "no", [lambda: take], columns="robot-wrist")
    with pytest.raises(ConfigError, match="with the columns of a robot"):
        write_dataset(tmp_path / "no", [lambda: take], environment_state=True)


def test_convert_asks_for_a_data_set(tmp_path, capsys):
    from smooth_operator.cli import main

    out = str(tmp_path / "x.npz")
    assert main(["convert", "a.mcap", "--output", out, "--columns", "robot"]) == 2
    assert "--columns and --environment-state apply only to LeRobot" in capsys.readouterr().err
    assert main(["convert", "a.mcap", "--output", str(tmp_path / "d"), "--environment-state"]) == 2
    assert "needs --columns robot" in capsys.readouterr().err
