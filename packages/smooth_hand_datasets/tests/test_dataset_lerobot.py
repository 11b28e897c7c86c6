"""The writer of LeRobot data sets: its files with pyarrow, and with LeRobot's own class.

The tests marked ``lerobot`` need LeRobot; CI has a job with it.
"""

import importlib.util
import json
import os
import re
import struct
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_clips import JOINTS, robot_clip

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.lerobot import VIDEO_KEY, VideoHead, video_head
from smooth_hand_datasets.pipeline.writers.registry import WRITERS, WritingOptions
from smooth_operator.errors import RecordingError

pytest.importorskip("pyarrow")

HAS_LEROBOT = bool(importlib.util.find_spec("lerobot"))
real = pytest.mark.skipif(not HAS_LEROBOT, reason="LeRobot is not installed")

POSE = ["x", "y", "z", "qw", "qx", "qy", "qz"]
NAMES = [
    name
    for side in ("right", "left")
    for name in [f"{side}_{j}.pos" for j in JOINTS] + [f"{side}_tcp.{p}" for p in POSE]
]


def write(output: Path, clips: list[RobotClip], **options: Any) -> list[str]:
    with WRITERS.load("lerobot").open(output, WritingOptions(**options)) as writer:
        for clip in clips:
            writer.write(clip)
    return list(writer.notes)


def read(output: Path) -> tuple[dict[str, Any], Any, Any]:
    """``info.json``, the frames and the episodes."""
    from pyarrow import concat_tables, parquet

    def table(folder: str) -> Any:
        return concat_tables(
            parquet.read_table(path, partitioning=None)
            for path in sorted((output / folder).glob("*/*.parquet"))
        )

    return (
        json.loads((output / "meta" / "info.json").read_text()),
        table("data"),
        table("meta/episodes"),
    )


def values(table: Any, name: str) -> np.ndarray:
    return np.array(table.column(name).to_pylist())


def test_state_and_action_of_the_robot(tmp_path):
    clips = [robot_clip(i, frames=20 + 5 * i, task=f"task {i % 2}") for i in range(4)]
    assert write(tmp_path / "out", clips) == []
    info, frames, episodes = read(tmp_path / "out")
    assert info["fps"] == 30
    assert info["robot_type"] == "mimic_p050"
    assert info["total_episodes"] == 4
    assert info["total_frames"] == frames.num_rows == 20 + 25 + 30 + 35
    assert info["features"]["observation.state"]["names"] == NAMES
    assert info["features"]["action"]["names"] == NAMES
    state, action = values(frames, "observation.state"), values(frames, "action")
    start = 0
    for number, clip in enumerate(clips):
        stop = start + len(clip.clip)
        parts = [
            part
            for side in ("right", "left")
            for part in (clip.commands[side].joint_positions, clip.T_world_wrist[side])
        ]
        exact = np.concatenate(parts, axis=1)
        np.testing.assert_allclose(state[start:stop], exact, atol=1e-6)
        np.testing.assert_array_equal(action[start : stop - 1], state[start + 1 : stop])
        np.testing.assert_array_equal(action[stop - 1], state[stop - 1])
        row = episodes.slice(number, 1).to_pylist()[0]
        assert (row["dataset_from_index"], row["dataset_to_index"]) == (start, stop)
        assert row["tasks"] == [f"task {number % 2}"]
        own = json.loads(row["smooth_operator"])
        assert own["key"] == clip.key
        start = stop
    np.testing.assert_array_equal(values(frames, "index"), np.arange(start))
    np.testing.assert_array_equal(values(frames, "stamp")[:20], clips[0].clip.stamps)
    np.testing.assert_allclose(values(frames, "timestamp")[20:23], [0, 1 / 30, 2 / 30])
    tracks = values(frames, "objects")[:20]
    np.testing.assert_allclose(tracks[:, :7], clips[0].clip.objects[0].T_world_object, atol=1e-6)
    assert (tracks[:, 7:] == [0, 0, 0, 1, 0, 0, 0]).all()
    assert values(frames, "objects_valid")[:20].tolist() == [[True, False]] * 20
    stats = json.loads((tmp_path / "out" / "meta" / "stats.json").read_text())
    np.testing.assert_allclose(stats["action"]["mean"], action.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(stats["action"]["std"], action.std(axis=0), atol=1e-5)
    assert stats["action"]["count"] == [start]


def test_unknown_values_are_held_and_marked(tmp_path):
    clip = robot_clip(0)
    wrist = clip.T_world_wrist["left"].copy()
    wrist[:3] = wrist[7:9] = np.nan
    valid = np.ones(40, bool)
    valid[7:9] = False
    clip = replace(
        clip,
        T_world_wrist={**clip.T_world_wrist, "left": wrist},
        valid={**clip.valid, "left": valid},
    )
    write(tmp_path / "out", [clip, robot_clip(1, sides=("right",))])
    _, frames, _ = read(tmp_path / "out")
    state = values(frames, "observation.state")
    assert np.isfinite(state).all()
    place = NAMES.index("left_tcp.x")
    np.testing.assert_array_equal(state[:3, place], state[[3, 3, 3], place])
    np.testing.assert_array_equal(state[7:9, place], state[[6, 6], place])
    for name in frames.column_names:  # LeRobot's own tools make nulls of NaN
        assert np.isfinite(values(frames, name).astype(float)).all(), name
    known = values(frames, "left_wrist_valid")
    assert np.flatnonzero(~known[:40]).tolist() == [0, 1, 2, 7, 8]
    assert np.flatnonzero(~values(frames, "left_valid")[:40]).tolist() == [7, 8]
    assert not known[40:].any()  # the second clip has no left hand
    assert not values(frames, "left_valid")[40:].any()
    assert (values(frames, "left_status")[40:] == -1).all()
    np.testing.assert_array_equal(state[40:, place : place + 7], [[0, 0, 0, 1, 0, 0, 0]] * 40)


def test_quaternions_do_not_change_their_sign(tmp_path):
    clip = robot_clip(0)
    wrist = clip.T_world_wrist["right"].copy()
    wrist[:5, 3:] *= -1.0
    wrist[10:20, 3:] *= -1.0
    wrist[15] = np.nan
    write(tmp_path / "out", [replace(clip, T_world_wrist={**clip.T_world_wrist, "right": wrist})])
    _, frames, _ = read(tmp_path / "out")
    place = NAMES.index("right_tcp.qw")
    found = values(frames, "observation.state")[:, place : place + 4]
    exact = clip.T_world_wrist["right"][:, 3:].copy()
    exact[15] = exact[14]
    assert exact[0, 0] > 0.0
    np.testing.assert_allclose(found, exact, atol=1e-6)


def test_clips_of_other_rates_are_resampled(tmp_path):
    clips = [robot_clip(0), robot_clip(1, frames=61, rate=60.0), robot_clip(2, frames=11, rate=10)]
    assert write(tmp_path / "out", clips) == ["2 clips: resampled to 30 frames per second"]
    _, frames, episodes = read(tmp_path / "out")
    assert episodes.column("length").to_pylist() == [40, 31, 31]
    exact = robot_clip(1, frames=31).commands["right"].joint_positions
    found = values(frames, "observation.state")[40:71, :6]
    np.testing.assert_allclose(found, exact, atol=1e-6)


@pytest.mark.parametrize(
    ("second", "options", "said"),
    [({"wrists": False}, {}, "its wrists are unknown"), ({}, {"videos": "link"}, "has no video")],
)
def test_a_clip_that_does_not_fit_is_refused_and_the_others_stay(second, options, said, tmp_path):
    video = mp4(tmp_path / "film.mp4")
    first, third = (robot_clip(i, video=video) for i in (0, 2))
    with WRITERS.load("lerobot").open(tmp_path / "out", WritingOptions(**options)) as writer:
        writer.write(first)
        with pytest.raises(RecordingError, match=said):
            writer.write(robot_clip(1, **second))
        others = replace(first.commands["left"], joint_names=JOINTS[::-1])
        wrong = replace(first, key="b", commands={**first.commands, "left": others})
        with pytest.raises(RecordingError, match="not for the joints of the data set"):
            writer.write(wrong)
        writer.write(third)
    _, frames, episodes = read(tmp_path / "out")
    assert episodes.num_rows == 2
    assert frames.num_rows == 80


def test_a_one_handed_first_clip_has_the_requested_columns(tmp_path):
    clips = [robot_clip(0, sides=("left",)), robot_clip(1)]
    write(tmp_path / "out", clips, joints={"right": JOINTS, "left": JOINTS})
    info, frames, _ = read(tmp_path / "out")
    assert info["features"]["action"]["names"] == NAMES
    assert frames.num_rows == 80


def test_many_clips_are_few_files(tmp_path, monkeypatch):
    monkeypatch.setattr("smooth_hand_datasets.pipeline.writers.lerobot._Writer.most_clips", 5)
    write(tmp_path / "out", [robot_clip(i, frames=3) for i in range(12)])
    files = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert len(files) == 6 + 3 * 3  # three shards: frames, episodes, index
    _, frames, episodes = read(tmp_path / "out")
    assert frames.num_rows == 36
    assert episodes.column("data/file_index").to_pylist() == [0] * 5 + [1] * 5 + [2] * 2


def mp4(path: Path, *, frames: int = 200, step: int = 512, scale: int = 15360) -> Path:
    """The tables of an MP4 file of 64 x 48 pixels, box by box (ISO/IEC 14496-12); no picture."""

    def box(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", 8 + len(content)) + kind + content

    entry = b"\0" * 6 + struct.pack(">H", 1) + b"\0" * 16 + struct.pack(">HH", 64, 48) + b"\0" * 50
    stsd = bytes(4) + struct.pack(">I", 1) + box(b"avc1", entry)
    # The last frame lasts longer, as in files of many programs.
    stts = bytes(4) + struct.pack(">IIIII", 2, frames - 1, step, 1, step * 3)
    media = box(b"mdhd", bytes(12) + struct.pack(">II", scale, frames * step) + bytes(4))
    media += box(b"hdlr", bytes(8) + b"vide" + bytes(13))
    media += box(b"minf", box(b"stbl", box(b"stsd", stsd) + box(b"stts", stts)))
    path.write_bytes(
        box(b"ftyp", b"isom" + bytes(4))
        + box(b"mdat", bytes(99))
        + box(b"moov", box(b"trak", box(b"mdia", media)))
    )
    return path


@pytest.mark.parametrize("how", ["link", "copy"])
def test_a_video_of_several_clips_is_placed_once(how, tmp_path):
    film = mp4(tmp_path / "film.mp4")
    clips = [robot_clip(i, video=film, video_start_s=2.0 * i) for i in range(3)]
    clips.append(robot_clip(3, video=mp4(tmp_path / "other.mp4"), video_start_s=6.0))
    assert write(tmp_path / "out", clips, videos=how) == ["1 clip: cut to the length of the video"]
    info, _, episodes = read(tmp_path / "out")
    assert info["features"][VIDEO_KEY]["shape"] == [48, 64, 3]
    assert info["features"][VIDEO_KEY]["info"]["video.codec"] == "h264"
    starts = episodes.column(f"videos/{VIDEO_KEY}/from_timestamp").to_pylist()
    assert starts == [0.0, 2.0, 4.0, 6.0]
    assert episodes.column(f"videos/{VIDEO_KEY}/file_index").to_pylist() == [0, 0, 0, 1]
    assert episodes.column("length").to_pylist() == [40, 40, 40, 20]
    placed = sorted((tmp_path / "out" / "videos" / VIDEO_KEY / "chunk-000").iterdir())
    assert [path.name for path in placed] == ["file-000.mp4", "file-001.mp4"]
    assert placed[0].read_bytes() == film.read_bytes()
    assert (placed[0].stat().st_ino == film.stat().st_ino) == (how == "link")
    stats = json.loads((tmp_path / "out" / "meta" / "stats.json").read_text())
    assert np.shape(stats[VIDEO_KEY]["mean"]) == (3, 1, 1)


def test_videos_that_do_not_fit_are_refused(tmp_path):
    film, faster = mp4(tmp_path / "film.mp4"), mp4(tmp_path / "faster.mp4", step=256)
    assert float(video_head(faster).rate) == 60.0
    fitting = robot_clip(0, video=film)
    for number, (clips, options, said) in enumerate(
        (
            ([fitting, robot_clip(1, video=faster)], {}, "60 frames per second, but the data set"),
            ([fitting], {"rate": 15.0}, "15 were requested"),
            ([robot_clip(0, video=film, video_start_s=7.0)], {}, "which has only 200 frames"),
            ([robot_clip(0, video=tmp_path / "none.mp4")], {}, "no such video"),
        )
    ):
        with pytest.raises(RecordingError, match=said):
            write(tmp_path / str(number), clips, videos="link", **options)


def test_damaged_videos_are_refused(tmp_path):
    """One that is cut off anywhere, and one whose tables have a wrong length or name."""
    whole = mp4(tmp_path / "film.mp4").read_bytes()
    path, head = tmp_path / "damaged.mp4", video_head(tmp_path / "film.mp4")

    def read(data: bytes) -> VideoHead | None:
        path.write_bytes(data)
        try:
            return video_head(path)
        except RecordingError:
            return None

    path.write_bytes(whole[:-1])
    with pytest.raises(RecordingError, match=f"{re.escape(str(path))}: can't be read as an MP4"):
        video_head(path)
    assert [read(whole[:cut]) for cut in range(len(whole))] == [None] * len(whole)
    tables = (b"moov", b"trak", b"mdia", b"mdhd", b"hdlr", b"minf", b"stbl", b"stsd", b"stts")
    lengths_and_names = {whole.index(name) + i for name in tables for i in range(-4, 4)}
    for at in range(len(whole)):
        data = bytearray(whole)
        data[at] ^= 0xFF
        other = read(data)
        if at in lengths_and_names:
            assert other is None, at
        elif other is not None:  # of another size, rate, count or codec: one of them at most
            fields = ("width", "height", "rate", "frames", "codec")
            assert sum(getattr(other, name) != getattr(head, name) for name in fields) <= 1, at


def film(path: Path, frames: int, rate: str) -> Path:
    """A real video whose picture has its number's brightness."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate))
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.options = {"crf": "10"}
        for number in range(frames):
            picture = np.full((48, 64, 3), 20 + 2 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
    return path


def load(root: Path, **options: Any) -> Any:
    """A data set as LeRobot's own class opens it."""
    os.environ["HF_HUB_OFFLINE"] = "1"
    from lerobot.datasets import LeRobotDataset

    return LeRobotDataset("test/clips", root=root, **options)


@pytest.mark.lerobot
@real
def test_the_class_of_lerobot_opens_it(tmp_path):
    clips = [robot_clip(i, frames=30 + i, task=["a cup", "Чашка 🍵"][i % 2]) for i in range(6)]
    write(tmp_path / "out", clips, shard_mb=0.02)
    dataset = load(tmp_path / "out", delta_timestamps={"action": [0.0, 1 / 30, 2 / 30]})
    assert dataset.num_episodes == 6
    assert len(dataset) == sum(30 + i for i in range(6))
    assert len(list((tmp_path / "out" / "data" / "chunk-000").iterdir())) > 1
    start = 30 + 31
    for number in (0, 17, 30 + 31 - 1, start + 5, len(dataset) - 1):
        item = dataset[number]
        assert item["action"].shape == (3, len(NAMES))
        assert item["observation.state"].shape == (len(NAMES),)
        assert bool(item["observation.state"].isfinite().all())
    item = dataset[start + 5]
    assert item["task"] == "a cup"
    assert dataset[start - 1]["task"] == "Чашка 🍵"
    exact = clips[2].commands["right"].joint_positions[6:9]
    np.testing.assert_allclose(item["action"][:, :6], exact, atol=1e-6)
    assert item["action_is_pad"].tolist() == [False] * 3
    assert dataset[start + 31]["action_is_pad"].tolist() == [False, True, True]
    assert dataset.meta.stats["action"]["mean"].shape == (len(NAMES),)
    only = load(tmp_path / "out", episodes=[3])
    assert len(only) == 33


@pytest.mark.lerobot
@real
@pytest.mark.parametrize("rate", ["30", "30000/1001"])
def test_lerobot_shows_the_picture_of_each_frame(rate, tmp_path):
    video = film(tmp_path / "film.mp4", 100, rate)
    number = float(Fraction(rate))
    clips = [
        robot_clip(0, frames=40, rate=number, video=video),
        robot_clip(1, frames=40, rate=number, video=video, video_start_s=50 / number),
    ]
    write(tmp_path / "out", clips, videos="link")
    dataset = load(tmp_path / "out")
    assert dataset.meta.camera_keys == [VIDEO_KEY]
    for index, picture in ((0, 0), (39, 39), (40, 50), (79, 89)):
        seen = dataset[index][VIDEO_KEY]
        assert seen.shape == (3, 48, 64)
        # Colours lose a little on their way through the codec, less than the step of two frames.
        assert abs(float(seen.mean()) * 255 - (20 + 2 * picture)) < 1.9
