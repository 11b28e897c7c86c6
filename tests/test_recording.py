"""Reading recordings: every format, and every way in which a file can be bad."""

import io
import json
import pickle
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from made_hands import hand_points

from smooth_operator import read_recording
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.formats.checks import check_units, frame_slice, reading_notes
from smooth_operator.landmarks import (
    FROM_MANUS_25,
    FROM_OPENXR_26,
    METACARPALS_MANUS_25,
    NODE_LAYOUTS,
)
from smooth_operator.poses import matrices

FRAMES = 12


def hand(frames: int = FRAMES, nodes: int = 21, seed: int = 0) -> np.ndarray:
    """(frames, nodes, 3) of a right hand; nodes that the 21 leave out are between the others."""
    own = hand_points(frames, seed)
    points = np.repeat(own.mean(axis=1, keepdims=True), nodes, axis=1)
    points[:, list(NODE_LAYOUTS[nodes][0])] = own
    return points


def manus(frames: int = FRAMES, **changes: object) -> dict[str, object]:
    rng = np.random.default_rng(1)
    quaternions = rng.normal(size=(frames, 25, 4))
    quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
    arrays: dict[str, object] = {
        "data": np.concatenate([hand(frames, 25), quaternions], axis=-1).astype(np.float32),
        "timestamps": 1.7e9 + np.arange(frames) / 115.0,
        "keypoint_ids": np.arange(25, dtype=np.int32),
        "chirality": np.array("RIGHT"),
        "quaternion_order": np.array("wxyz"),
        "glove_ids": np.array([7], np.int64),
    }
    arrays.update(changes)
    return {name: value for name, value in arrays.items() if value is not None}


def save(path: Path, arrays: dict[str, object]) -> Path:
    np.savez(path, **arrays)
    return path


def refused(path: Path, match: str, **options: object) -> str:
    with pytest.raises(RecordingError, match=match) as caught:
        read_recording(path, **options)
    message = str(caught.value)
    assert str(path) in message
    return message


@pytest.mark.shared
def test_real_manus_recording(shared):
    path = shared / "recordings" / "manus_right_subject-000_run-010.npz"
    recording = read_recording(path)
    assert recording.landmarks.shape == (5000, 21, 3)
    assert recording.side == "right"
    assert recording.meta["side_assumed"] is False
    assert recording.meta["glove_ids"] == [3064964832]
    assert recording.rate_hz == pytest.approx(118.5, abs=0.1)
    assert recording.duration == pytest.approx(43.38, abs=0.01)
    assert recording.valid.all()
    with np.load(path, allow_pickle=False) as stored:
        data = stored["data"].astype(float)
    np.testing.assert_array_equal(recording.landmarks, data[:, FROM_MANUS_25, :3])
    np.testing.assert_array_equal(recording.metacarpals, data[:, METACARPALS_MANUS_25, :3])
    np.testing.assert_allclose(np.linalg.norm(recording.orientations, axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(recording.orientations, data[:, FROM_MANUS_25, 3:], atol=0.011)


@pytest.mark.shared
def test_real_landmark_arrays(shared):
    for name, rate, frames in (
        ("human_alex_21x3.npy", 100.0, 3498),
        ("wilor_test_long_21x3.npz", 30.0, 1647),
    ):
        path = shared / "recordings" / name
        recording = read_recording(path, rate=rate, side="right")
        assert recording.landmarks.shape == (frames, 21, 3)
        assert recording.rate_hz == pytest.approx(rate)
        assert "--rate 100" in refused(path, "no timestamps")
    message = refused(shared / "recordings" / "pinch_poses_wilor_21x3.npz", "4 single poses")
    for finger in ("index", "middle", "ring", "little"):
        assert f"thumb_to_{finger}_tip" in message


def test_manus_ids_and_quaternion_order_are_honoured(tmp_path):
    plain = read_recording(save(tmp_path / "a.npz", manus()))
    order = np.random.default_rng(2).permutation(25)
    data = np.asarray(manus()["data"])[:, order]
    data = data[..., [0, 1, 2, 4, 5, 6, 3]]  # wxyz -> xyzw
    shuffled = manus(data=data, keypoint_ids=order, quaternion_order=np.array("xyzw"))
    restored = read_recording(save(tmp_path / "b.npz", shuffled))
    np.testing.assert_array_equal(restored.landmarks, plain.landmarks)
    np.testing.assert_array_equal(restored.metacarpals, plain.metacarpals)
    np.testing.assert_array_equal(restored.orientations, plain.orientations)
    expected = np.asarray(manus()["data"], float)[:, 6, 3:]  # node 6: index MCP, landmark 5
    np.testing.assert_allclose(plain.orientations[:, 5], expected, atol=1e-6)


def test_manus_extra_node_is_ignored(tmp_path):
    data = np.asarray(manus()["data"])
    wider = np.concatenate([np.full_like(data[:, :1], 9.0), data], axis=1)
    path = save(tmp_path / "a.npz", manus(data=wider, keypoint_ids=np.r_[99, np.arange(25)]))
    assert np.abs(read_recording(path).landmarks).max() < 1.0


def test_manus_without_ids_is_assumed_with_a_note(tmp_path):
    path = save(tmp_path / "a.npz", manus(keypoint_ids=None, quaternion_order=None))
    assert read_recording(path).meta["assumed"] == ["keypoint_ids", "quaternion_order"]


def partly_seen() -> np.ndarray:
    """No frame has both the wrist and the middle finger's MCP."""
    points = hand()
    points[::2, 0] = np.nan
    points[1::2, 9] = np.nan
    return points


HUGE = (
    "{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999, 21, 3), }".ljust(117) + "\n"
)
REFUSED = [
    *(
        (manus(**changes), match)
        for changes, match in (
            ({"keypoint_ids": np.r_[np.arange(24), 30]}, r"\[24\] are missing"),
            ({"keypoint_ids": np.arange(24)}, "must name each of the 25 nodes"),
            (
                {"data": np.ones((3, 26, 7)), "keypoint_ids": np.r_[np.arange(25), 3]},
                "more than once",
            ),
            ({"data": np.ones((3, 20, 7)), "keypoint_ids": None}, "25 nodes, but this one has 20"),
            ({"quaternion_order": np.array("zyxw")}, "must be 'wxyz' or 'xyzw', not"),
            ({"data": np.zeros((0, 25, 7)), "timestamps": np.zeros(0)}, "contains no frames"),
            ({"chirality": np.array(["RIGHT", "LEFT"])}, "mixes left and right"),
            ({"chirality": np.array("BOTH")}, "side must be 'right' or 'left', not 'BOTH'"),
            ({"chirality": np.array(1)}, "must hold text"),
            ({"timestamps": np.arange(5.0)}, "one timestamp for each of the 12 frames"),
            ({"timestamps": None}, "no timestamps"),
            ({"data": np.asarray(manus()["data"]).astype(str)}, "must hold real numbers"),
        )
    ),
    *(
        ({"landmarks": hand(), "valid": flags}, match)
        for flags, match in (
            (
                np.full(FRAMES, 0.4),
                r"'valid' must be true or false, or 1 or 0, not float64 with values such as 0\.4",
            ),
            (np.full((FRAMES, 21), np.nan), "must be true or false"),
            (np.full(FRAMES, "yes"), "must be true or false, or 1 or 0, not <U3"),
            (np.ones((FRAMES, 5)), r"must have shape \(12,\), one per frame, or \(12, 21\)"),
        )
    ),
    *(
        ({"landmarks": hand(), "T_world_wrist": wrist}, match)
        for wrist, match in (
            (np.tile([0, 0, 1, 30, 20, 90, 1], (FRAMES, 1)), "frame 0 has a quaternion of .* 97"),
            (np.tile(2.0 * np.eye(4), (FRAMES, 1, 1)), "frame 0 is not a rotation and position"),
            (matrices(np.tile([1, 2, 3, 1, 0, 0, 0], (FRAMES, 1))).swapaxes(1, 2), "transposed"),
            (np.zeros((FRAMES, 6)), r"must have shape \(12, 7\)"),
            (np.zeros((FRAMES - 1, 7)), r"must have shape \(12, 7\).*not \(11, 7\)"),
        )
    ),
    *(
        (np.ones(shape), match)
        for shape, match in (
            ((FRAMES, 63), r"reshape\(-1, 21, 3\)"),
            ((FRAMES, 3, 21), r"transpose\(0, 2, 1\)"),
            ((FRAMES, 21, 4), r"\[\.\.\., :3\]"),
            ((FRAMES, 2, 21, 3), r"several hands, save one of them: array\[:, 0\]"),
            ((FRAMES, 20, 3), r"must have shape \(T, 21, 3\)"),
            ((63,), r"not \(63,\)"),
            ((0, 21, 3), "contains no frames"),
            ((FRAMES, 21, 3), "landmarks coincide"),
        )
    ),
    *(
        (hand() * scale, rf"0.05 to 0.14.*looks like {unit} \(multiply by {factor}\)")
        for scale, unit, factor in (
            (1e3, "millimetres", "0.001"),
            (1e2, "centimetres", "0.01"),
            (1 / 0.0254, "inches", "0.0254"),
            (1e6, "micrometres", "1e-06"),
            (1 / 0.3048, "feet", "0.3048"),
            (10.0, "decimetres", "0.1"),
        )
    ),
    (hand() * 1e-3, r"no common unit fits.*multiply by 1e\+03"),
    (np.full((FRAMES, 21, 3), np.nan), "no landmark of any frame is finite"),
    (np.zeros((FRAMES, 21, 3)), "never saw the hand"),
    (partly_seen(), "no frame has both the wrist and the middle finger's MCP"),
    ({"a": hand(), "b": hand()}, "2 recordings rather than one recording: a, b"),
    ({"joints": hand(), "landmarks": hand()}, "both 'landmarks' and 'joints'"),
    ({"x": np.ones(3), "y": np.ones((4, 2))}, r"no array of landmarks.*x \(3,\), y \(4, 2\)"),
    ({}, "no arrays"),
    ({"joints": hand() > 0}, "must hold real numbers, not bool"),
    ({"joints": hand(), "side": np.array("")}, "side must be"),
    ({"joints": hand(), "chirality": np.array("R"), "side": np.array("L")}, "mixes left"),
    (
        {"poses": np.zeros((FRAMES, 156)), "betas": np.zeros(16)},
        r"whole-body parameters \(SMPL-H, 156",
    ),
    (
        {"poses": np.zeros((FRAMES, 165)), "betas": np.zeros(16)},
        r"whole-body parameters \(SMPL-X, 165",
    ),
    (b"\x89HDF\r\n\x1a\n" + bytes(50), "HDF5"),
    (b"\x1f\x8b" + bytes(50), "gzip"),
    (b"time,x,y,z\n0,1,2,3\n", "not a recording: it starts with b'time,x,y'"),
    (b"HIERARCHY\nROOT Hips\n", "the HIERARCHY of a BVH file .* 'the end of the file'"),
    (b"\xef\xbb\xbfHIERARCHY\r\n", "the HIERARCHY of a BVH file"),
    (b"Kaydara FBX Binary  \x00", "an FBX file, a skeleton"),
    (b'<?xml version="1.0"?>\n<mvnx version="4">', "an Xsens MVNX file, a skeleton"),
    (b"NO_OF_FRAMES\t1\n", "a Qualisys motion-capture table: .*skin markers"),
    (b"SQLite format 3\x00", "ROS 2 bags .*ros2 bag play"),
    (b"#ROSBAG V2.0\n", "a ROS 1 bag; .*--source ros2"),
    (b'{"data": [{"states": {"right_ee": {"qpos": [0]}}}]}', "a robot: it contains no human hand"),
    (b'{"frames": []}', "a JSON file from another program; save its landmarks with numpy.savez"),
    (b"tracking_timestamp_us,tx_left_landmark_0_device\n1,0.1\n", "no column right_tracking"),
    (b"\x93NUM", "the file ends after 4 bytes"),
    (b"\x89MCAP0", "the file ends after 6 bytes"),
    (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
    (b"\x93NUMPY\x01\x00\x10\x00{'descr': '<f8'}", "damaged or incomplete"),
    (b"\x93NUMPY\x01\x00v\x00" + HUGE.encode() + bytes(100), "should take 503999999999"),
    (b"\x02P\x01\x00", "a C3D motion-capture file: .*skin markers", "a.c3d"),
    (b"time,x,y,z\n0,1,2,3\n", "a table without the header of landmarks", "a.csv"),
    (b"not SQLite", "a bag of ROS 2; play it", "a.db3"),
]
"""Arrays or bytes of a file, what is said of it, and its name where that matters."""


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case[1])
def test_what_is_no_recording_is_refused(tmp_path, case):
    content, match, name = (*case, "a.bin")[:3]
    path = tmp_path / name
    with path.open("wb") as file:
        if isinstance(content, bytes):
            file.write(content)
        elif isinstance(content, dict):
            np.savez(file, **content)
        else:
            np.save(file, content)
    own = isinstance(content, bytes) or (isinstance(content, dict) and "data" in content)
    refused(path, match, rate=None if own else 30.0)


def test_zero_quaternion_is_unknown(tmp_path):
    data = np.asarray(manus()["data"]).copy()
    data[3, 6, 3:] = 0.0
    recording = read_recording(save(tmp_path / "a.npz", manus(data=data)))
    assert np.isnan(recording.orientations[3, 5]).all()
    assert np.isfinite(np.delete(recording.orientations, 3, axis=0)).all()


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_npy_with_rate(tmp_path, dtype):
    points = (hand() * (-1, 1, 1)).astype(dtype)
    np.save(tmp_path / "a.npy", points)
    recording = read_recording(tmp_path / "a.npy", rate=50.0, side="left")
    assert recording.landmarks.dtype == np.float64
    np.testing.assert_array_equal(recording.landmarks, points)
    np.testing.assert_allclose(recording.stamps, np.arange(FRAMES) / 50.0)
    assert (recording.side, recording.name) == ("left", "a")


def test_files_are_recognised_by_content(tmp_path):
    np.save(tmp_path / "a.npy", hand())
    (tmp_path / "a.npy").rename(tmp_path / "a.npz")
    assert len(read_recording(tmp_path / "a.npz", rate=50.0)) == FRAMES
    save(tmp_path / "b.npz", manus())
    (tmp_path / "b.npz").rename(tmp_path / "b.pkl")  # a misnamed recording is still a recording
    assert len(read_recording(str(tmp_path / "b.pkl"))) == FRAMES


@pytest.mark.parametrize(
    ("key", "more"),
    [
        ("joints", {"side": np.array("Left"), "images": np.ones((4, 5, 6))}),
        ("landmarks", {"chirality": np.array([b"L"] * FRAMES)}),
        ("whatever", {"side": np.array("Left"), "temperature": np.ones(FRAMES)}),
    ],
)
def test_npz_of_landmarks(tmp_path, key, more):
    stamps = np.arange(FRAMES) / 30.0
    path = save(tmp_path / "a.npz", {key: hand() * (-1, 1, 1), "stamps": stamps, **more})
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.landmarks, hand() * (-1, 1, 1))
    np.testing.assert_array_equal(recording.stamps, stamps)
    assert recording.side == "left"
    assert recording.meta == {"format": "array", "side_assumed": False}


SEEN = np.repeat(np.arange(FRAMES) % 4 != 1, 21).reshape(FRAMES, 21)


@pytest.mark.parametrize("nodes", [21, 25])
@pytest.mark.parametrize(
    "flags",
    [SEEN, SEEN.astype(np.uint8), SEEN.astype(float), SEEN[:, 0], SEEN[:, :1].astype(np.int64)],
    ids=["bool", "uint8", "float", "one per frame", "a column"],
)
def test_flags_of_any_type_are_read(tmp_path, flags, nodes):
    if flags.ndim == 2 and flags.shape[1] == 21:
        flags = np.repeat(flags[:, :1], nodes, axis=1)
    arrays = {"landmarks": hand(nodes=nodes), "valid": flags}
    recording = read_recording(save(tmp_path / "a.npz", arrays), rate=30.0)
    np.testing.assert_array_equal(recording.valid, SEEN)
    assert reading_notes(recording, "a.npz") == [
        "a.npz does not state the side; assuming right. Use --side left otherwise"
    ]


@pytest.mark.parametrize("nodes", [21, 26])
def test_the_wrist_may_be_matrices_or_either_order_of_quaternion(tmp_path, nodes):
    poses = np.tile([0.3, -0.1, 1.0, 0.5, -0.5, 0.5, 0.5], (FRAMES, 1))
    poses[4] = np.nan
    four = matrices(poses)
    four[4] = 0.0  # not known
    xyzw = poses[:, [0, 1, 2, 4, 5, 6, 3]]
    for name, stored, more in (
        ("wxyz", poses, {}),
        ("matrices", four, {}),
        ("one hand", four[:, None], {}),
        ("xyzw", xyzw, {"quaternion_order": "xyzw"}),
    ):
        arrays = {"landmarks": hand(nodes=nodes), "T_world_wrist": stored, "world": "room", **more}
        recording = read_recording(save(tmp_path / f"{name}.npz", arrays), rate=30.0)
        np.testing.assert_allclose(recording.T_world_wrist, poses, atol=1e-12, err_msg=name)
        assert recording.world == "room"


def test_flags_and_wrist_of_a_hand_named_by_its_side(tmp_path):
    poses = np.tile([0.3, -0.1, 1.0, 1.0, 0.0, 0.0, 0.0], (FRAMES, 1))
    arrays = {"left": hand() * (-1, 1, 1), "valid_left": SEEN[:, 0], "T_world_wrist_left": poses}
    recording = read_recording(save(tmp_path / "a.npz", arrays), rate=30.0)
    assert (recording.side, recording.meta["side_assumed"]) == ("left", False)
    np.testing.assert_array_equal(recording.valid, SEEN)
    np.testing.assert_array_equal(recording.T_world_wrist, poses)


@pytest.mark.parametrize(("nodes", "picked"), [(25, FROM_MANUS_25), (26, FROM_OPENXR_26)])
def test_more_nodes_are_mapped(tmp_path, nodes, picked):
    points = hand(nodes=nodes)
    np.save(tmp_path / "a.npy", points)
    recording = read_recording(tmp_path / "a.npy", rate=30.0)
    np.testing.assert_array_equal(recording.landmarks, points[:, picked])
    left_out = sorted(set(range(nodes)) - set(picked) - ({0} if nodes == 26 else set()))
    np.testing.assert_array_equal(recording.metacarpals, points[:, left_out])


def test_transforms_and_27_joints_are_read_for_their_positions(tmp_path):
    def saved(array: np.ndarray) -> Path:
        np.save(tmp_path / "a.npy", array)
        return tmp_path / "a.npy"

    points = hand(nodes=27)
    recording = read_recording(saved(points), rate=30.0)
    np.testing.assert_array_equal(recording.landmarks, hand())
    assert recording.metacarpals is not None
    transforms = np.tile(np.eye(4), (FRAMES, 27, 1, 1))
    transforms[..., :3, 3] = points
    found = read_recording(saved(transforms), rate=30.0)
    np.testing.assert_array_equal(found.landmarks, recording.landmarks)
    assert len(read_recording(saved(transforms[0]))) == 1
    for array, match in (
        (transforms.swapaxes(-1, -2), r"last row 0 0 0 1.*array\.swapaxes\(-1, -2\)"),
        (transforms[:, :16], r"from transforms, .*array\[\.\.\., :3, 3\]"),
    ):
        refused(saved(array), match, rate=30.0)


def test_hands_are_found_by_the_names_of_the_tracking_streamer(tmp_path):
    left = np.tile(np.eye(4), (FRAMES, 25, 1, 1))
    left[..., :3, 3] = hand(nodes=25) * (-1, 1, 1)
    right = left.copy()
    right[..., :3, 3] = hand(nodes=25)
    path = save(tmp_path / "a.npz", {"left_fingers": left, "head": np.ones((FRAMES, 4, 4))})
    recording = read_recording(path, rate=30.0)
    assert (recording.side, recording.meta["side_assumed"]) == ("left", False)
    refused(path, "a recording of a left hand, but side 'right'", rate=30.0, side="right")
    both = save(tmp_path / "b.npz", {"left_fingers": left, "right_fingers": right})
    refused(both, "both hands; choose one with --side right or --side left", rate=30.0)
    recording = read_recording(both, rate=30.0, side="right")
    np.testing.assert_array_equal(recording.landmarks, hand())


def test_single_frame_needs_no_rate(tmp_path):
    np.save(tmp_path / "a.npy", hand(1)[0])
    save(tmp_path / "a.npz", {"pose": hand(1)[0], "timestamp_text": np.array("noon")})
    for name in ("a.npy", "a.npz"):
        recording = read_recording(tmp_path / name)
        np.testing.assert_array_equal(recording.landmarks, hand(1))
        assert recording.stamps.tolist() == [0.0]


def test_caller_contradicts_file(tmp_path):
    path = save(tmp_path / "a.npz", manus())
    message = refused(path, "recording of a right hand, but side 'left'", side="left")
    assert "--side right" in message
    refused(path, "contradict --rate 60", rate=60.0)
    assert len(read_recording(path, rate=115.0, side="right")) == FRAMES
    with pytest.raises(ConfigError, match="side must be"):
        read_recording(path, side="both")


@pytest.mark.parametrize("rate", [0.0, -1.0, 0.5, 5000.0, float("nan"), float("inf")])
def test_impossible_rate(tmp_path, rate):
    np.save(tmp_path / "a.npy", hand())
    with pytest.raises(ConfigError, match="rate must be 1 to 2000"):
        read_recording(tmp_path / "a.npy", rate=rate)


def test_nan_and_zero_frames_are_invalid_not_refused(tmp_path):
    points = hand()
    points[2, 8] = np.nan
    points[3, :, 1] = np.inf
    points[5] = 0.0
    np.save(tmp_path / "a.npy", points)
    recording = read_recording(tmp_path / "a.npy", rate=30.0)
    expected = np.ones((FRAMES, 21), bool)
    expected[2, 8] = False
    expected[[3, 5]] = False
    np.testing.assert_array_equal(recording.valid, expected)
    np.testing.assert_array_equal(recording.landmarks, points)
    assert recording.meta["zero_frames"] == 1


def test_units_are_judged_by_the_median_of_valid_frames(tmp_path):
    points = hand()
    points[: FRAMES // 3] *= 1e3  # a glitch in a third of the frames
    points[-2:, 9] = np.nan
    np.save(tmp_path / "a.npy", points)
    assert len(read_recording(tmp_path / "a.npy", rate=30.0)) == FRAMES


@pytest.mark.parametrize("palm", [0.0501, 0.1399])
def test_unit_bounds(palm):
    points = hand(1) * palm / 0.095
    check_units(points, np.ones((1, 21), bool), "here")
    for outside in (0.0499, 0.1401):
        with pytest.raises(RecordingError, match="here: the median distance from the wrist"):
            check_units(hand(1) * outside / 0.095, np.ones((1, 21), bool), "here")


def test_landmarks_far_from_the_origin_are_refused_or_invalid(tmp_path):
    np.save(tmp_path / "a.npy", hand() + 1e8)
    refused(tmp_path / "a.npy", r"the wrist is 1e\+08 m from the origin", rate=30.0)
    points = hand()
    points[3] += 1e8
    poses = np.tile([0.0, 0, 0, 1, 0, 0, 0], (FRAMES, 1))
    poses[5, 0] = 1e15
    arrays = {"landmarks": points, "timestamps": np.arange(FRAMES) / 30, "T_world_wrist": poses}
    recording = read_recording(save(tmp_path / "b.npz", arrays))
    assert np.flatnonzero(~recording.valid.all(axis=1)).tolist() == [3]
    assert np.flatnonzero(np.isnan(recording.T_world_wrist[:, 0])).tolist() == [5]
    assert recording.meta["implausible_frames"] == 1


def stamps_with(**changes: float) -> np.ndarray:
    stamps = np.arange(FRAMES) / 100.0
    for name, value in changes.items():
        stamps[int(name[1:])] = value
    return stamps


@pytest.mark.parametrize(
    ("stamps", "match"),
    [
        (stamps_with(i5=0.001), "go backwards at frame 5: 0.04 s, then 0.001 s"),
        (stamps_with(i5=0.04), "frames 4 and 5 have the same timestamp, 0.04 s"),
        (stamps_with()[::-1], "go backwards at frame 1"),
        (np.random.default_rng(0).permutation(stamps_with()), "shuffled"),
        (stamps_with(i3=np.nan), "stamp of frame 3 is nan"),
        (stamps_with(i0=np.inf), "stamp of frame 0 is inf"),
        (stamps_with() * 1e3, r"milliseconds \(multiply by 0.001\)"),
        (stamps_with() * 1e6, r"microseconds \(multiply by 1e-06\)"),
        ((stamps_with() * 1e9).astype(np.int64), r"nanoseconds \(multiply by 1e-09\)"),
        (stamps_with() / 60.0, r"minutes \(multiply by 60\)"),
        (stamps_with() * 1e15, "no other common unit"),
        (stamps_with(i11=2e9), "2e[+]09 s, but at most 1e[+]09 s"),
        (np.zeros(FRAMES), r"all 12 timestamps are 0\.0, so they are not times; .*--rate"),
        (np.repeat(np.arange(6) / 30.0, 2), "the hand differs in 6 of these pairs.*--rate"),
        (stamps_with()[:-1], "one timestamp for each of the 12 frames"),
    ],
)
def test_bad_stamps(tmp_path, stamps, match):
    refused(save(tmp_path / "a.npz", {"joints": hand(), "timestamps": stamps}), match)


def test_fingers_that_never_move_are_noted(tmp_path):
    points, stamps = hand(90), np.arange(90) / 30.0
    still = points[:1] + 0.1 * np.sin(stamps)[:, None, None]
    noisy = still + np.random.default_rng(0).normal(0.0, 2e-4, still.shape)

    def notes(landmarks):
        arrays = {"landmarks": landmarks, "timestamps": stamps[: len(landmarks)], "side": "right"}
        recording = read_recording(save(tmp_path / "a.npz", arrays))
        return reading_notes(recording, "a.npz")

    assert notes(points) == []
    assert notes(still[:30]) == []  # a pose may be held for a second
    for one in (still, noisy):
        (note,) = notes(one)
        assert re.search(r"a\.npz: the fingers never move \([01]\.\d mm in 3 s\).*glove", note)
    half = np.where(np.arange(90)[:, None, None] < 60, still, points)
    assert notes(half) == []


def test_a_rate_replaces_stamps_that_are_all_equal(tmp_path):
    path = save(tmp_path / "a.npz", {"joints": hand(), "timestamps": np.full(FRAMES, 7.0)})
    np.testing.assert_allclose(read_recording(path, rate=30.0).stamps, np.arange(FRAMES) / 30.0)


def test_missing_folder_and_empty_files(tmp_path):
    refused(tmp_path / "nothing.npz", "no such file")
    refused(tmp_path, "this is a folder")
    (tmp_path / "a.npz").touch()
    refused(tmp_path / "a.npz", r"empty \(0 bytes\)")


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_pickles_are_refused_and_not_run(tmp_path, protocol):
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps(Bomb(), protocol))
    assert "numpy.savez" in refused(path, "this is a pickle")
    if protocol >= 2:  # by content too
        other = tmp_path / "a.npz"
        other.write_bytes(path.read_bytes())
        refused(other, "this is a pickle")


class Bomb:
    """Says so if it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return pytest.fail, ("unpickled",)


def test_object_arrays_are_pickles(tmp_path):
    boxed = np.empty(1, object)
    boxed[0] = Bomb()
    np.save(tmp_path / "a.npy", boxed, allow_pickle=True)
    assert "numpy.savez" in refused(tmp_path / "a.npy", "pickled objects")
    refused(save(tmp_path / "b.npz", {"joints": boxed}), "array 'joints' holds pickled objects")
    refused(save(tmp_path / "c.npz", manus(timestamps=boxed)), "array 'timestamps' holds pickled")
    # One that is not needed does no harm.
    path = save(tmp_path / "d.npz", {"joints": hand(), "notes": boxed})
    assert len(read_recording(path, rate=30.0)) == FRAMES


def test_torch_files_are_pickles(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps([1]))
    refused(tmp_path / "a.pt", r"contains the pickle 'archive/data.pkl'")


def robot_dataset(folder: Path, version: str = "v2.1") -> Path:
    """A LeRobot data set of a humanoid, with one Parquet file."""
    names = [f"left_arm_{k}" for k in range(7)]
    feature = {"dtype": "float32", "shape": [7], "names": names}
    info = {
        "codebase_version": version,
        "robot_type": "humanoid",
        "data_path": "data/{x}",
        "features": {"observation.state": feature, "action": feature},
    }
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    (folder / "meta" / "episodes.jsonl").write_text('{"episode_index": 0, "tasks": []}\n')
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "data" / "chunk-000" / "episode_000000.parquet").write_bytes(b"PAR1" + bytes(60))
    return folder


@pytest.mark.parametrize(
    "command",
    [
        "retarget SET --output out",
        "retarget SET --output out.npz",
        "convert SET --to npz --output out",
        "dataset SET --hand leap_hand --output out",
        "calibrate SET --output operator.json",
        "teleop --source replay:SET",
        "retarget SET/data/chunk-000/episode_000000.parquet --output out.npz",
        "dataset SET/data/chunk-000/episode_000000.parquet --output out",
    ],
)
def test_every_command_recognises_data_of_a_robot(tmp_path, monkeypatch, capsys, command):
    version = "v3.0" if command.startswith("convert") else "v2.1"
    robot_dataset(tmp_path / "set", version)
    monkeypatch.chdir(tmp_path)
    assert main(command.replace("SET", "set").split()) == 2
    said = capsys.readouterr().err
    assert f"LeRobot data set (version {version}) from the robot 'humanoid', with " in said, said
    assert "(left_arm_0, left_arm_1, ...): it contains no human hand" in said


@pytest.mark.parametrize("form", ["npy", "npz", "npz-compressed", "manus"])
def test_cut_off_files(tmp_path, form):
    buffer = io.BytesIO()
    {
        "npy": lambda: np.save(buffer, hand()),
        "npz": lambda: np.savez(buffer, joints=hand()),
        "npz-compressed": lambda: np.savez_compressed(buffer, joints=hand()),
        "manus": lambda: np.savez(buffer, **manus()),
    }[form]()
    whole = buffer.getvalue()
    path = tmp_path / "a"
    rng = np.random.default_rng(3)
    for length in {*rng.integers(1, len(whole), 20).tolist(), len(whole) - 1, 9}:
        path.write_bytes(whole[:length])
        refused(path, "damaged or incomplete|the file ends after", rate=30.0)


# --- frames A:B ------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [":500", "2600:3100", "-500:", ":", " 3 : -2 ", "-9999:7", "+1:"])
def test_frame_slice_equals_a_slice_of_python(text):
    frames = list(range(4000))
    expected = eval(f"frames[{text}]")
    assert frames[frame_slice(text, 4000)] == expected
    assert expected


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "range A:B"),
        ("5", "to select only frame 5, write '5:6'"),
        ("1:9:2", "a step is not supported"),
        ("a:b", "not 'a:b'"),
        ("1.5:3", "whole numbers"),
        ("1e3:", "whole numbers"),
        ("٣:٥", "whole numbers"),
        ("10:", "selects nothing: the recording has 10 frames, 0 to 9"),
        ("5:5", "selects nothing"),
        ("-2:3", "selects nothing"),
    ],
)
def test_invalid_frame_slices(text, match):
    with pytest.raises(ConfigError, match=match):
        frame_slice(text, 10)
    with pytest.raises(ConfigError):
        frame_slice(":", 0)
    with pytest.raises(ConfigError, match="B must be greater than A"):
        frame_slice("5:5", None)
