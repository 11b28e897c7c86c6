"""MANO: the model files, and 21 landmarks and the wrist from parameters."""

from pathlib import Path
from typing import Any

import mano_files
import numpy as np
import pytest
from mano_files import poses_of, reference_landmarks

from smooth_hand_datasets.mano_model import ManoModel, from_axis_angle, load_model
from smooth_operator import LANDMARKS, poses
from smooth_operator.errors import RecordingError
from smooth_operator.types import Side

SIDES: tuple[Side, ...] = ("right", "left")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made = tmp_path_factory.mktemp("mano")
    mano_files.write_models(made)
    return made


@pytest.fixture(scope="module")
def arrays() -> dict[str, dict[str, np.ndarray]]:
    return {side: mano_files.model_arrays(side) for side in SIDES}


def placed(model: ManoModel, seed: int = 3, count: int = 4, **options: Any) -> tuple[Any, ...]:
    rng = np.random.default_rng(seed)
    pose, root = poses_of(model.side, count, seed)
    betas, at = rng.normal(size=(count, 10)), rng.normal(size=(count, 3))
    turns = model.rotations(root, pose, flat_hand_mean=True)
    return model.place(turns, betas, at, **options), root, pose, betas, at


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("tips", ["smplx", "manopth"])
def test_landmarks_are_those_of_loops_over_vertices(folder, arrays, side, tips):
    model = load_model(folder, side)
    for moves in ("model", "wrist"):
        found, root, pose, betas, at = placed(model, tips=tips, moves=moves)
        for frame in range(len(root)):
            expected = reference_landmarks(
                arrays[side],
                side,
                root[frame],
                pose[frame],
                betas[frame],
                at[frame],
                tips,
                moves == "wrist",
            )
            np.testing.assert_allclose(found.landmarks[frame], expected, atol=1e-10)


@pytest.mark.parametrize("side", SIDES)
def test_components_and_the_mean_pose(folder, arrays, side):
    model = load_model(folder, side)
    rng = np.random.default_rng(0)
    few, root, at = 0.3 * rng.normal(size=(2, 15)), rng.normal(size=(2, 3)), np.zeros((2, 3))
    turns = model.rotations(root, few, pca=True, flat_hand_mean=False)
    found = model.place(turns, np.zeros(10), at).landmarks
    for frame in range(2):
        pose = arrays[side]["hands_mean"].copy()
        for number in range(15):
            pose = pose + few[frame, number] * arrays[side]["hands_components"][number]
        expected = reference_landmarks(
            arrays[side], side, root[frame], pose, np.zeros(10), np.zeros(3)
        )
        np.testing.assert_allclose(found[frame], expected, atol=1e-10)
    flat = model.rotations(root, few, pca=True, flat_hand_mean=True)
    assert np.abs(flat[:, 1:] - turns[:, 1:]).max() > 0.1
    np.testing.assert_array_equal(flat[:, 0], turns[:, 0])


@pytest.mark.parametrize("side", SIDES)
def test_the_wrist_has_the_axes_of_the_project(folder, side):
    model = load_model(folder, side)
    found, *_ = placed(model)
    points, wrist = found.landmarks, found.T_world_wrist
    np.testing.assert_allclose(wrist[:, :3], points[:, 0])
    # By the page of conventions: x to the middle finger's base, z out of the back of the hand.
    turn = poses.rotation_matrices(wrist[:, 3:])
    middle = points[:, LANDMARKS.index("middle_mcp")] - points[:, 0]
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    np.testing.assert_allclose(turn[:, :, 0], middle, atol=1e-12)
    local = np.einsum("tji,tkj->tki", turn, points - points[:, :1])
    assert (local[:, 8, 2] < 0).all()  # bent fingers are on the palm's side
    thumb = local[:, LANDMARKS.index("thumb_mcp"), 1]
    assert ((thumb > 0.02) if side == "right" else (thumb < -0.02)).all()
    np.testing.assert_allclose(wrist, poses.wrist_from_landmarks(points, side), atol=1e-9)


def test_the_left_hand_mirrors_the_right_one(tmp_path):
    # Its shape directions mirrored as well, unlike the published ones.
    for side in SIDES:
        made = mano_files.model_arrays(side, same_x=False)
        (tmp_path / f"MANO_{side.upper()}.pkl").write_bytes(mano_files.model_pickle(made))
    right, left = (load_model(tmp_path, side) for side in SIDES)
    pose, root = poses_of("right", 5)
    betas, at = np.ones(10), np.random.default_rng(0).normal(size=(5, 3))
    flip = np.array([1.0, -1.0, -1.0])
    a = right.place(right.rotations(root, pose, flat_hand_mean=False), betas, at)
    mirrored = (pose.reshape(-1, 15, 3) * flip).reshape(-1, 45)
    b = left.place(
        left.rotations(root * flip, mirrored, flat_hand_mean=False), betas, at * [-1.0, 1.0, 1.0]
    )
    np.testing.assert_allclose(b.landmarks, a.landmarks * [-1.0, 1.0, 1.0], atol=1e-12)


def test_the_published_shape_of_the_left_hand_is_corrected_on_request(folder):
    published, mended = load_model(folder, "left"), load_model(folder, "left", mirrored_shape=True)
    right = load_model(folder, "right")
    np.testing.assert_array_equal(published.shape_directions, right.shape_directions)
    np.testing.assert_array_equal(
        mended.shape_directions, right.shape_directions * np.array([-1, 1, 1])[:, None]
    )
    again = load_model(folder, "right", mirrored_shape=True)
    np.testing.assert_array_equal(again.shape_directions, right.shape_directions)


def test_an_npz_is_read_like_the_pickle(folder, tmp_path, arrays):
    for side in SIDES:
        np.savez(tmp_path / f"MANO_{side.upper()}.npz", **arrays[side])
        a, b = load_model(folder, side), load_model(tmp_path, side)
        np.testing.assert_array_equal(a.shape_directions, b.shape_directions)
        np.testing.assert_allclose(a.regressor, b.regressor)


def test_missing_numbers_stay_missing(folder):
    model = load_model(folder, "right")
    pose, root = poses_of("right", 5)
    pose[1], root[2] = np.nan, np.nan
    at = np.zeros((5, 3))
    at[3] = np.nan
    found = model.place(model.rotations(root, pose, flat_hand_mean=True), np.zeros(10), at)
    seen = np.isfinite(found.landmarks).all(axis=(1, 2))
    assert seen.tolist() == [True, False, False, False, True]
    known = np.isfinite(found.T_world_wrist)
    assert known.all(axis=1).tolist() == [True, True, False, False, True]
    assert not known[2:4].any()
    own = np.array([model.template + 0.01, model.template])
    moved = model.place(
        model.rotations(root[:1], pose[:1], flat_hand_mean=True),
        np.zeros(10),
        at[:1],
        template=own[0],
    )
    np.testing.assert_allclose(moved.landmarks[0, 0], found.landmarks[0, 0] + 0.01)


def test_rotations_of_small_and_large_angles():
    vectors = np.array([[0, 0, 0], [1e-9, 0, 0], [0, np.pi, 0], [0, 0, 7.0], [1e-4, 2e-4, 0]])
    for vector, found in zip(vectors, from_axis_angle(vectors), strict=True):
        np.testing.assert_allclose(found, mano_files._rodrigues(vector), atol=1e-9)


def refused(folder: Path, held: dict[str, Any], side: Side = "right", **changed: Any) -> str:
    folder.mkdir(exist_ok=True)
    np.savez(folder / f"MANO_{side.upper()}.npz", **{**held, **changed})
    with pytest.raises(RecordingError) as caught:
        load_model(folder, side)
    return str(caught.value)


def test_different_models_are_refused(tmp_path, arrays):
    held = arrays["right"]
    cases: dict[str, tuple[dict[str, Any], str]] = {
        "a": ({"v_template": held["v_template"] * 1000}, "a hand in metres has"),
        "b": ({"v_template": held["v_template"][:500]}, r"shape (778, 3) were expected, not (500"),
        "c": ({"weights": held["weights"] * 2}, "do not add up to one"),
        "d": ({"shapedirs": held["shapedirs"][..., :5]}, "5 directions"),
        "e": ({"kintree_table": held["kintree_table"][:, ::-1]}, "not connected as in MANO"),
        "f": ({"hands_mean": np.full(45, np.nan)}, "not finite"),
    }
    for name, (changed, said) in cases.items():
        assert said in refused(tmp_path / name, held, **changed)
    assert "judging by its shape, it is a left hand" in refused(tmp_path / "g", arrays["left"])
    del (short := dict(held))["posedirs"]
    assert "it lacks posedirs" in refused(tmp_path / "h", short)


def test_a_missing_model_names_its_source(tmp_path, folder):
    with pytest.raises(RecordingError, match=r"MANO_RIGHT\.pkl.*https://mano\.is\.tue\.mpg\.de"):
        load_model(None, "right")
    with pytest.raises(RecordingError, match="no MANO_LEFT"):
        load_model(tmp_path, "left")
    inner = tmp_path / "models"
    inner.mkdir()
    (inner / "MANO_LEFT.pkl").write_bytes((folder / "MANO_LEFT.pkl").read_bytes())
    assert load_model(tmp_path, "left").side == "left"
