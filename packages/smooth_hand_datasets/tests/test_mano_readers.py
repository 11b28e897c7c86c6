"""Data sets in MANO's parameters: a reader finds what an independent writer put there."""

import contextlib
from pathlib import Path
from typing import Any

import fuzzing
import hostile_mano
import mano_files
import mano_layouts as layouts
import numpy as np
import pytest
from hostile_datasets import read_soundly
from hypothesis import strategies as st

from smooth_hand_datasets.pipeline.sources import find_items
from smooth_operator import poses
from smooth_operator.errors import RecordingError, SmoothOperatorError
from smooth_operator.formats.clip import CAMERA, Clip, ReadingOptions
from smooth_operator.formats.registry import READERS


@pytest.fixture(scope="module")
def models(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("mano")
    mano_files.write_models(folder)
    return folder


def read(layout: str, path: Path, models: Path, **options: Any) -> Clip:
    reader = READERS.load(layout)
    assert reader.matches(path)
    (ref,) = reader.clips(path)
    assert ref.layout == layout
    return reader.read(ref, ReadingOptions(mano=models, **options))


@pytest.mark.parametrize("case", layouts.CASES)
def test_clips_are_read_as_written(tmp_path, models, case):
    layout, write = layouts.CASES[case]
    made = write(tmp_path)
    found = read(layout, made.path, models)
    assert set(found.hands) == set(made.landmarks)
    for side, frames in made.landmarks.items():
        hand = found.hands[side]
        for frame, points in frames.items():
            np.testing.assert_allclose(hand.landmarks[frame], points, atol=2e-6)
            axes = poses.wrist_from_landmarks(points, side)
            apart = poses.separation(hand.T_world_wrist[frame], axes)
            np.testing.assert_allclose(apart, 0.0, atol=5e-5)
        if made.shape.get(side) is not None:
            np.testing.assert_allclose(found.shape[side], made.shape[side], atol=1e-6)
    np.testing.assert_allclose(found.stamps, made.stamps)
    assert found.task == made.task
    objects = {one.name: one for one in found.objects}
    for name, matrices in made.objects.items():
        known = np.isfinite(objects[name].T_world_object).all(axis=1)
        assert known.sum() >= layouts.FRAMES - 1
        got = poses.matrices(objects[name].T_world_object[known])
        np.testing.assert_allclose(got, matrices[known], atol=2e-6)
    for name, mesh in made.meshes.items():
        assert objects[name].mesh == mesh.resolve() or objects[name].mesh == mesh
    if made.camera is not None:
        camera = np.broadcast_to(made.camera, (layouts.FRAMES, 4, 4))
        np.testing.assert_allclose(poses.matrices(found.T_world_camera), camera, atol=1e-6)
    assert found.video == (made.video and made.video.resolve())
    assert (found.world == CAMERA) == (case in ("ho3d", "ho3d two hands", "mano pickle"))


def test_a_folder_of_all_has_each_clip_once(tmp_path):
    for case, (_, write) in layouts.CASES.items():
        write(tmp_path / case.replace(" ", "_"))
    (tmp_path / "ho3d" / "manual_annotations").mkdir()
    np.save(tmp_path / "ho3d" / "manual_annotations" / "a.npy", np.zeros((21, 3)))
    found = find_items([str(tmp_path)])
    assert not found.refused
    assert [(item.layout, item.name) for item in found.items] == [
        ("arctic", "arctic/raw_seqs/s01/box_grab_01"),
        ("dexycb", "dexycb/20200709-subject-01/20200709_141754"),
        ("dexycb", "dexycb_left/20200709-subject-01/20200709_141754"),
        ("grab", "grab/grab/s1/mug_drink_1"),
        ("ho3d", "ho3d/train/MC1"),
        ("ho3d", "ho3d_two_hands/train/MC1"),
        ("hot3d", "hot3d/P0003_c701bd11"),
        ("hot3d", "hot3d_quest/P0003_c701bd11"),
        ("mano", "mano/take"),
        ("mano", "mano_pickle/take"),
        ("oakink2", "oakink2/anno_preview/scene_01__A001/seq__2023-04-27-19-17-54"),
        ("taco", "taco/Hand_Poses/(stir, spoon, bowl)/20231105_019"),
    ]


def test_frames_without_a_hand_are_missing(tmp_path, models):
    for case, side in (("dexycb", "right"), ("ho3d", "right"), ("hot3d", "left")):
        made = layouts.WRITERS[case](tmp_path / case)
        hand = read(case, made.path, models).hands[side]
        assert hand.valid.all(axis=1).tolist() == [f != 2 for f in range(layouts.FRAMES)]
        assert np.isnan(hand.T_world_wrist[2]).all()


@pytest.mark.parametrize("layout", ["arctic", "mano"])
def test_exchanged_models_and_a_missing_one_are_refused(tmp_path, models, layout):
    made = layouts.WRITERS[layout](tmp_path / "data")
    with pytest.raises(RecordingError, match=r"mano\.is\.tue\.mpg\.de"):
        read(layout, made.path, None)
    wrong = tmp_path / "wrong"
    wrong.mkdir()
    for a, b in (("RIGHT", "LEFT"), ("LEFT", "RIGHT")):
        (wrong / f"MANO_{a}.pkl").write_bytes((models / f"MANO_{b}.pkl").read_bytes())
    with pytest.raises(RecordingError, match="were the two files exchanged"):
        read(layout, made.path, wrong)


def test_another_rate(tmp_path, models):
    for layout in ("arctic", "taco"):
        made = layouts.WRITERS[layout](tmp_path / layout)
        found = read(layout, made.path, models, rate=60.0)
        np.testing.assert_allclose(np.diff(found.stamps), 1 / 60)


def refused(layout: str, path: Path, models: Path) -> str:
    with pytest.raises(RecordingError) as caught:
        read(layout, path, models)
    return str(caught.value)


def test_missing_parts_are_named(tmp_path, models):
    pickled, npy = mano_files.pickled, mano_files.npy_of_object
    no_poses = pickled({"objName": "mug", "handJoints3D": np.zeros(3)})
    lone_hand, meshes = pickled({"0": {"hand_pose": 1}}), "../../../tools/subject_meshes/male"
    for number, (layout, file, content, said) in enumerate(
        (
            ("dexycb", "meta.yml", b"mano_sides: [right]\n", "it lacks mano_calib"),
            ("dexycb", "../../calibration", None, "lacks calibration/"),
            ("ho3d", "meta/*", no_poses, "evaluation split has no poses"),
            ("arctic", "", npy({"right": {}}), "it lacks left"),
            ("oakink2", "", pickled({"raw_smplx": {}}), "it lacks raw_mano"),
            ("taco", "right_hand.pkl", lone_hand, "it lacks hand_trans"),
            ("grab", f"{meshes}/s1_lhand.ply", None, "extract the data set's tools/subject_meshes"),
            ("hot3d", "metadata.json", b'{"headset": "Vision"}', "which axis points up"),
        )
    ):
        made = layouts.WRITERS[layout](tmp_path / str(number))
        paths = made.path.glob(file) if "*" in file else [(made.path / file).resolve()]
        for path in paths:
            if content is None:
                path.rename(path.with_name("elsewhere"))
            else:
                path.write_bytes(content)
        assert said in refused(layout, made.path, models)
    made = layouts.dexycb(tmp_path / "a")
    np.savez(made.path / "pose.npz", pose_m=np.zeros((8, 1, 51)))
    assert "lacks pose_y" in refused("dexycb", made.path, models)


def changed(folder: Path, **values: Any) -> Path:
    """One hand in a file, some names changed, or left out where the value is None."""
    pose, root = layouts.MOTION["right"]
    held: dict[str, Any] = {
        "global_orient": root,
        "hand_pose": pose,
        "betas": layouts.BETAS["right"],
        "fps": 30.0,
        "transl": layouts.PLACE["right"],
        "side": "right",
        "flat_hand_mean": True,
    }
    held.update(values)
    folder.mkdir(exist_ok=True)
    np.savez(folder / "a.npz", **{key: value for key, value in held.items() if value is not None})
    return folder / "a.npz"


def test_ambiguous_parameters_are_refused(tmp_path, models):
    pose = layouts.MOTION["right"][0]
    for values, said in (
        ({"side": None}, "does not say which hand it is"),
        ({"poses": np.zeros((8, 156))}, "whole-body parameters (SMPL-H, 156 numbers"),
        ({"poses": np.zeros((8, 165)), "side": None}, "whole-body parameters (SMPL-X, 165 numbers"),
        ({"side": "both"}, "side must be 'right' or 'left'"),
        ({"flat_hand_mean": None}, "add flat_hand_mean, True or False"),
        ({"hand_pose": pose[:, :12]}, "set use_pca = True"),
        ({"hand_pose": pose[:, :12], "use_pca": False}, "12 numbers; without use_pca, it needs 45"),
        ({"transl": None}, "it lacks transl"),
        ({"transl": layouts.PLACE["right"][:3]}, "different numbers of frames"),
        ({"fps": None}, "no timestamps"),
        ({"world": "upside_down"}, "world must be camera or one of z_up"),
        ({"side": "left"}, "left hand: the fingers bend out of the back of the hand in "),
        ({"transl": np.full((8, 3), np.nan)}, "no frame shows both the wrist"),
        (
            {
                "global_orient": np.tile(2 * np.eye(3), (8, 1, 1)),
                "hand_pose": np.tile(np.eye(3), (8, 15, 1, 1)),
            },
            "matrices that are not rotations",
        ),
    ):
        assert said in refused("mano", changed(tmp_path, **values), models), values


def test_the_side_may_come_from_the_user(tmp_path, models):
    path = changed(tmp_path, side=None)
    reader = READERS.load("mano")
    clip = reader.read(next(reader.clips(path)), ReadingOptions(mano=models, side="right"))
    assert list(clip.hands) == ["right"]


def test_other_names_and_forms_give_the_same_hand(tmp_path, models):
    pose, root = layouts.MOTION["right"]
    plain = read("mano", changed(tmp_path / "0"), models).hands["right"].landmarks
    mean = layouts.ARRAYS["right"]["hands_mean"]
    same: tuple[dict[str, Any], ...] = (
        {"hand_pose": pose.reshape(-1, 15, 3)},
        {"hand_pose": pose - mean, "flat_hand_mean": False},
        {"global_orient": None, "hand_pose": None, "poses": np.concatenate([root, pose], axis=1)},
        {"transl": None, "trans": layouts.PLACE["right"], "betas": layouts.BETAS["right"][None]},
        {"side": None, "is_right": np.ones(8)},
        {
            "hand_pose": layouts.coefficients("right", 45, mean=True),
            "use_pca": True,
            "flat_hand_mean": False,
        },
    )
    for number, values in enumerate(same):
        other = read("mano", changed(tmp_path / str(number + 1), **values), models)
        np.testing.assert_allclose(other.hands["right"].landmarks, plain, atol=1e-9)
    seen = changed(tmp_path / "seen", valid=np.arange(8) != 3)
    valid = read("mano", seen, models).hands["right"].valid
    assert valid[:, 9].tolist() == [f != 3 for f in range(8)]


def test_a_left_hand_from_a_mirrored_picture(tmp_path, models):
    """As HaMeR and WiLoR have it: parameters of a right hand, mirrored before it is moved."""
    right = read("mano", changed(tmp_path / "a"), models).hands["right"].landmarks
    at = layouts.PLACE["right"][:, None]
    path = changed(tmp_path / "b", side="left", mirrored=True)
    left = read("mano", path, models).hands["left"]
    np.testing.assert_allclose(left.landmarks, (right - at) * [-1.0, 1.0, 1.0] + at, atol=1e-9)
    wrist = poses.wrist_from_landmarks(left.landmarks, "left")
    np.testing.assert_allclose(left.T_world_wrist, wrist, atol=1e-9)


def test_hands_of_the_other_side_are_refused(tmp_path, models):
    made = layouts.arctic(tmp_path)
    held = {}
    for side, other in (("right", "left"), ("left", "right")):
        pose, root = layouts.MOTION[other]
        pose = pose - layouts.ARRAYS[side]["hands_mean"]
        held[side] = {
            "rot": root,
            "pose": pose,
            "trans": layouts.PLACE[side],
            "shape": layouts.BETAS[side],
        }
    made.path.write_bytes(mano_files.npy_of_object(held))
    assert "fingers bend out of the back" in refused("arctic", made.path, models)


@pytest.mark.parametrize("layout", layouts.WRITERS)
def test_damaged_files_are_read_soundly_or_refused(tmp_path, models, layout):
    made = layouts.WRITERS[layout](tmp_path / "data")
    options = ReadingOptions(mano=models)
    good = {file: file.read_bytes() for file in made.files}
    mutants = [
        st.tuples(st.just(file), hostile_mano.DAMAGED[file.suffix](content))
        for file, content in good.items()
    ]

    def read(mutant: tuple[Path, bytes]) -> None:
        file, content = mutant
        file.write_bytes(content)
        with contextlib.suppress(SmoothOperatorError):
            read_soundly(layout, made.path, options)
        file.write_bytes(good[file])

    fuzzing.each(st.one_of(*mutants), 6, read)
    read_soundly(layout, made.path, options)


def test_an_impossible_time_is_refused(tmp_path, models):
    made = layouts.hot3d(tmp_path)
    table = made.path / "dynamic_objects.csv"
    table.write_text(table.read_text().replace("56752108188860", "9999999999999999999"))
    assert "timestamp[ns] is damaged" in refused("hot3d", made.path, models)
