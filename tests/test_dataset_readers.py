"""Clips of both hands from data sets, whose files ``dataset_files`` writes by another way."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dataset_files as files
import h5py
import hostile_datasets
import numpy as np
import pytest

from smooth_operator import plugins, read_recording
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.formats.clip import CAMERA, Clip, ReadingOptions, in_frame
from smooth_operator.formats.registry import READERS, RESEARCH_LAYOUTS, clip_readers
from smooth_operator.poses import is_valid, matrices, separation, wrist_from_landmarks

RATED = ReadingOptions(rate=files.RATE)
COUNT = 30


def layout_of(path: Path) -> str:
    """The first layout that a file is of, as the command asks them."""
    return next(name for name, reader in clip_readers().items() if reader.matches(path))


def clip_of(path: Path, options: ReadingOptions = RATED) -> Clip:
    reader = READERS.load(layout_of(path))
    (ref,) = reader.clips(path)
    found: Clip = reader.read(ref, options)
    assert found.layout == layout_of(path)
    assert ref.layout in ("", found.layout)
    assert (found.name, found.source[0]) == (ref.name, path)
    return found


def check_world(found: Clip, points: float, world: str | None = None) -> None:
    """Both hands, with their wrists in a z-up world."""
    assert list(found.hands) == ["right", "left"]
    for side, recording in found.hands.items():
        sent = files.hand(side)
        seen = is_valid(recording.T_world_wrist)
        apart = separation(recording.T_world_wrist[seen], sent.wrist[seen])
        assert (apart < [2 * points, 50 * points]).all()
        assert recording.world == world
        assert "side_assumed" not in recording.meta


def test_egodex_has_both_hands_the_camera_and_the_task(tmp_path):
    path = tmp_path / "7.hdf5"
    about: dict[str, Any] = {"llm_type": "reversible", "llm_description": "put it in"}
    about |= {"llm_description2": "take it out", "environment": "a desk", "llm_objects": ["cup"]}
    files.egodex_file(path, confidence=0.0, about=about | {"which_llm_description": "2"})
    path.with_suffix(".mp4").write_bytes(b"a video")
    found = clip_of(path, ReadingOptions())
    check_world(found, 1e-4, "egodex")
    assert (found.task, found.video) == ("take it out", path.with_suffix(".mp4"))
    assert found.source == (path, path.with_suffix(".mp4"))
    assert (found.meta["environment"], found.meta["llm_objects"]) == ("a desk", ["cup"])
    np.testing.assert_allclose(found.stamps, np.arange(COUNT) / 30.0)
    for side, recording in found.hands.items():
        sent = files.hand(side)
        np.testing.assert_allclose(
            np.delete(recording.landmarks, 3, axis=0), np.delete(sent.points, 3, axis=0), atol=1e-6
        )
        assert np.flatnonzero(~recording.valid.any(axis=1)).tolist() == [3]
        assert np.flatnonzero(~is_valid(recording.T_world_wrist)).tolist() == [3]
        assert found.confidence[side].tolist() == [1.0] * 3 + [0.0] + [1.0] * 26
        # the camera sees the wrist where the file's matrices put it
        seen = in_frame(found, "camera").hands[side].T_world_wrist
        expected = files.in_camera(side)[:, 0]
        np.testing.assert_allclose(seen[4:, :3], expected[4:], atol=1e-6)
        assert (seen[4:, 2] > 0).all()  # the camera looks at the hands
    assert np.array(found.meta["intrinsic"]).shape == (3, 3)


@pytest.mark.parametrize(
    ("about", "task"),
    [
        ({"llm_type": "reversible", "llm_description": "a", "which_llm_description": "1"}, "a"),
        ({"llm_description": "a", "llm_description2": "b", "which_llm_description": "2"}, "a"),
        ({"task": "fold"}, "fold"),
        ({"llm_description": 5}, None),
    ],
)
def test_the_task_of_egodex(tmp_path, about, task):
    files.egodex_file(tmp_path / "0.hdf5", about=about)
    assert clip_of(tmp_path / "0.hdf5").task == task


def test_a_hand_that_never_appears_is_left_out(tmp_path):
    files.egodex_file(tmp_path / "0.hdf5", confidence={"right": 0.0, "left": 0.8})
    found = clip_of(tmp_path / "0.hdf5")
    assert list(found.hands) == list(found.confidence) == ["left"]
    assert found.confidence["left"] == pytest.approx(0.8)
    gone = [f"left{name}" for name in files.EGODEX_ORDER]
    files.egodex_file(tmp_path / "1.hdf5", left_out=gone)
    assert list(clip_of(tmp_path / "1.hdf5").hands) == ["right"]
    files.avp_file(tmp_path / "a.jsonl", sides=["left"])
    assert list(clip_of(tmp_path / "a.jsonl").hands) == ["left"]


def test_different_files_of_egodex_are_refused(tmp_path):
    path = tmp_path / "0.hdf5"
    files.egodex_file(path, left_out=["leftRingFingerTip"])
    with pytest.raises(RecordingError, match=r"transforms/leftRingFingerTip .* has nothing"):
        clip_of(path)
    files.egodex_file(path)
    with h5py.File(path, "r+") as file:
        del file["transforms/camera"]
        file["transforms/camera"] = np.zeros((COUNT - 1, 4, 4))
    with pytest.raises(RecordingError, match=r"transforms/camera .* \(29, 4, 4\)"):
        clip_of(path)


@pytest.mark.parametrize("version", ["earliest", "latest"])
def test_egodex_is_distinguished_from_other_hdf5(tmp_path, version):
    reader = READERS.load("egodex")
    for name, found in (("transforms/rightHand", True), ("hand/landmarks", False)):
        path = tmp_path / f"{found}.hdf5"
        with h5py.File(path, "w", libver=version) as file:
            file[name] = np.zeros((3, 4, 4))
        assert reader.matches(path) is found
    (tmp_path / "a.hdf5").write_bytes(b"transforms\0")
    assert not reader.matches(tmp_path / "a.hdf5")


@pytest.mark.parametrize("side", ["right", "left"])
def test_one_hand_of_egodex_is_a_recording(tmp_path, side):
    files.egodex_file(tmp_path / "0.hdf5")
    read = read_recording(tmp_path / "0.hdf5", rate=30, side=side)
    sent = files.hand(side)
    np.testing.assert_allclose(read.landmarks, sent.points, atol=1e-6)
    assert separation(read.T_world_wrist, sent.wrist).max() < 1e-3
    axes = wrist_from_landmarks(read.landmarks, side)
    assert separation(read.T_world_wrist, axes)[:, 1].max() < 0.06
    np.testing.assert_allclose(read.forearm, np.tile([1.0, 0.0, 0.0], (len(read), 1)), atol=1e-3)
    assert (read.world, read.meta["format"]) == ("egodex", "egodex")
    assert read.metacarpals is not None
    with pytest.raises(RecordingError, match="rate"):
        read_recording(tmp_path / "0.hdf5", side="left")


def test_tracking_streamer_gives_both_hands_on_common_stamps(tmp_path):
    path = tmp_path / "tracking.jsonl"
    files.avp_file(path, lost={"left": range(10, 15)})
    found = clip_of(path, ReadingOptions())
    check_world(found, 1e-4, "avp")
    np.testing.assert_allclose(found.stamps, np.arange(COUNT) / 30.0)
    left = found.hands["left"]
    assert np.flatnonzero(~left.valid.any(axis=1)).tolist() == list(range(10, 15))
    assert np.isnan(left.landmarks[10:15]).all()
    right = found.hands["right"]
    assert right.valid.all()


@pytest.mark.parametrize(("stamped", "apart"), [(True, 0), (True, 3_000_000), (False, 0)])
def test_hts_gives_both_hands_on_common_stamps(tmp_path, stamped, apart):
    path = tmp_path / "hands.hts"
    files.hts_file(path, stamped=stamped, apart_ns=apart)
    found = clip_of(path, ReadingOptions() if stamped else RATED)
    check_world(found, 1e-3, "hts")
    assert len(found) == COUNT
    first = 1.0 if stamped else 0.0
    np.testing.assert_allclose(found.stamps, first + np.arange(COUNT) / 30.0, atol=1e-6)
    assert all(hand.valid is not None and hand.valid.all() for hand in found.hands.values())
    if not stamped:
        with pytest.raises(RecordingError, match="--rate"):
            clip_of(path, ReadingOptions())


def test_hands_of_different_rates_are_on_one_clock(tmp_path):
    """Every second frame of the left hand is missing, and it is 5 ms late."""
    path = tmp_path / "hands.hts"
    files.hts_file(path, apart_ns=5_000_000)
    parts = path.read_bytes().split(b"\n")
    kept = [part for i, part in enumerate(parts) if i // 2 % 4 != 3]
    path.write_bytes(b"\n".join(kept))
    found = clip_of(path)
    assert len(found) == COUNT
    left = found.hands["left"].valid
    assert np.flatnonzero(left.all(axis=1)).tolist() == list(range(0, COUNT, 2))


def test_landmarks_of_both_hands_with_all_optional_arrays(tmp_path):
    path, sure = tmp_path / "take_3.npz", np.linspace(0, 1, COUNT)
    (tmp_path / "take.mp4").write_bytes(b"a video")
    cup = np.tile([0.4, 0, 1, 1, 0, 0, 0], (COUNT, 1))
    cup[2] = np.nan
    seen = np.ones((COUNT, 21), bool)
    seen[5] = False
    more: dict[str, Any] = {"world": "lab", "task": "pour", "video": "elsewhere/take.mp4"}
    more |= {"confidence_left": sure, "valid_right": seen, "T_world_object_cup": cup}
    files.landmarks_file(path, T_world_camera=np.tile([0, 0, 2, 1.02, 0, 0, 0], (COUNT, 1)), **more)
    found = clip_of(path, ReadingOptions())
    check_world(found, 1e-9, "lab")
    assert (found.task, found.video) == ("pour", tmp_path / "take.mp4")
    np.testing.assert_allclose(found.stamps, 5.0 + np.arange(COUNT) / 30.0)
    np.testing.assert_array_equal(found.confidence["left"], sure)
    assert list(found.confidence) == ["left"]
    np.testing.assert_array_equal(found.objects[0].T_world_object, cup)
    assert found.objects[0].name == "cup"
    assert found.T_world_camera[0].tolist() == [0, 0, 2, 1, 0, 0, 0]
    right = found.hands["right"].valid
    assert np.flatnonzero(~right.any(axis=1)).tolist() == [5]


def test_landmarks_may_be_nodes_of_a_headset_without_stamps(tmp_path):
    path = tmp_path / "a.npz"
    nothing = {"T_world_wrist_right": None, "T_world_wrist_left": None, "timestamps": None}
    nodes = files.hand("left").nodes.copy()
    nodes[7] = 0.0  # no hand
    files.landmarks_file(path, **nothing, right=None, left=nodes)
    found = clip_of(path)
    assert (list(found.hands), found.world) == (["left"], None)
    left = found.hands["left"]
    np.testing.assert_array_equal(left.landmarks[:7], files.hand("left").points[:7])
    assert left.metacarpals is not None
    assert np.flatnonzero(~left.valid.any(axis=1)).tolist() == [7]
    with pytest.raises(RecordingError, match="--rate"):
        clip_of(path, ReadingOptions())


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"left": np.zeros((COUNT, 16, 3))}, r"shape \(T, 21, 3\).*not \(30, 16, 3\)"),
        ({"left": np.zeros((9, 21, 3))}, r"same number of frames, .* and \(9, 21, 3\)"),
        ({"valid_left": np.ones((COUNT, 7))}, r"'valid_left' must have shape \(30,\).*\(30, 21\)"),
        ({"T_world_wrist_left": np.tile([0, 0, 1, 30, 20, 90, 1], (COUNT, 1))}, "of length 97"),
        ({"T_world_object_cup": np.full((COUNT, 4, 4), 0.5)}, "frame 0 is not a rotation"),
        ({"confidence_right": np.full(COUNT, 5.0)}, r"highest is 5; .*percent \(divide by 100\)"),
        ({"confidence_right": np.full(COUNT, 130)}, r"highest is 130; .*bytes \(divide by 255\)"),
        ({"confidence_right": np.arange(COUNT) % 3}, "highest is 2; .*levels"),
        ({"confidence_right": np.array(["x"] * COUNT)}, "confidence_right' must hold real numbers"),
        ({"timestamps": np.zeros(4)}, "'timestamps' must have one timestamp for each"),
        ({"right": files.hand("right").points * 1000, "left": None}, "right hand: .*millimetres"),
    ],
)
def test_different_landmarks_are_refused(tmp_path, more, said):
    files.landmarks_file(tmp_path / "a.npz", **more)
    with pytest.raises(RecordingError, match=said):
        clip_of(tmp_path / "a.npz")


def check_camera(found: Clip, gone: dict[str, list[int]], tolerance: float) -> None:
    """Both hands in the camera's frame, with the wrist of their palms."""
    assert list(found.hands) == ["right", "left"]
    assert found.world == CAMERA
    for side, recording in found.hands.items():
        expected = files.in_camera(side)
        assert np.flatnonzero(~recording.valid.all(axis=1)).tolist() == gone.get(side, [])
        there = recording.valid.all(axis=1)
        np.testing.assert_allclose(
            recording.landmarks[there], expected[there], atol=tolerance, rtol=0
        )
        wrist = in_frame(found, "camera").hands[side].T_world_wrist
        assert is_valid(wrist).tolist() == there.tolist()
        np.testing.assert_allclose(wrist[there, :3], expected[there, 0], atol=tolerance)
        # the axes of the palm, as the wrist's matrix turns them into the camera's
        world = wrist_from_landmarks(files.hand(side).points, side)
        camera = np.linalg.inv(files.camera_in_arkit(COUNT))[:, :3, :3]
        to_arkit = np.array([[0, -1.0, 0], [0, 0, 1], [-1, 0, 0]])
        turned = camera @ to_arkit @ matrices(world)[:, :3, :3]
        np.testing.assert_allclose(
            matrices(wrist)[there, :3, :3], turned[there], atol=100 * tolerance
        )


@pytest.mark.parametrize("empty_rows", [False, True])
def test_egohandkit(tmp_path, empty_rows):
    path = tmp_path / "kitchen_left" / "final" / "hand_tracking.parquet"
    path.parent.mkdir(parents=True)
    files.egohandkit_file(path, empty_rows=empty_rows)
    found = clip_of(path, ReadingOptions())
    last = COUNT - 1
    check_camera(found, {"right": [last], "left": [6, 7, 8, last]}, 1e-6)
    assert (found.name, found.meta["source"]) == ("kitchen_left", ["hawor"])
    np.testing.assert_allclose(found.stamps, 1.0 + np.arange(COUNT) / 30.0)
    assert found.confidence["left"][5] == pytest.approx(0.55)
    assert np.isnan(found.confidence["left"][[6, last]]).all()


def test_egohandkit_without_times_needs_a_rate(tmp_path):
    path = tmp_path / "hand_tracking.parquet"
    files.egohandkit_file(path, stamped=False)
    np.testing.assert_allclose(clip_of(path).stamps, np.arange(COUNT) / 30.0)
    with pytest.raises(RecordingError, match="--rate"):
        clip_of(path, ReadingOptions())
    files.egohandkit_file(path, said={b"coordinate_system": b"opengl"})
    with pytest.raises(RecordingError, match=r"coordinate_system .*, not 'opengl'"):
        clip_of(path)


SWAPPED: dict[str, tuple[str, Callable[..., None]]] = {
    "egodex": ("0.hdf5", files.egodex_file),
    "avp": ("t.jsonl", files.avp_file),
    "hts": ("t.hts", files.hts_file),
    "landmarks": ("a.npz", files.landmarks_file),
    "egohandkit": ("a.parquet", files.egohandkit_file),
}


@pytest.mark.parametrize("layout", SWAPPED)
def test_exchanged_hands_are_refused(tmp_path, layout):
    name, write = SWAPPED[layout]
    write(tmp_path / name)
    found = clip_of(tmp_path / name)
    assert found.layout == layout
    for side, recording in found.hands.items():
        wrong, whole = files.wrong_frames(recording.landmarks, recording.valid, side)
        assert (wrong, whole > 20) == (0, True)
    write(tmp_path / name, exchanged=True)
    with pytest.raises(
        RecordingError, match="right hand: judging by its shape, this is a left hand"
    ):
        clip_of(tmp_path / name)


def test_plain_recordings_are_still_read(tmp_path):
    np.save(tmp_path / "a.npy", files.hand("right").points)
    found = clip_of(tmp_path / "a.npy")
    assert (found.layout, list(found.hands)) == ("files", ["right"])


def test_json_of_other_programs_is_not_a_data_set(tmp_path):
    (tmp_path / "a.jsonl").write_text(json.dumps({"x": 1}) + "\n")
    names = [name for name in READERS if READERS.load(name).matches(tmp_path / "a.jsonl")]
    assert names == ["files"]  # by its suffix; it says then what it reads


def test_a_message_says_how_to_install_the_research_data_sets(monkeypatch):
    monkeypatch.setattr(plugins, "_installed", lambda group: {})
    install = r"python -m pip install \. \./packages/smooth_hand_datasets"
    with pytest.raises(ConfigError, match=install):
        READERS.load("grab")


def test_all_layouts_of_the_research_data_sets_are_listed():
    offered = {name for name, entry in READERS.plugins.items() if "smooth_hand" in entry.target}
    assert offered == set(RESEARCH_LAYOUTS)


@pytest.mark.parametrize("tries", [6, pytest.param(24, marks=pytest.mark.weekly)])
@pytest.mark.parametrize("layout", SWAPPED)
def test_damaged_files_are_read_soundly_or_refused(tmp_path, layout, tries):
    seeds = hostile_datasets.seeds(tmp_path)[layout]
    assert hostile_datasets.outcomes(layout, seeds, tmp_path / "mutant", tries)
