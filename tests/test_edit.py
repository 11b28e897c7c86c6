"""The editor of takes: cut, drop, mark, and the history of it."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from smooth_operator.cli import main
from smooth_operator.retargeting.flat_hand import FLAT_HAND
from smooth_operator.teleop.recording import LogWriter, read_episode, read_log
from smooth_operator.teleop.recording.messages import LoopState
from smooth_operator.types import HandFrame, JointCommand, Side, Status

pytest.importorskip("mcap", reason="the extra teleop is not installed")

START = 1000.0


def take(path: Path, side: Side = "right", begin: float = 0.0) -> Path:
    """A log of 5 s at 100 Hz; the joint and the x of the hand are the time since ``START``."""
    with LogWriter(path) as log:
        log.write_origin({"name": path.stem, "meta": '{"started": "today"}'})
        log.write_config({"method": "smooth"})
        log.write_method(START, "smooth", "teleop", {})
        for k in range(round(100 * begin), 500):
            at = k / 100
            shift = np.array([at, 0.0, 0.0])
            log.write_hand(HandFrame(FLAT_HAND + shift, START + at, side))
            state = LoopState(
                k, "tracking", at, at, at, 0, 0.0, 1.0, ("hello",) if k == 300 else ()
            )
            command = JointCommand(np.array([at]), ("joint",), START + at)
            log.write_command(command, Status.OK, 1.0, {"solve": 0.5}, state)
    return path


def test_a_take_is_cut_and_marked_in_a_new_file(tmp_path, capsys):
    path, new, again = take(tmp_path / "take.mcap"), tmp_path / "new.mcap", tmp_path / "again.mcap"
    before = path.read_bytes()
    words = "--keep 1: --drop 2:2.5 4.5: --mark 1.234=grasp 3=release"
    assert main(["edit", str(path), *words.split(), "--output", str(new)]) == 0
    assert path.read_bytes() == before
    assert f"{new}: 3.5 s, 300 frames, 300 commands" in capsys.readouterr().out
    log = read_log(new)
    kept = np.array([k / 100 for k in range(100, 450) if not 200 <= k < 250])
    np.testing.assert_array_equal(log.commands.joint_positions[:, 0], kept)
    np.testing.assert_allclose(log.commands.stamps, START + kept)
    np.testing.assert_allclose(log.recording.stamps, START + kept)
    np.testing.assert_allclose(log.recording.landmarks[:, 0, 0], FLAT_HAND[0, 0] + kept)
    np.testing.assert_array_equal(log.stages_ms["solve"], np.full(300, 0.5))
    assert log.config == {"method": "smooth"}
    assert [use.method for use in log.methods] == ["smooth"]
    events = {kept[i]: what for i, what in log.loop.events.items()}
    assert events == {1.24: ("mark: grasp",), 3.0: ("hello", "mark: release")}

    assert main(["edit", str(new), "--keep", "0.5:2", "--output", str(again)]) == 0
    assert read_log(again).commands.joint_positions[[0, -1], 0].tolist() == [1.5, 2.99]
    meta = read_episode(again).recording.meta  # which other formats keep
    assert meta["started"] == "today"
    first, second = meta["edits"]
    assert first == {
        "source": "take.mcap",
        "sha256": hashlib.sha256(before).hexdigest(),
        "start": START,
        "keep": [[1.0, None]],
        "drop": [[2.0, 2.5], [4.5, None]],
        "marks": [[1.234, "grasp"], [3.0, "release"]],
    }
    assert (second["source"], second["start"]) == ("new.mcap", START + 1)
    converted = tmp_path / "again.npz"
    assert main(["convert", str(again), "--output", str(converted)]) == 0
    assert read_episode(converted).recording.meta["edits"] == json.loads(json.dumps(meta["edits"]))


def test_both_hands_have_one_time_and_a_take_may_be_cut_off(tmp_path):
    paths = [take(tmp_path / "two.right.mcap"), take(tmp_path / "two.left.mcap", "left", 0.5)]
    words = ["edit", *map(str, paths), "--keep", "1:2", "--output", str(tmp_path / "out")]
    assert main(words) == 0
    for path in paths:
        log = read_log(tmp_path / "out" / path.name)
        assert log.commands.joint_positions[[0, -1], 0].tolist() == [1.0, 1.99]
    path, new = paths[0], tmp_path / "new.mcap"  # a take that was cut off
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    whole = read_log(path).commands
    assert main(["edit", str(path), "--keep", "1:", "--output", str(new)]) == 0
    assert not read_log(new).truncated
    np.testing.assert_array_equal(read_log(new).commands.stamps, whole.stamps[100:])


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--keep 2:1", "a time range must end after it begins, not 2:1"),
        ("--keep 1-2", "write FROM:TO in seconds"),
        ("--mark grasp", "write SECONDS=TEXT, such as 2.5=grasp"),
        ("--drop 1:2 --mark 1.5=a", "the mark 'a' at 1.5 s is in a part that is cut out"),
        ("--mark 9=a", "the mark 'a' at 9 s is after the last command"),
        ("--keep 7:8", "this would remove the whole recording"),
        ("--keep 1: --output {take} --overwrite", "a recording can't be edited in place"),
        ("--keep 1: --output {other}", "exists; name another --output, or add --overwrite"),
    ],
)
def test_what_can_not_be_done_is_explained(tmp_path, capsys, words, why):
    path, other = take(tmp_path / "take.mcap"), tmp_path / "other.mcap"
    other.write_bytes(b"mine")
    before = path.read_bytes()
    words = words.format(take=path, other=other)
    if "--output" not in words:
        words += f" --output {tmp_path / 'new.mcap'}"
    assert main(["edit", str(path), *words.split()]) == 2
    assert why in capsys.readouterr().err
    assert path.read_bytes() == before
    assert other.read_bytes() == b"mine"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["other.mcap", "take.mcap"]
