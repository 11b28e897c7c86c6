"""Clips from what hand models say of a video, in the forms in which people save it."""

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dataset_files as files
import numpy as np
import pytest
from test_dataset_readers import COUNT, check_camera, clip_of, layout_of

from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import ReadingOptions

Write = Callable[[Path], Any]


def by_name(frames: list[Any]) -> dict[str, Any]:
    return {f"img/frame_{k:05d}.jpg": frame for k, frame in enumerate(frames)}


def flat(frames: list[Any]) -> list[Any]:
    """One table for each hand, with the frame's number in it."""
    return [
        {"frame": k, "handedness": "right" if hand["is_right"] else "left", **hand["wilor_preds"]}
        for k, frame in enumerate(frames)
        for hand in frame
    ]


LOST = {"left": range(4, 6)}

FORMS: dict[str, tuple[str, Write, dict[str, list[int]]]] = {
    "WiLoR-mini, pickled": (
        "a.pkl",
        lambda path: path.write_bytes(files.pickled(files.wilor_frames(lost=LOST))),
        {"left": [4, 5]},
    ),
    "WiLoR-mini, by picture": (
        "a.pkl",
        lambda path: path.write_bytes(files.pickled(by_name(files.wilor_frames()))),
        {},
    ),
    "WiLoR-mini, numpy.save": (
        "a.npy",
        lambda path: np.save(path, np.array(by_name(files.wilor_frames()), object)),
        {},
    ),
    "WiLoR-mini, JSON": (
        "a.json",
        lambda path: path.write_text(json.dumps(files.plain(files.wilor_frames(lost=LOST)))),
        {"left": [4, 5]},
    ),
    "a table a hand": (
        "a.json",
        lambda path: path.write_text(json.dumps(files.plain(flat(files.wilor_frames())))),
        {},
    ),
    "EgoTouch": (
        "wilor_hands.json",
        lambda path: path.write_text(files.egotouch_lines()),
        {"left": [4]},
    ),
    "Data-Juicer": (
        "a.json",
        lambda path: path.write_text(json.dumps(files.hawor_tags())),
        {"left": [0, 1, 2, 3, 4]},
    ),
    "HaMeR": ("v3d.npy", lambda path: np.save(path, np.array(files.hamer_arrays(), object)), {}),
    "arrays of hands": ("a.npz", lambda path: path.write_bytes(files.detections_npz()), {}),
}


@pytest.mark.parametrize("form", FORMS)
def test_forms(tmp_path, form):
    name, write, gone = FORMS[form]
    write(tmp_path / name)
    assert layout_of(tmp_path / name) == "predictions"
    found = clip_of(tmp_path / name)
    check_camera(found, gone, 1e-5)
    np.testing.assert_allclose(found.stamps, np.arange(COUNT) / 30.0)
    with pytest.raises(RecordingError, match="--rate"):
        clip_of(tmp_path / name, ReadingOptions())


def test_video_and_confidence(tmp_path):
    frames = files.wilor_frames()
    for k, frame in enumerate(frames):
        frame[0]["hand_bbox"] = [1.0, 2.0, 3.0, 4.0, 0.5 + 0.01 * k]
    frames[3].append({**frames[7][0], "hand_bbox": [1.0, 2.0, 3.0, 4.0, 0.1]})  # another person
    frames[9] = []
    frames[10].append({"hand_bbox": [0.0] * 4, "is_right": 1.0})  # found, and no more of it
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(frames))
    (tmp_path / "a.mp4").write_bytes(b"a video")
    found = clip_of(tmp_path / "a.pkl")
    check_camera(found, {"right": [9], "left": [9]}, 1e-5)
    assert found.video == tmp_path / "a.mp4"
    assert found.confidence["right"][3] == pytest.approx(0.53)
    assert np.isnan(found.confidence["right"][9])
    assert "left" not in found.confidence
    assert found.meta["more_hands"] == 1


def test_hands_without_a_place_have_no_wrist(tmp_path):
    frames = files.wilor_frames()
    for frame in frames:
        for hand in frame:
            del hand["wilor_preds"]["pred_cam_t_full"]
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(frames))
    found = clip_of(tmp_path / "a.pkl")
    assert found.world is None
    assert all(hand.T_world_wrist is None for hand in found.hands.values())


def test_a_frame_with_the_wrong_side_is_ignored(tmp_path):
    frames = files.wilor_frames()
    for hand in frames[12]:
        hand["is_right"] = 1.0 - hand["is_right"]
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(frames))
    found = clip_of(tmp_path / "a.pkl")
    check_camera(found, {"right": [12], "left": [12]}, 1e-5)
    assert all(hand.meta["other_side_frames"] == 1 for hand in found.hands.values())


def test_mirrored_hands_are_refused(tmp_path):
    """HaMeR and WiLoR see a left hand in a mirrored picture, as a right one."""
    frames = files.wilor_frames()
    for frame in frames:
        frame[1]["wilor_preds"]["pred_keypoints_3d"] *= np.float32([-1, 1, 1])
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(frames))
    with pytest.raises(
        RecordingError, match=r"left hand: judging by its shape, this is a right hand.*\(-1"
    ):
        clip_of(tmp_path / "a.pkl")


def test_exchanged_hands_are_refused(tmp_path):
    (tmp_path / "a.pkl").write_bytes(files.pickled(files.wilor_frames(exchanged=True)))
    (tmp_path / "wilor_hands.json").write_text(files.egotouch_lines(exchanged=True))
    (tmp_path / "b.json").write_text(json.dumps(files.hawor_tags(exchanged=True)))
    for name in ("a.pkl", "wilor_hands.json", "b.json"):
        with pytest.raises(
            RecordingError, match="right hand: judging by its shape, this is a left hand"
        ):
            clip_of(tmp_path / name)


class Evil:
    def __reduce__(self) -> Any:
        return eval, ("1 + 1",)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ([[{"is_right": 2.0, "pred_keypoints_3d": np.zeros((21, 3))}]], "is_right must be 0 or 1"),
        ([[{"pred_keypoints_3d": np.zeros((21, 3))}]], "a hand lacks its side"),
        (
            [[{"is_right": 1, "pred_keypoints_3d": np.zeros((16, 3))}]],
            r"\(21, 3\) were expected",
        ),
        ([[7, "pred_keypoints_3d"]], "a hand of frame 0 must be a table"),
        ("pred_keypoints_3d", "it contains a str; expected frames"),
        ([{"frame": 10**7, "is_right": 1, "pred_keypoints_3d": 0}], "a frame's number"),
        ([{"frame": 900_000, "is_right": 1, "pred_keypoints_3d": np.zeros((21, 3))}], "memory"),
        ([["pred_keypoints_3d", Evil()]], "which is not data"),
    ],
)
def test_different_files_are_refused(tmp_path, value, said):
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(value))
    with pytest.raises(RecordingError, match=said):
        clip_of(tmp_path / "a.pkl")


def test_damaged_files_are_read_soundly_or_refused(tmp_path):
    for library in ("h5py", "pyarrow"):
        pytest.importorskip(library, reason="needs extras")
    import hostile_datasets

    files = hostile_datasets.seeds(tmp_path)["predictions"]
    outcomes = hostile_datasets.outcomes("predictions", files, tmp_path / "mutant", 3)
    assert outcomes == {"read", "refused"}
