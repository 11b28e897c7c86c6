"""Writers of data sets: what all share, WebDataset and Parquet."""

import errno
import io
import json
import shutil
import sys
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_clips import JOINTS, robot_clip

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.arrays import drift, resampled
from smooth_hand_datasets.pipeline.writers.registry import WRITERS, WritingOptions
from smooth_operator.errors import ConfigError, OutputError, RecordingError

ALL = ["webdataset", "parquet", "lerobot", "spider"]
OPTIONS = WritingOptions(shard_mb=0.1)


pytest.importorskip("pyarrow")


def write(name: str, output: Path, clips: list[RobotClip], options: Any = OPTIONS) -> Any:
    with WRITERS.load(name).open(output, options) as writer:
        for clip in clips:
            writer.write(clip)
    return writer


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def samples(folder: Path) -> dict[str, tuple[dict[str, Any], dict[str, np.ndarray]]]:
    """Key -> (document, arrays) of all shards of a WebDataset."""
    found = {}
    for shard in sorted((folder / "shards").iterdir()):
        with tarfile.open(shard) as tar:
            members = tar.getmembers()
            assert len({member.name for member in members}) == len(members)
            assert all(member.isfile() for member in members)
            assert {(member.mtime, member.uid, member.gid) for member in members} == {(0, 0, 0)}
            content = {member.name: tar.extractfile(member).read() for member in members}
        for name in content:
            stem, _, kind = name.partition(".")
            if kind == "json":
                with np.load(io.BytesIO(content[f"{stem}.npz"])) as arrays:
                    found[stem] = json.loads(content[name]), dict(arrays)
    return found


@pytest.mark.parametrize("name", sorted(WRITERS.built_in))
def test_every_format_has_a_description(name):
    found = WRITERS.load(name)
    WRITERS.check(name, found)
    assert len(found.what) > 5


def test_webdataset_gives_the_clip_back(tmp_path):
    clips = [robot_clip(i, frames=20 + i, objects=i % 3) for i in range(5)]
    write("webdataset", tmp_path / "out", clips)
    found = samples(tmp_path / "out")
    assert len(found) == 5
    assert all(key.startswith("part1_pick_") and "." not in key for key in found)
    by_key = {document["key"]: (document, arrays) for document, arrays in found.values()}
    for clip in clips:
        document, arrays = by_key[clip.key]
        assert document["task"] == "pick up the cup"
        assert document["name"] == clip.clip.name
        assert document["joints"]["left"] == list(JOINTS)
        assert document["figures"] == {"jump_mm": clip.figures["jump_mm"]}
        assert document["frames"] == len(clip.clip)
        config = tmp_path / "out" / "meta" / "configurations" / f"{document['configuration']}.json"
        assert json.loads(config.read_text())["method"] == "smooth"
        np.testing.assert_array_equal(arrays["stamps"], clip.clip.stamps)
        for side in ("right", "left"):
            command = clip.commands[side].joint_positions
            np.testing.assert_allclose(arrays[f"{side}_joints"], command, atol=1e-6)
            np.testing.assert_allclose(arrays[f"{side}_wrist"], clip.T_world_wrist[side], atol=1e-6)
            points = clip.clip.hands[side].landmarks
            np.testing.assert_allclose(arrays[f"{side}_landmarks"], points, atol=1e-6)
            assert arrays[f"{side}_valid"].all()
        assert ("objects" in arrays) == bool(clip.clip.objects)
        for i, item in enumerate(clip.clip.objects):
            np.testing.assert_allclose(arrays["objects"][:, i], item.T_world_object, atol=1e-6)


def test_webdatasets_own_reader_decodes_the_shards(tmp_path):
    webdataset = pytest.importorskip("webdataset")
    clips = [robot_clip(i) for i in range(4)]
    write("webdataset", tmp_path / "out", clips)
    shards = sorted(map(str, (tmp_path / "out" / "shards").iterdir()))
    found = list(webdataset.WebDataset(shards, shardshuffle=False).decode())
    assert [each["json"]["name"] for each in found] == [clip.clip.name for clip in clips]
    joints = found[2]["npz"]["left_joints"]
    np.testing.assert_allclose(joints, clips[2].commands["left"].joint_positions, atol=1e-6)


def test_parquet_holds_a_row_a_clip(tmp_path):
    clips = [
        robot_clip(0, objects=2),
        robot_clip(1, sides=("left",), objects=0, task=None),
        robot_clip(2, frames=1, wrists=False),
        robot_clip(3, task="Чашка 🍵 «nehmen»"),
    ]
    write("parquet", tmp_path / "out", clips)
    parquet = pytest.importorskip("pyarrow.parquet")
    (file,) = (tmp_path / "out" / "data").iterdir()
    table = parquet.read_table(file)
    rows = table.to_pylist()
    assert [row["name"] for row in rows] == [clip.clip.name for clip in clips]
    assert rows[3]["task"] == "Чашка 🍵 «nehmen»"
    assert rows[1]["task"] is None
    assert rows[1]["right_joints"] is None
    assert rows[1]["objects"] is None
    assert dict(rows[0]["figures"]) == {"jump_mm": 1.5}
    assert rows[0]["object_names"] == ["cup 0", "cup 1"]
    assert len(rows[2]["stamps"]) == 1
    assert rows[2]["right_human_wrist"] is None
    assert np.isnan(rows[2]["right_wrist"][0]).all()
    for clip, row in zip(clips, rows, strict=True):
        for side in clip.commands:
            joints = np.array(row[f"{side}_joints"])
            np.testing.assert_allclose(joints, clip.commands[side].joint_positions, atol=1e-6)
            assert row[f"{side}_valid"] == [True] * len(clip.clip)
            points = np.array(row[f"{side}_landmarks"]).reshape(-1, 21, 3)
            np.testing.assert_allclose(points, clip.clip.hands[side].landmarks, atol=1e-5)
        for i, item in enumerate(clip.clip.objects):
            track = np.array(row["objects"])[:, 7 * i : 7 * i + 7]
            np.testing.assert_allclose(track, item.T_world_object, atol=1e-6)
    assert table.schema.field("right_joints").metadata[b"unit"].startswith(b"rad")


@pytest.mark.parametrize("name", ALL)
def test_a_killed_run_leaves_complete_shards_and_can_be_resumed(name, tmp_path):
    clips = [robot_clip(i, frames=60) for i in range(10)]
    options = WritingOptions(shard_mb=0.03)
    write(name, tmp_path / "whole", clips, options)
    whole = contents(tmp_path / "whole")
    writer = WRITERS.load(name).open(tmp_path / "working", options)
    for number, clip in enumerate(clips):
        writer.write(clip)
        if number in (1, 7):  # what is on the disk is what a killed process leaves
            shutil.copytree(tmp_path / "working", tmp_path / f"killed{number}")
    indices = len(list((tmp_path / "killed7" / "meta" / "shards").iterdir()))
    for number in (1, 7):
        left = tmp_path / f"killed{number}"
        again = WRITERS.load(name).open(left, options)
        assert not list(left.rglob("*.tmp"))
        if number == 7:
            assert 0 < len(again.written) <= 8
            assert indices > 1
        with again:
            for clip in clips:
                again.write(clip)  # those that stand are passed over
        assert again.written == {clip.key for clip in clips}
        assert contents(left) == whole
    writer.close()


@pytest.mark.parametrize("name", ALL)
def test_a_shard_without_its_index_is_written_again(name, tmp_path):
    clips = [robot_clip(i, frames=60) for i in range(6)]
    options = WritingOptions(shard_mb=0.01)
    write(name, tmp_path / "out", clips, options)
    whole = contents(tmp_path / "out")
    index = sorted((tmp_path / "out" / "meta" / "shards").iterdir())[-1]
    lost = {clip["key"] for clip in json.loads(index.read_text())["clips"]}
    index.unlink()  # killed between the two
    assert (
        WRITERS.load(name).open(tmp_path / "out", options).written
        == {clip.key for clip in clips} - lost
    )
    write(name, tmp_path / "out", clips, options)
    assert contents(tmp_path / "out") == whole


@pytest.mark.skipif(sys.platform == "win32", reason="it has no limit on the size of files")
@pytest.mark.parametrize("name", ALL)
def test_a_full_disk_ends_the_run_and_keeps_complete_shards(name, tmp_path):
    import resource

    options = WritingOptions(shard_mb=0.2)
    clips = [robot_clip(i, frames=120) for i in range(20)]
    writer = WRITERS.load(name).open(tmp_path / "out", options)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    for clip in clips[:4]:
        writer.write(clip)

    def write_the_rest() -> None:
        with writer:
            for clip in clips[4:]:
                writer.write(clip)

    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises(OutputError) as caught:
            write_the_rest()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.errno == errno.EFBIG
    assert "larger than this disk allows" in str(caught.value)
    assert not list((tmp_path / "out").rglob("*.tmp"))
    with WRITERS.load(name).open(tmp_path / "out", options) as again:
        for clip in clips:
            again.write(clip)
    assert len(again.written) == 20


@pytest.mark.parametrize("name", ALL)
def test_equal_names_and_empty_clips(name, tmp_path):
    first, second = robot_clip(1), robot_clip(2, name="part1/pick/1")
    with WRITERS.load(name).open(tmp_path / "out", OPTIONS) as writer:
        with pytest.raises(RecordingError, match="no frames"):
            writer.write(robot_clip(0, frames=0))
        for clip in (first, second, first):
            writer.write(clip)
    (index,) = (tmp_path / "out" / "meta" / "shards").iterdir()
    entries = json.loads(index.read_text())["clips"]
    assert [entry["key"] for entry in entries] == [first.key, second.key]
    assert len({entry.get("sample", entry["key"]) for entry in entries}) == 2


def test_parts_share_a_folder(tmp_path):
    clips = [robot_clip(i) for i in range(6)]
    for part in (1, 0):
        options = WritingOptions(part=part, parts=2)
        write("webdataset", tmp_path / "out", clips[part::2], options)
    assert {document["name"] for document, _ in samples(tmp_path / "out").values()} == {
        clip.clip.name for clip in clips
    }
    writer = WRITERS.load("webdataset").open(tmp_path / "out", WritingOptions())
    assert len(writer.written) == 6  # of both


def test_a_folder_of_another_format_or_options_is_refused(tmp_path):
    write("webdataset", tmp_path / "out", [robot_clip()])
    with pytest.raises(ConfigError, match="started with format"):
        WRITERS.load("parquet").open(tmp_path / "out", OPTIONS)
    with pytest.raises(ConfigError, match="started with rate = null, not 15"):
        WRITERS.load("webdataset").open(tmp_path / "out", replace(OPTIONS, rate=15.0))
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="it is a file; give the name of a folder"):
        WRITERS.load("webdataset").open(tmp_path / "file", OPTIONS)
    index = next((tmp_path / "out" / "meta" / "shards").iterdir())
    whole = index.read_text()
    for damaged in ("{", "[]", '{"clips": [{}]}', '{"clips": 3}'):
        index.write_text(damaged)
        with pytest.raises(OutputError, match="as the index of a shard"):
            WRITERS.load("webdataset").open(tmp_path / "out", OPTIONS)
    index.write_text(whole)
    (tmp_path / "out" / "meta" / "dataset.json").write_text("{")
    with pytest.raises(OutputError, match="can't be read"):
        WRITERS.load("webdataset").open(tmp_path / "out", OPTIONS)


@pytest.mark.parametrize(
    ("wrong", "said"), [({"rate": 0.0}, "positive"), ({"shard_mb": 0.0}, "above 0")]
)
def test_options_are_checked(wrong, said):
    with pytest.raises(ConfigError, match=said):
        WritingOptions(**wrong)


def test_resampling_follows_the_motion():
    clip = robot_clip(3, frames=91, rate=30.0)
    found = resampled(clip, 50.0)
    assert len(found.clip) == 151
    exact = robot_clip(3, frames=151, rate=50.0)
    assert drift(found.clip.stamps, 50.0) < 1e-6
    for side in ("right", "left"):
        mine, theirs = found.commands[side], exact.commands[side]
        np.testing.assert_allclose(mine.joint_positions, theirs.joint_positions, atol=4e-3)
        q, p = found.T_world_wrist[side][:, 3:], exact.T_world_wrist[side][:, 3:]
        assert np.abs((q * p).sum(axis=1)).min() > 1 - 1e-7
        np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)


def test_resampling_to_the_same_rate_changes_nothing_and_keeps_gaps_small():
    clip = robot_clip(0, frames=30)
    wrist = clip.T_world_wrist["right"].copy()
    wrist[10] = np.nan
    clip = replace(clip, T_world_wrist={**clip.T_world_wrist, "right": wrist})
    same = resampled(clip, 30.0)
    np.testing.assert_array_equal(same.T_world_wrist["right"], wrist)
    joints = same.commands["left"].joint_positions
    np.testing.assert_array_equal(joints, clip.commands["left"].joint_positions)
    finer = resampled(clip, 60.0)
    lost = np.isnan(finer.T_world_wrist["right"]).any(axis=1)
    assert np.flatnonzero(lost).tolist() == [19, 20, 21]


def test_a_pause_of_the_tracker_is_not_valid():
    clip = robot_clip(0, frames=40)
    stamps = clip.clip.stamps + np.where(np.arange(40) < 20, 0.0, 0.4)
    scene = replace(
        clip.clip,
        hands={side: replace(hand, stamps=stamps) for side, hand in clip.clip.hands.items()},
    )
    commands = {side: replace(each, stamps=stamps) for side, each in clip.commands.items()}
    short = replace(clip, clip=scene, commands=commands)
    found = resampled(short, 30.0)
    assert len(found.clip) == 52
    assert np.flatnonzero(~found.valid["right"]).tolist() == list(range(20, 32))
