"""Recordings of two hands into a data set: the same bytes whatever was killed, split or changed."""

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import fuzzing
import numpy as np
import pytest
from two_hands import LAYOUT, PAIRS, Counting, save_pair

import smooth_hand_datasets.pipeline.run as pipeline
from smooth_hand_datasets.commands.dataset import _print
from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.quality import (
    REACHED,
    Dropped,
    hand_length,
    quality_tracks,
    select,
)
from smooth_hand_datasets.pipeline.request import Limits
from smooth_hand_datasets.pipeline.retargeting import Recipe, retarget_clips
from smooth_hand_datasets.pipeline.run import DatasetRequest, make_dataset
from smooth_hand_datasets.pipeline.sources import find_items, is_manifest, parse_shard
from smooth_hand_datasets.pipeline.store import Store
from smooth_hand_datasets.pipeline.writing import Summary
from smooth_operator import load_hand, plugins, poses, result_cache
from smooth_operator.baselines.joint_angle import JointAngleMap
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, OutputError, RecordingError
from smooth_operator.formats.clip import CAMERA, SIDES, Clip, ClipRef, ReadingOptions, in_frame
from smooth_operator.formats.registry import READERS
from smooth_operator.landmarks import BASES
from smooth_operator.planning import RetargetRequest
from smooth_operator.reporter import Reporter
from smooth_operator.result_cache import content_digest
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.batching import BatchRetargeter
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import CommandTrajectory

CONFIG = method_config("joint_angle")  # the quickest to compile
ASKED = RetargetRequest(
    hand="mimic_p050", method="joint_angle", preset="default", config=CONFIG, seed=3
)
RECIPE = Recipe(ASKED)
OPEN = {"min_seconds": 0.2, "max_tip_error": 1e3, "min_reach": 0.0, "max_collision": 1.0}
LIMITS = Limits(**OPEN)
FRAMES = {"a": 30, "b": 70, "deep/c": 64, "deep/er/d": 41}


pytestmark = pytest.mark.usefixtures("compiled_once")


@pytest.fixture(autouse=True)
def _without_plots(whole, monkeypatch) -> None:
    """Drawing takes longer than all else; the first run has drawn."""
    monkeypatch.setattr("smooth_hand_datasets.pipeline.writing._histograms", lambda *_: None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Four clips of two hands: b with a gap of the right hand and one of both, c with a task."""
    at = tmp_path_factory.mktemp("data") / "clips"
    for seed, (name, frames) in enumerate(FRAMES.items()):
        task = "pour tea" if name == "deep/c" else None
        arrays = save_pair(at / f"{name}.pair.npz", frames, seed, task=task)
        if name == "b":
            lost = {f"{side}_landmarks": arrays[f"{side}_landmarks"].copy() for side in SIDES}
            lost["right_landmarks"][5:10] = np.nan
            for landmarks in lost.values():
                landmarks[20:50] = np.nan
            sure = np.where(np.arange(frames) < 60, 0.9, 0.1)
            save_pair(at / "b.pair.npz", frames, seed, left_confidence=sure, **lost)
    (at / "notes.md").write_text("mine", encoding="utf-8")
    return at


def request(folder: Path, output: Path, **more: Any) -> DatasetRequest:
    own = {"sources": (str(folder),), "layout": LAYOUT, "format": "parquet", "workers": 0, **OPEN}
    return DatasetRequest(output=output, **own | more)


def make(request: DatasetRequest, reporter: Reporter | None = None) -> Summary:
    return make_dataset(request, reporter, resolved=ASKED)


def contents(output: Path) -> dict[str, bytes]:
    """The files of the data set and of the report."""
    files = [path for path in (output / "dataset").rglob("*") if path.is_file()]
    files += [output / "report.json", output / "episodes.jsonl"]
    return {path.relative_to(output).as_posix(): path.read_bytes() for path in files}


def lines(output: Path) -> dict[str, dict[str, Any]]:
    text = (output / "episodes.jsonl").read_text(encoding="utf-8")
    return {line["episode"]: line for line in map(json.loads, text.splitlines())}


@pytest.fixture(scope="module")
def whole(folder, tmp_path_factory) -> tuple[Path, Summary]:
    """One process, undisturbed."""
    output = tmp_path_factory.mktemp("whole") / "out"
    return output, make(request(folder, output))


def finished(output: Path) -> dict[str, RobotClip]:
    """The retargeted clips that a run has left, whole."""
    store = Store(output / "work")
    kept = store.find(lambda *_: True)
    clips = [clip for each in kept.values() for clip in store.read(each)]
    store.close()
    return {clip.clip.name: clip for clip in clips}


def test_both_hands_equal_results_of_the_library(folder, whole):
    clips = finished(whole[0])
    assert clips.keys() == FRAMES.keys()
    for side in SIDES:
        retargeter = BatchRetargeter(side=side, config=CONFIG, seed=3)
        for name in ("b", "deep/c"):
            clip, path = clips[name], folder / f"{name}.pair.npz"
            source = PAIRS.read(ClipRef(name, path), ReadingOptions())
            commands = clip.commands[side]
            # To the last bit, whatever was with it.
            ((expected, _),) = retargeter.batch([source.hands[side]])
            assert commands.joint_positions.tobytes() == expected.joint_positions.tobytes()
            np.testing.assert_array_equal(clip.valid[side], expected.status == 0)
            np.testing.assert_array_equal(
                clip.T_world_wrist[side], source.hands[side].T_world_wrist
            )
            assert clip.clip.meta["source"] == [
                {
                    "path": f"{name}.pair.npz",
                    "bytes": path.stat().st_size,
                    "sha256": content_digest(path),
                }
            ]
            assert clip.clip.world == "room"
    assert not clips["b"].valid["right"][5:10].any()
    assert clips["b"].valid["left"][5:10].all()
    assert clips["deep/c"].clip.task == "pour tea"


def test_episodes_are_cut_at_frames_without_a_hand(whole):
    output, summary = whole
    found = lines(output)
    kept = {name: line["frames"] for name, line in found.items() if line["kept"]}
    # Frames 5 to 9 lack one hand only; 20 to 49 both; from 60 on the left one is not sure.
    assert kept == {
        "a": 30,
        "b_000000-000020": 20,
        "b_000050-000070": 20,
        "deep/c": 64,
        "deep/er/d": 41,
    }
    assert found["b_000020-000050"]["reasons"] == {"hands": "no hand is seen"}
    figures = found["b_000050-000070"]["figures"]
    assert figures["right.valid"] == 1.0
    assert figures["left.valid"] == 0.5
    assert figures["left.confidence"] == pytest.approx(0.5)
    assert figures["seconds"] == pytest.approx(0.4)
    assert found["b_000000-000020"]["figures"]["right.gap_s"] == pytest.approx(0.1)
    assert (summary.clips, summary.episodes, summary.dropped) == (4, 5, 1)
    assert summary.frames == sum(FRAMES.values())
    assert summary.passed_over == {".md": 1}
    report = json.loads((output / "report.json").read_text(encoding="utf-8"))
    assert report["figures"]["tip_error_mm"]["p50"] > 0
    page = (output / "report.html").read_text(encoding="utf-8")
    assert "5 episodes of mimic_p050" in page
    assert (output / "plots" / "quality.png").is_file()


RUN = """
import os
import sys
from contextlib import contextmanager
from pathlib import Path
sys.path[:0] = sys.argv[1].split(os.pathsep)
import smooth_hand_datasets.pipeline.run as pipeline
from smooth_operator.reporter import Reporter
from test_dataset_pipeline import make, request
pipeline._FEW_ITEMS = 1

class Say(Reporter):
    @contextmanager
    def counting(self, *_, **__):
        yield lambda count, **_: print(count, flush=True)

if __name__ == "__main__":
    make(request(Path(sys.argv[2]), Path(sys.argv[3])), Say())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_killed_run_is_resumed(folder, whole, tmp_path, monkeypatch):
    monkeypatch.setattr("smooth_hand_datasets.pipeline.run._FEW_ITEMS", 1)
    output = tmp_path / "out"
    words = [sys.executable, "-c", RUN, os.pathsep.join(sys.path), str(folder), str(output)]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline()  # one pack is there, and then
        process.kill()
    packs = list((output / "work").rglob("pack-*.zip"))
    assert 0 < len(packs) < len(FRAMES), "it was not in the middle"
    (packs[0].parent / ".pack-00.zip.00000000-7.0123abcd.tmp").write_bytes(b"half")
    count = Counting()
    make(request(folder, output), count)
    assert count.kept == len(packs)
    assert contents(output) == contents(whole[0])
    assert not list(output.rglob("*.tmp"))


def test_all_shares_make_the_complete_data_set(folder, whole, tmp_path):
    output = tmp_path / "out"
    done = [make(request(folder, output, shard=f"{i}/3")) for i in (1, 2)]
    assert not (output / "dataset").exists()
    early = make(request(folder, output, merge=True))
    assert len(early.failed) == len(FRAMES) - sum(each.clips for each in done)
    done.append(make(request(folder, output, shard="3/3")))
    assert sum(each.clips for each in done) == len(FRAMES)
    summary = make(request(folder, output, merge=True))
    assert summary.failed == {}
    assert contents(output) == contents(whole[0])


@pytest.fixture
def copy(folder, whole, tmp_path) -> tuple[Path, Path]:
    """Clips and finished results, to be changed."""
    shutil.copytree(folder, tmp_path / "clips")
    for pack in (whole[0] / "work").rglob("pack-*.zip"):
        place = tmp_path / "out" / pack.relative_to(whole[0])
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(pack, place)
    count = Counting()
    make(request(tmp_path / "clips", tmp_path / "out"), count)
    assert count.kept == len(FRAMES), "it is the content that counts, not the place"
    return tmp_path / "clips", tmp_path / "out"


def test_frames_are_counted_in_a_lerobot_data_set_without_empty_columns(copy, capsys):
    """Clips of 50 Hz at 25 Hz; a run that finds all written says the same as the first."""
    sources, out = copy
    slow = replace(request(sources, out), format="lerobot", fps=25.0)
    summary = make(slow)
    info = json.loads((out / "dataset" / "meta" / "info.json").read_text(encoding="utf-8"))
    assert "right_human_wrist" in info["features"]
    assert not [name for name in info["features"] if "camera" in name or "object" in name]
    assert summary.written_frames == info["total_frames"] < summary.episode_frames
    assert any("resampled to 25 frames per second" in note for note in summary.notes)
    report = (out / "report.json").read_bytes()
    make(slow)
    assert (out / "report.json").read_bytes() == report
    _print(summary, slow)
    said = " ".join(capsys.readouterr().out.split())
    assert f"({summary.episode_frames} frames, {summary.written_frames} in the data set)" in said


def test_other_limits_retarget_nothing(copy):
    folder, output = copy
    before, count = contents(output), Counting()
    summary = make(request(folder, output, no_limits=True), count)
    assert count.kept == count.items == len(FRAMES)
    assert (summary.episodes, summary.dropped) == (4, 0)
    assert contents(output).keys() != before.keys() or contents(output) != before
    make(request(folder, output))
    assert contents(output) == before


def test_an_empty_result_names_the_limit_to_change(copy):
    """And nothing stands there that could be taken for a data set."""
    folder, output = copy
    summary = make(request(folder, output, min_seconds=1000.0, max_gap=0.25))
    assert summary.episodes == 0
    said = "\n".join(summary.notes)
    assert "Nothing was kept, so no data set is written" in said
    broken = r"5 of 6 violate --min-seconds 1000\.0; their values are [\d.]+ to [\d.]+\n"
    assert re.search(broken, said)
    assert not (output / "dataset").exists()
    assert make(request(folder, output)).notes == []
    assert (output / "dataset").exists()


def test_only_changed_clips_are_computed_again(copy):
    folder, output = copy
    os.utime(folder / "a.pair.npz")  # another date, the same content
    count = Counting()
    make(request(folder, output), count)
    assert (count.items, count.kept) == (4, 4)
    save_pair(folder / "a.pair.npz", 30, 99)
    (folder / "b.pair.npz").unlink()
    save_pair(folder / "new.pair.npz", 31, 5)
    summary = make(request(folder, output), count)
    assert (count.items, count.kept) == (4, 2)
    assert summary.episodes == 4
    fresh = output.with_name("fresh")
    make(request(folder, fresh))
    assert contents(output) == contents(fresh)


def test_a_pack_with_clips_of_other_packs_is_deleted(copy):
    """A worker of a killed run ends its pack while the next run makes the same clips."""
    folder, output = copy
    packs = sorted(output.rglob("pack-*.zip"))
    again = packs[0].with_name("pack-0.zip")  # earlier in the order, so it is not the one in use
    shutil.copy(packs[0], again)
    make(request(folder, output))
    assert sorted(output.rglob("pack-*.zip")) == packs
    (folder / "a.pair.npz").unlink()  # no longer asked for, and perhaps again tomorrow
    make(request(folder, output))
    assert sorted(output.rglob("pack-*.zip")) == packs


def test_a_damaged_pack_is_replaced(copy):
    folder, output = copy
    before = contents(output)
    packs = sorted((output / "work").rglob("pack-*.zip"))
    packs[0].write_bytes(packs[0].read_bytes()[:-50])
    make(request(folder, output))
    assert contents(output) == before
    packs = sorted((output / "work").rglob("pack-*.zip"))
    with zipfile.ZipFile(packs[0]) as pack:
        array = pack.getinfo("0/commands.right.joint_positions.npy")
    data = bytearray(packs[0].read_bytes())
    data[array.header_offset + array.compress_size] ^= 1  # is found when the array is read
    packs[0].write_bytes(data)
    shutil.rmtree(output / "dataset")
    with pytest.raises(RecordingError, match="run the same command again"):
        make(request(folder, output))
    make(request(folder, output))
    assert contents(output) == before


def test_a_bad_file_does_not_end_the_run(folder, tmp_path):
    source = tmp_path / "in"
    source.mkdir()
    shutil.copy(folder / "a.pair.npz", source)
    (source / "bad.pair.npz").write_bytes(b"PK\x03\x04")
    save_pair(source / "short.pair.npz", 1)
    nothing = dict.fromkeys(("right_landmarks", "left_landmarks"), np.full((30, 21, 3), np.nan))
    save_pair(source / "blind.pair.npz", 30, **nothing)
    summary = make(request(source, tmp_path / "out"))
    assert summary.clips == 1
    assert [*summary.failed] == ["bad", "blind", "short"]  # in any order of the workers
    assert "bad.pair.npz: can't be read" in summary.failed["bad"]
    assert "no hand is seen" in summary.failed["blind"]


def test_sources_of_every_kind(folder, tmp_path):
    def names(*sources: object) -> list[str]:
        found = find_items([str(source) for source in sources], layout=LAYOUT)
        assert found.refused == ()
        return [item.name for item in found.items]

    assert names(folder) == sorted(FRAMES)
    assert names(folder / "b.pair.npz") == ["b"]
    assert names(folder / "**" / "*.npz") == sorted(FRAMES)
    assert names(folder / "deep" / "*.npz") == ["c"]
    assert names((folder / "a.pair.npz").as_uri()) == ["a"]
    assert names(folder / "a.pair.npz", folder / "a.pair.npz") == ["a", "a~2"]
    part = find_items([f"{folder / 'a.pair.npz'}@5:25"], layout=LAYOUT).items[0]
    whole = find_items([str(folder / "a.pair.npz")], layout=LAYOUT).items[0]
    assert (part.name, part.frames, part.settings_key == whole.settings_key) == ("a", "5:25", False)
    with pytest.raises(ConfigError, match="frames must be a range"):
        find_items([f"{folder / 'a.pair.npz'}@half"], layout=LAYOUT)
    listed = folder / "list.csv"
    listed.write_text("path,task,side\na.pair.npz,stir,right\ndeep,,\n", encoding="utf-8")
    found = find_items([str(listed)], layout=LAYOUT)
    assert [(i.name, i.task, i.side) for i in found.items] == [
        ("a", "stir", "right"),
        ("deep/c", None, None),
        ("deep/er/d", None, None),
    ]
    lines = tmp_path / "list.jsonl"
    record = {"path": str(folder / "a.pair.npz"), "layout": LAYOUT}
    lines.write_text(json.dumps(record) + "\n", encoding="utf-8")
    assert [item.layout for item in find_items([str(lines)]).items] == [LAYOUT]
    plain = tmp_path / "list.txt"
    plain.write_text(f"# mine\n{folder / 'a.pair.npz'}\nnone.npz\n", encoding="utf-8")
    found = find_items([str(plain)], layout=LAYOUT)
    assert [refused.name for refused in found.refused] == ["none.npz"]
    listed.unlink()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name\na\n", "needs the column 'path'"),
        (
            "t,x,y\n0,0.1,0.2\n1,0.1,0.2\n",
            "a table without the header of landmarks; .*needs the column 'path'",
        ),
        ("path,side\na,up\n", "side must be 'right' or 'left'"),
        ("path,rate\na,fast\n", "rate must be a number of frames per second, not 'fast'"),
    ],
)
def test_invalid_lists(text, says, tmp_path):
    """A table of numbers is not taken for a list."""
    (tmp_path / "list.csv").write_text(text, encoding="utf-8")
    with pytest.raises(RecordingError, match=says):
        find_items([str(tmp_path / "list.csv")])


@pytest.mark.parametrize(
    ("suffix", "good"),
    [
        (".csv", b"path,task,side,rate\n" + b'"a,b.npz",stir,right,30\nc.npz,,left,\n' * 3),
        (".jsonl", b'{"path": "a.npz", "task": "stir", "side": "right", "rate": 30}\n' * 6),
    ],
)
def test_damaged_lists_are_read_or_refused(suffix, good, tmp_path):
    path = tmp_path / f"list{suffix}"

    def read(mutant: bytes) -> None:
        path.write_bytes(mutant)
        if is_manifest(path):
            find_items([str(path)])

    refused, found = fuzzing.outcomes(fuzzing.damaged_bytes(good), 60, read)
    assert refused
    assert found


def test_a_list_with_task_and_side(folder, tmp_path):
    row = {"path": str(folder / "a.pair.npz"), "task": "stir", "side": "left"}
    (tmp_path / "list.jsonl").write_text(json.dumps(row), encoding="utf-8")
    make(request(tmp_path / "list.jsonl", tmp_path / "out"))
    (clip,) = finished(tmp_path / "out").values()
    assert (clip.clip.task, set(clip.commands)) == ("stir", {"left"})


def test_object_storage(folder, tmp_path):
    fsspec = pytest.importorskip("fsspec", reason="needs the extra datasets")
    memory = fsspec.filesystem("memory")
    for name in ("a", "deep/c"):
        memory.pipe_file(f"/hands/{name}.pair.npz", (folder / f"{name}.pair.npz").read_bytes())
    memory.pipe_file("/hands/film.mp4", b"film")
    asked = request(folder, tmp_path / "out", sources=("memory://hands",))
    summary = make(asked)
    assert (summary.clips, summary.failed) == (2, {})
    assert summary.passed_over == {".mp4": 1}
    local = finished(tmp_path / "out")
    assert {clip.clip.meta["source"][0]["path"] for clip in local.values()} == {
        "memory:///hands/a.pair.npz",
        "memory:///hands/deep/c.pair.npz",
    }
    count = Counting()
    make(asked, count)
    assert count.kept == 2
    memory.pipe_file("/hands/a.pair.npz", (folder / "b.pair.npz").read_bytes())
    make(asked, count)
    assert count.kept == 1
    with pytest.raises(RecordingError, match=r"there (are no files|is no such file)"):
        find_items(["memory://elsewhere"])
    with pytest.raises(RecordingError, match="nowhere"):
        find_items(["nowhere://x"])


@pytest.mark.parametrize("text", ["0/3", "4/3", "1", "a/b", "1/0", "-1/3"])
def test_shards_that_do_not_exist_are_refused(text):
    with pytest.raises(ConfigError, match="i from 1 to n"):
        parse_shard(text)


def one_clip(folder: Path, name: str = "a", **more: Any) -> Clip:
    clip = PAIRS.read(ClipRef(name, folder / f"{name}.pair.npz"), ReadingOptions())
    return replace(clip, **more)


def test_wrists_in_the_frame_of_the_camera(folder):
    clip = one_clip(folder)
    with pytest.raises(RecordingError, match="its camera poses are unknown"):
        in_frame(clip, "camera")
    camera = np.tile([1.0, 2.0, 0.5, 0.5, -0.5, 0.5, -0.5], (len(clip), 1))
    seen = in_frame(replace(clip, T_world_camera=camera), "camera")
    assert seen.world == CAMERA
    wrist = clip.hands["left"].T_world_wrist
    found = seen.hands["left"].T_world_wrist
    np.testing.assert_allclose(poses.compose(camera, found), wrist, atol=1e-12)
    with pytest.raises(RecordingError, match="only in the camera's frame"):
        in_frame(seen, "world")
    assert in_frame(seen, None) is seen
    assert in_frame(seen, "camera") is seen


@pytest.fixture(scope="module")
def answered(folder) -> RobotClip:
    (clip,) = retarget_clips([one_clip(folder, "deep/c")], RECIPE)
    assert isinstance(clip, RobotClip)
    return clip


def episodes(clip: RobotClip, **limits: Any) -> list[tuple[str, tuple[str, ...]]]:
    return [
        (each.name, tuple(each.reasons)) if isinstance(each, Dropped) else (each.clip.name, ())
        for each in select(clip, replace(LIMITS, **limits))
    ]


def test_a_jump_of_the_tracker_cuts(answered):
    hand = answered.clip.hands["left"]
    moved = hand.T_world_wrist.copy()
    moved[30:, 0] += 0.3  # 0.3 m in 20 ms
    jumping = replace(
        answered.clip, hands={**answered.clip.hands, "left": replace(hand, T_world_wrist=moved)}
    )
    (clip,) = retarget_clips([jumping], RECIPE)
    assert episodes(clip) == [("deep/c_000000-000030", ()), ("deep/c_000030-000064", ())]
    assert episodes(clip, whole=True) == [("deep/c", ("max_jump",))]
    parts = list(select(clip, LIMITS))
    assert isinstance(parts[1], RobotClip)
    assert parts[1].figures["left.jump_m_s"] < 5.0
    assert parts[1].key != clip.key
    assert len(parts[1].clip) == len(parts[1].commands["left"]) == 34


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ({"min_seconds": 2.0}, "min_seconds"),
        ({"max_tip_error": 0.01}, "max_tip_error"),
        ({"min_reach": 1.0, "max_tip_error": 1e3}, "min_reach"),
        ({"max_collision": 0.5}, "max_collision"),
    ],
)
def test_clips_beyond_a_limit_are_dropped(answered, limits, reason):
    depth = np.full(len(answered.clip), np.nan)
    depth[::10] = 0.0
    depth[::20] = 0.004
    tracks = {f"{side}.penetration": depth * (side == "left") for side in SIDES}
    tracks["right.reached"] = np.zeros(len(depth))
    clip = replace(answered, tracks={**answered.tracks, **tracks})
    assert episodes(clip, max_collision=0.6) == [("deep/c", ())]
    assert episodes(clip, **limits) == [("deep/c", (reason,))]


@pytest.mark.parametrize("short", [1.0, 0.45])
def test_a_robot_in_the_posture_of_an_operator_of_shorter_fingers_reaches(short):
    """Its tips are elsewhere, as its fingers are long; those of a closed hand are not right."""
    hand, recording = load_hand("mimic_p050"), SyntheticOperator(side="right").record(0.1)
    landmarks = recording.landmarks.copy()
    for base in BASES:
        fingers = landmarks[:, base : base + 4]
        fingers[:] = fingers[:, :1] + short * (fingers - fingers[:, :1])
    recording = replace(recording, landmarks=landmarks)
    posture = JointAngleMap(hand).positions(align_recording(recording, hand))
    shares, count = [], len(recording)
    for poses_ in (np.clip(posture, *hand.limits.T), np.tile(hand.limits[:, 1], (count, 1))):
        commands = CommandTrajectory(
            hand.full_configuration(poses_),
            hand.joint_names,
            recording.stamps,
            np.zeros(count),
            np.zeros(count, np.int8),
        )
        loss = [np.zeros(count)]
        (tracks,) = quality_tracks([recording], [commands], loss, hand, AlignmentConfig())
        shares.append((float(tracks["tip_error_max"].max()), float(tracks["reached"].mean())))
    (error, open_), (_, closed) = shares
    assert (open_, closed) == (1.0, 0.0)
    assert (error > REACHED * hand_length(hand)) == (short < 0.5)


def test_a_clip_whose_fingers_never_move_is_dropped(answered):
    """One pose of the hand, carried by the arm; a hand that is still in a part of a clip stays."""
    stamps = 2.0 * answered.clip.stamps  # 2.5 s
    carried = np.linspace(0, 0.4, len(stamps))[:, None, None] * np.array([1.0, 0.2, 0.0])

    def held(frames, sides=SIDES):
        commands = {side: replace(each, stamps=stamps) for side, each in answered.commands.items()}
        hands = {}
        for side, hand in answered.clip.hands.items():
            points = np.array(hand.landmarks)
            if side in sides:
                points[frames] = (points[0] + carried)[frames]
            hands[side] = replace(hand, landmarks=points, stamps=stamps)
        return replace(answered, clip=replace(answered.clip, hands=hands), commands=commands)

    all_frames = slice(None)
    (dropped,) = select(held(all_frames), LIMITS)
    assert dropped.reasons["min_finger_motion"] == "the fingers never move: 0.0 mm in the clip"
    for clip, limits, reasons in (
        (held(all_frames), {}, ("min_finger_motion",)),
        (held(all_frames), {"whole": True}, ("min_finger_motion",)),
        (held(all_frames), {"min_finger_motion": 0.0}, ()),
        (held(slice(0, 30)), {}, ()),
        (held(all_frames, ("left",)), {}, ()),
        (held(all_frames, ("left",)), {"hands": "all"}, ("min_finger_motion",)),
    ):
        assert episodes(clip, **limits) == [("deep/c", reasons)]


def test_clips_can_be_required_to_have_all_hands(answered):
    seen = np.arange(len(answered.clip)) < 32
    clip = replace(answered, valid={**answered.valid, "right": seen})
    assert episodes(clip) == [("deep/c", ())]
    assert episodes(clip, hands="all") == [
        ("deep/c_000000-000032", ()),
        ("deep/c_000032-000064", ("hands",)),
    ]


def test_the_command(folder, tmp_path, capsys):
    source = tmp_path / "in"
    source.mkdir()
    shutil.copy(folder / "a.pair.npz", source)
    (source / "bad.pair.npz").write_bytes(b"PK\x03\x04")
    words = ["dataset", str(source), "--layout", LAYOUT, "--method", "joint_angle"]
    words += ["--output", str(tmp_path / "out"), "--format", "parquet", "--workers", "0"]
    assert main([*words, "--min-seconds", "0.2"]) == 1
    said = capsys.readouterr()
    assert "1 clip (30 frames)" in said.out
    assert "can't be read" in said.out
    assert "2 to retarget, 0 already done" in said.err
    assert main([*words, "--min-seconds", "0.2", "--json", "--quiet"]) == 1
    summary = json.loads(capsys.readouterr().out)
    assert summary["clips"] == 1
    for more, says in [
        (("--shard", "5/4"), "i from 1 to n"),
        (("--shard", "1/4", "--merge"), "give only one of them"),
        (("--format", "parket"), "Did you mean 'parquet'?"),
        (("--min-valid", "2"), "min_valid must be between 0 and 1, not 2"),
        (("--max-gap", "nan"), "max_gap must be 0 or more"),
    ]:
        assert main([*words, *more]) == 2
        assert says in capsys.readouterr().err


def test_results_inside_the_source_are_refused(folder, tmp_path):
    with pytest.raises(OutputError, match="it contains the recordings"):
        make(request(folder, folder))
    (tmp_path / "dataset").mkdir()
    (tmp_path / "dataset" / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match="did not write"):
        make(request(folder / "a.pair.npz", tmp_path))
    with pytest.raises(RecordingError, match="no such file or folder"):
        make(request(tmp_path / "nothing", tmp_path / "out"))


# On a GPU: the same code on this machine's processor.


def test_clips_for_a_gpu_are_read_by_workers_and_retargeted_here(
    folder, whole, tmp_path, monkeypatch
):
    monkeypatch.setattr(pipeline, "gpu_name", lambda: "a processor")
    monkeypatch.setattr(pipeline, "BATCH", 3)  # several batches
    bad = folder.parent / "with-bad"
    shutil.copytree(folder, bad)
    (bad / "broken.pair.npz").write_bytes(b"PK nothing")
    asked = replace(request(bad, tmp_path / "out"), device="gpu")
    summary = make(replace(asked, workers=1))
    assert len(summary.failed) == 1
    assert "broken" in next(iter(summary.failed))
    assert summary.notes[0] == "retargeted on a processor"
    assert "a processor" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    mine, others = finished(tmp_path / "out"), finished(whole[0])
    assert mine.keys() == others.keys()
    for name, clip in mine.items():
        for side in SIDES:
            np.testing.assert_array_equal(
                clip.commands[side].joint_positions, others[name].commands[side].joint_positions
            )
    again = make(replace(asked, workers=0))  # nothing is left to do
    assert again.notes == []


def test_a_missing_gpu_and_unsuitable_work(tmp_path, folder):
    asked = replace(request(folder, tmp_path / "out"), device="gpu")
    with pytest.raises(ConfigError, match=r"JAX sees only .*--device cpu"):
        make(asked)
    merged = make(replace(asked, merge=True))  # retargets nothing, and needs none
    assert len(merged.failed) == len(FRAMES)
    one_by_one = replace(RECIPE.request, scale="calibrate")
    with pytest.raises(ConfigError, match="many clips together"):
        Recipe(one_by_one, device="gpu")
    line = ["dataset", str(folder), "--output", str(tmp_path), "--device", "gpu"]
    assert main([*line, "--cluster", "auto"]) == 2


def test_workers_leave_the_gpu_alone(monkeypatch):
    for before in (None, "cuda"):
        monkeypatch.delenv("JAX_PLATFORMS", raising=False)
        if before is not None:
            monkeypatch.setenv("JAX_PLATFORMS", before)
        with pipeline.only_cpus_in_children():
            assert os.environ["JAX_PLATFORMS"] == "cpu"
        assert os.environ.get("JAX_PLATFORMS") == before


def test_a_change_of_the_code_replaces_clips_and_data_set(copy, monkeypatch):
    folder, output = copy
    before, count = contents(output), Counting()
    (file,) = (output / "dataset").rglob("part-*.parquet")

    def again() -> tuple[int, bool]:
        """Items that were kept, and whether the data set was written."""
        file.touch()
        os.utime(file, ns=(0, 0))
        make(request(folder, output), count)
        return count.kept, file.stat().st_mtime_ns != 0

    assert again() == (len(FRAMES), False)
    with monkeypatch.context() as writers:
        writers.setattr("smooth_hand_datasets.pipeline.writing.code_of_files", lambda _: ["other"])
        assert again() == (len(FRAMES), True)
        assert again() == (len(FRAMES), False)
    assert again() == (len(FRAMES), True)
    parts: list[str] = []

    def digest(*names: str, **_: Any) -> str:
        parts.extend(names)
        return "b"

    with monkeypatch.context() as commands:
        commands.setattr("smooth_hand_datasets.pipeline.code.code_digest", digest)
        assert again() == (0, True)
        assert again() == (len(FRAMES), False)
    assert again() == (len(FRAMES), True)
    assert contents(output) == before
    assert {"retargeting", "hands", "formats", "io", "mano.py", "pipeline/store.py"} <= {*parts}


def test_keys_of_clips_hold_the_code_and_the_readers_of_plugins(monkeypatch, tmp_path):
    module = tmp_path / "own_reader_module.py"
    module.write_text("READER = None\n")
    monkeypatch.syspath_prepend(tmp_path)
    digests = [Recipe(RECIPE.request).digest]
    monkeypatch.setitem(READERS._added, "own", plugins.Entry("own_reader_module:READER"))
    digests.append(Recipe(RECIPE.request).digest)
    module.write_text("READER = 1\n")
    result_cache._package_digest.cache_clear()
    digests.append(Recipe(RECIPE.request).digest)
    monkeypatch.setattr("smooth_hand_datasets.pipeline.code.code_digest", lambda *_, **__: "other")
    digests.append(Recipe(RECIPE.request).digest)
    assert len(set(digests)) == 4


def test_keys_of_clips_do_not_depend_on_the_folder_of_the_hand(tmp_path, monkeypatch):
    hand = load_hand("mimic_p050")
    copy = Path(shutil.copy(hand.spec.model, tmp_path))
    elsewhere = replace(hand, spec=replace(hand.spec, model=copy))
    digests = []
    for one in (hand, elsewhere):
        monkeypatch.setattr(RetargetRequest, "load_hand", lambda self, side, one=one: one)
        digests.append(Recipe(RECIPE.request).digest)
    copy.write_bytes(copy.read_bytes() + b"\n")
    digests.append(Recipe(RECIPE.request).digest)
    assert digests[0] == digests[1] != digests[2]
