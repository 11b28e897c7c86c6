"""Clips from what hand models say of a video, in the forms in which people save it."""

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dataset_files as files
import hostile_datasets
import numpy as np
import pytest
from test_dataset_readers import COUNT, check_camera, clip_of, layout_of

from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import ReadingOptions


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
RIGHT_FIRST = {"left": [0, 1, 2, 3, 4]}

FORMS: dict[str, tuple[str, Callable[[], Any], dict[str, list[int]]]] = {
    "WiLoR-mini, pickled": ("a.pkl", lambda: files.wilor_frames(lost=LOST), {"left": [4, 5]}),
    "WiLoR-mini, by picture": ("a.pkl", lambda: by_name(files.wilor_frames()), {}),
    "WiLoR-mini, numpy.save": ("a.npy", lambda: by_name(files.wilor_frames()), {}),
    "WiLoR-mini, JSON": ("a.json", lambda: files.wilor_frames(lost=LOST), {"left": [4, 5]}),
    "a table a hand": ("a.json", lambda: flat(files.wilor_frames()), {}),
    "EgoTouch": ("wilor_hands.json", files.egotouch_lines, {"left": [4]}),
    "Data-Juicer": ("a.json", files.hawor_tags, RIGHT_FIRST),
    "HaMeR": ("v3d.npy", files.hamer_arrays, {}),
    "arrays of hands": ("a.npz", files.detections_npz, {}),
}


def save(path: Path, value: Any) -> Path:
    """Writes what a model gives, in the form of the suffix."""
    if isinstance(value, str | bytes):
        path.write_bytes(value if isinstance(value, bytes) else value.encode())
    elif path.suffix == ".npy":
        np.save(path, np.array(value, object))
    elif path.suffix == ".json":
        path.write_text(json.dumps(files.plain(value)))
    else:
        path.write_bytes(pickle.dumps(value))
    return path


@pytest.mark.parametrize("form", FORMS)
def test_forms(tmp_path, form):
    name, make, gone = FORMS[form]
    path = save(tmp_path / name, make())
    assert layout_of(path) == "predictions"
    found = clip_of(path)
    check_camera(found, gone, 1e-5)
    np.testing.assert_allclose(found.stamps, np.arange(COUNT) / 30.0)
    with pytest.raises(RecordingError, match="--rate"):
        clip_of(path, ReadingOptions())


def test_video_and_confidence(tmp_path):
    frames = files.wilor_frames()
    for k, frame in enumerate(frames):
        frame[0]["hand_bbox"] = [1.0, 2.0, 3.0, 4.0, 0.5 + 0.01 * k]
    frames[3].append({**frames[7][0], "hand_bbox": [1.0, 2.0, 3.0, 4.0, 0.1]})  # another person
    frames[9] = []
    frames[10].append({"hand_bbox": [0.0] * 4, "is_right": 1.0})  # found, and no more of it
    save(tmp_path / "a.pkl", frames)
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
    save(tmp_path / "a.pkl", frames)
    found = clip_of(tmp_path / "a.pkl")
    assert found.world is None
    assert all(hand.T_world_wrist is None for hand in found.hands.values())


def test_a_frame_with_the_wrong_side_is_ignored(tmp_path):
    frames = files.wilor_frames()
    for hand in frames[12]:
        hand["is_right"] = 1.0 - hand["is_right"]
    save(tmp_path / "a.pkl", frames)
    found = clip_of(tmp_path / "a.pkl")
    check_camera(found, {"right": [12], "left": [12]}, 1e-5)
    assert all(hand.meta["other_side_frames"] == 1 for hand in found.hands.values())


def test_mirrored_hands_are_refused(tmp_path):
    """HaMeR and WiLoR see a left hand in a mirrored picture, as a right one."""
    frames = files.wilor_frames()
    for frame in frames:
        frame[1]["wilor_preds"]["pred_keypoints_3d"] *= np.float32([-1, 1, 1])
    save(tmp_path / "a.pkl", frames)
    with pytest.raises(
        RecordingError, match=r"left hand: judging by its shape, this is a right hand.*\(-1"
    ):
        clip_of(tmp_path / "a.pkl")


def test_exchanged_hands_are_refused(tmp_path):
    for name, value in (
        ("a.pkl", files.wilor_frames(exchanged=True)),
        ("wilor_hands.json", files.egotouch_lines(exchanged=True)),
        ("b.json", files.hawor_tags(exchanged=True)),
    ):
        save(tmp_path / name, value)
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
        ([[{"is_right": 1, "pred_keypoints_3d": np.zeros((16, 3))}]], r"\(21, 3\) were expected"),
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
    files = hostile_datasets.seeds(tmp_path)["predictions"]
    found = hostile_datasets.outcomes("predictions", files, tmp_path / "mutant", 3)
    assert found == {"read", "refused"}
