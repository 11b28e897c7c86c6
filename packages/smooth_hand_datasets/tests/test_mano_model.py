"""MANO: the model files, and 21 landmarks and the wrist from parameters."""

from pathlib import Path
from typing import Any

import mano_files
import numpy as np
import pytest
from mano_files import poses_of

from smooth_hand_datasets.mano_model import from_axis_angle, load_model
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
