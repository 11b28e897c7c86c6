"""Clips of HaWoR and Dyn-HaMR: hands in MANO's parameters and a camera in one world."""

import pickle
from pathlib import Path
from typing import Any

import fuzzing
import headset_apps as app
import mano_files
import numpy as np
import pytest
from hostile_datasets import outcomes
from test_dataset_readers import clip_of

from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import ReadingOptions
from smooth_operator.formats.registry import READERS
from smooth_operator.poses import matrices, separation, wrist_from_landmarks
from smooth_operator.types import Side

COUNT = 7
SIDES: tuple[Side, Side] = ("left", "right")


def parameters(seed: int) -> dict[str, np.ndarray]:
    """Of one hand: ``trans``, ``rot``, ``pose`` and ``betas`` for each frame."""
    rng = np.random.default_rng(seed)
    bend = np.tile([0.0, 0.0, 0.3], 15) + 0.05 * rng.normal(size=(COUNT, 45))
    return {
        "trans": 0.1 * rng.normal(size=(COUNT, 3)) + (0, 0, 0.5),
        "rot": 0.5 * rng.normal(size=3) + 0.05 * rng.normal(size=(COUNT, 3)),
        "pose": bend if seed % 2 else bend * np.tile([1.0, -1.0, -1.0], 15),
        "betas": np.tile(0.3 * rng.normal(size=10), (COUNT, 1)),
    }


def reference(arrays: dict[str, np.ndarray], side: Side, of: dict[str, np.ndarray]) -> np.ndarray:
    """(T, 21, 3), vertex by vertex."""
    rows = zip(of["rot"], of["pose"], of["betas"], of["trans"], strict=True)
    return np.stack([mano_files.reference_landmarks(arrays, side, *row) for row in rows])


def mended(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The left model with shape directions that are the right one's mirror image."""
    return {**arrays, "shapedirs": arrays["shapedirs"] * np.array([-1.0, 1.0, 1.0])[:, None]}


def hawor_folder(folder: Path, *, valid: np.ndarray | None = None) -> Path:
    """What HaWoR leaves in the folder of a video."""
    hands = [parameters(2), parameters(3)]  # the left one first
    flags = np.ones((2, COUNT)) if valid is None else valid
    parts = [np.stack([hand[name] for hand in hands]) for name in ("trans", "rot", "pose", "betas")]
    folder.mkdir(parents=True)
    path = folder / "world_space_res.pth"
    path.write_bytes(mano_files.pickled([mano_files.Tensor(part) for part in (*parts, flags)]))
    (folder / "SLAM").mkdir()
    camera = np.tile([0.1, 0.2, 0.3, 0.5, -0.5, 0.5, 0.5], (COUNT, 1))  # x y z and x y z w
    camera[:, 0] += np.arange(COUNT)
    name = f"hawor_slam_w_scale_0_{COUNT}.npz"
    np.savez(folder / "SLAM" / name, traj=camera.astype(np.float32), scale=np.float64(2.0))
    return path


def test_hawor(tmp_path):
    arrays = mano_files.write_models(tmp_path / "mano")
    valid = np.ones((2, COUNT))
    valid[0, 2] = 0.0
    path = hawor_folder(tmp_path / "kitchen", valid=valid)
    (tmp_path / "kitchen.mp4").write_bytes(b"a video")
    found = clip_of(path, ReadingOptions(rate=30.0, mano=tmp_path / "mano"))
    assert (found.name, found.layout, found.world) == ("kitchen", "hawor", "hawor")
    assert found.video == tmp_path / "kitchen.mp4"
    assert len(found.source) == 3
    reader = READERS.load("hawor")  # which does not look into the rest of the folder
    assert reader.matches(path.parent)
    assert [ref.path for ref in reader.clips(path.parent)] == [path]
    assert not reader.matches(tmp_path)
    for side, seed in zip(SIDES, (2, 3), strict=True):
        own = mended(arrays[side]) if side == "left" else arrays[side]
        expected = reference(own, side, parameters(seed))
        hand = found.hands[side]
        gone = [2] if side == "left" else []
        assert np.flatnonzero(~hand.valid.all(axis=1)).tolist() == gone
        assert np.isnan(hand.landmarks[gone]).all()
        there = hand.valid.all(axis=1)
        np.testing.assert_allclose(hand.landmarks[there], expected[there], atol=1e-6)
        apart = separation(hand.T_world_wrist, wrist_from_landmarks(expected, side))[there]
        assert (apart < [1e-6, 0.02]).all()
        np.testing.assert_allclose(found.shape[side], parameters(seed)["betas"][0], atol=1e-6)
    np.testing.assert_allclose(found.T_world_camera[1], [2.2, 0.4, 0.6, 0.5, 0.5, -0.5, 0.5])


def test_hawor_needs_models_and_a_rate(tmp_path):
    path = hawor_folder(tmp_path / "kitchen")
    with pytest.raises(RecordingError, match=r"--mano"):
        clip_of(path)
    mano_files.write_models(tmp_path / "mano")
    options = ReadingOptions(rate=30.0, mano=tmp_path / "mano")
    with pytest.raises(RecordingError, match="--rate"):
        clip_of(path, ReadingOptions(mano=tmp_path / "mano"))
    for value, said in (
        ([1, 2], "expected world_space_res.pth, a list"),
        ([np.zeros((2, 4, 3)), np.zeros((2, 4, 3)), np.zeros((2, 4, 48)), 0, 0], "poses: .*4, 45"),
    ):
        path.write_bytes(pickle.dumps(value))
        with pytest.raises(RecordingError, match=said):
            clip_of(path, options)


def dyn_hamr_arrays() -> dict[str, Any]:
    """A left and a right hand, and another right one; the camera as world to camera."""
    hands = [parameters(3), parameters(5), parameters(7)]
    turn = app.turn((0.5, 0.5, 0.5, 0.5))
    return {
        "trans": np.stack([hand["trans"] for hand in hands]),
        "root_orient": np.stack([hand["rot"] for hand in hands]),
        "pose_body": np.stack([hand["pose"].reshape(COUNT, 15, 3) for hand in hands]),
        "betas": np.stack([hand["betas"][0] for hand in hands]),
        "is_right": np.repeat([[0.0], [1.0], [1.0]], COUNT, axis=1),
        "cam_R": np.tile(turn, (3, COUNT, 1, 1)),
        "cam_t": np.tile([0.1, 0.2, 0.3], (3, COUNT, 1)),
        "intrins": np.array([500.0, 500.0, 320.0, 240.0]),
    }


def test_dyn_hamr(tmp_path):
    arrays = mano_files.write_models(tmp_path / "mano")
    path = tmp_path / "kitchen_000300_world_results.npz"
    np.savez(path, **dyn_hamr_arrays())
    found = clip_of(path, ReadingOptions(rate=30.0, mano=tmp_path / "mano"))
    assert (found.name, found.layout) == ("kitchen_000300", "dynhamr")
    assert found.meta["more_tracks"] == 1
    for side, seed in zip(SIDES, (3, 5), strict=True):
        expected = reference(arrays["right"], "right", parameters(seed))
        if side == "left":
            expected = expected * (-1, 1, 1)
        np.testing.assert_allclose(found.hands[side].landmarks, expected, atol=1e-6)
    camera = found.T_world_camera
    to_camera = np.linalg.inv(matrices(camera))[0]
    np.testing.assert_allclose(to_camera[:3, :3], app.turn((0.5, 0.5, 0.5, 0.5)), atol=1e-9)
    np.testing.assert_allclose(to_camera[:3, 3], [0.1, 0.2, 0.3], atol=1e-9)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"is_right": np.array([[0.0] * 3 + [1.0] * 4] * 3)}, "is_right of track 0 must be 0 or 1"),
        ({"betas": np.zeros((3, 16))}, r"betas: .* \(3, 10\) were expected, not \(3, 16\)"),
        ({"cam_t": np.zeros((3, 3))}, r"cam_t: numbers of shape \(3, 7, 3\) were expected"),
    ],
)
def test_different_files_of_dyn_hamr_are_refused(tmp_path, more, said):
    mano_files.write_models(tmp_path / "mano")
    np.savez(tmp_path / "a.npz", **(dyn_hamr_arrays() | more))
    with pytest.raises(RecordingError, match=said):
        clip_of(tmp_path / "a.npz", ReadingOptions(rate=30.0, mano=tmp_path / "mano"))


@pytest.mark.parametrize("layout", ["hawor", "dynhamr"])
def test_damaged_files_are_read_soundly_or_refused(tmp_path, layout):
    mano_files.write_models(tmp_path / "mano")
    if layout == "hawor":
        path, damaged = hawor_folder(tmp_path / "kitchen"), fuzzing.damaged_bytes
    else:
        path, damaged = tmp_path / "a.npz", fuzzing.damaged_npz
        np.savez(path, **dyn_hamr_arrays())
    files = [(path.name, path.read_bytes(), damaged)]
    assert "refused" in outcomes(layout, files, tmp_path / "mutant", 12)
