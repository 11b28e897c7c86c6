"""BVH files of body captures with fingers: names of several makers, units, and damaged files."""

from pathlib import Path

import capture_files as capture
import fuzzing
import numpy as np
import pytest

from smooth_operator import read_recording
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import ReadingOptions
from smooth_operator.formats.registry import BVH, recognise
from smooth_operator.poses import rotate, wrist_from_landmarks
from smooth_operator.types import Side

FRAMES = 30
TREE = capture.in_file_order(capture.arms())
TURNS = capture.angles(TREE, FRAMES)
MOVED = np.array([0.0, 84.1, 0.0]) + np.outer(np.linspace(0, 20, FRAMES), [1.0, 0.2, -0.5])
OURS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Our axes: forward is z of the file, left x, up y."""


def expected(side: Side, order: str = "YXZ") -> np.ndarray:
    """(T, 21, 3) landmarks [m] in our axes."""
    where = capture.places(TREE, TURNS, order, MOVED)
    return capture.landmarks(where, side) @ OURS.T / 100.0


def text(order: str = "YXZ", displaced: bool = False, scale: float = 1.0, **options) -> str:
    frames = capture.numbers(TREE, TURNS, order, MOVED, displaced)
    wide = 6 if displaced else frames.shape[1]
    for start in range(0, frames.shape[1], wide):
        frames[:, start : start + 3] *= scale
    return capture.bvh(TREE, frames, order, displaced, scale=scale, **options)


def hc_mocap(name: str) -> str:
    letter = "R" if "Right" in name else "L"
    bare = name.replace("RightHand", "").replace("LeftHand", "")
    return f"hc_{bare or 'Hand'}_{letter}" if "Hand" in name and "InHand" not in name else name


FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")


def renamed(name: str, places: tuple[str, ...], thumb: tuple[str, ...], others: tuple[str, ...]):
    """The name of a joint in which finger and bone have other words."""
    for place, finger in zip(places, FINGERS, strict=True):
        name = name.replace(f"InHand{finger}", f"{place}{others[0]}")
        bones = thumb if finger == "Thumb" else others[1:]
        for joint, bone in enumerate(bones, 1):
            name = name.replace(f"Hand{finger}{joint}", f"{place}{bone}")
    return name


def xsens(name: str) -> str:
    places = ("First", "Second", "Third", "Fourth", "Fifth")
    return renamed(name, places, ("MC", "PP", "DP"), ("MC", "PP", "MP", "DP"))


def rokoko(name: str) -> str:
    places = tuple(f"Finger{number}" for number in range(1, 6))
    thumb = ("Metacarpal", "Proximal", "Distal")
    return renamed(name, places, thumb, ("Metacarpal", "Proximal", "Medial", "Distal"))


def saved(folder: Path, content: str, name: str = "take.bvh") -> Path:
    path = folder / name
    path.write_text(content)
    return path


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_forearm_is_the_bone_above_the_wrist(tmp_path, side):
    recording = read_recording(saved(tmp_path, text()), side=side)
    where = capture.places(TREE, TURNS, "YXZ", MOVED)
    bone = (where[f"{side.title()}Hand"] - where[f"{side.title()}ForeArm"]) @ OURS.T
    seen = rotate(recording.T_world_wrist[:, 3:], recording.forearm)
    np.testing.assert_allclose(seen, bone / 25.0, atol=1e-4)


def test_a_joint_of_another_name_is_no_forearm(tmp_path):
    path = saved(tmp_path, text(rename=lambda name: name.replace("RightForeArm", "Bone7")))
    assert read_recording(path, side="right").forearm is None
    assert read_recording(path, side="left").forearm is not None


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(
    ("order", "displaced"), [("YXZ", True), ("YXZ", False), ("ZXY", False), ("XYZ", True)]
)
def test_landmarks_are_the_joints_by_forward_kinematics(tmp_path, side, order, displaced):
    recording = read_recording(saved(tmp_path, text(order, displaced)), side=side)
    np.testing.assert_allclose(recording.landmarks, expected(side, order), atol=2e-6)
    np.testing.assert_allclose(recording.stamps, 0.01 * np.arange(FRAMES), atol=1e-12)
    assert recording.valid.all()
    assert recording.metacarpals is not None
    assert recording.world == "bvh"
    wrist = wrist_from_landmarks(expected(side, order), side)
    np.testing.assert_allclose(recording.T_world_wrist, wrist, atol=1e-4)
    assert recording.meta["unit"] == "cm"


@pytest.mark.parametrize(
    "rename", [str, "take:{}".format, hc_mocap, xsens, rokoko], ids=lambda f: f.__name__
)
def test_names_of_the_makers(tmp_path, rename):
    path = saved(tmp_path, text(rename=rename))
    recording = read_recording(path, side="right")
    np.testing.assert_allclose(recording.landmarks, expected("right"), atol=2e-6)
    assert (recording.metacarpals is None) == (rename is hc_mocap)


@pytest.mark.parametrize(("scale", "unit"), [(0.01, "m"), (10.0, "mm"), (1 / 2.54, "inch")])
def test_the_unit_is_found_by_the_length_of_the_hand(tmp_path, scale, unit):
    recording = read_recording(saved(tmp_path, text(scale=scale)), side="left")
    np.testing.assert_allclose(recording.landmarks, expected("left"), atol=2e-4)
    assert recording.meta["unit"] == unit


def test_a_clip_has_both_hands(tmp_path):
    path = saved(tmp_path, text())
    assert recognise(path, None) == ("bvh", BVH)
    (ref,) = BVH.clips(path)
    clip = BVH.read(ref, ReadingOptions())
    assert set(clip.hands) == {"right", "left"}
    assert clip.world == "bvh"
    with pytest.raises(RecordingError, match="both hands; choose one with --side"):
        read_recording(path)


def test_a_capture_of_one_hand_needs_no_side(tmp_path):
    tree = capture.in_file_order(capture.arms(["left"]))
    frames = capture.numbers(tree, capture.angles(tree, 5), "YXZ", MOVED[:5], False)
    path = saved(tmp_path, capture.bvh(tree, frames))
    assert read_recording(path).side == "left"
    with pytest.raises(RecordingError, match="no right hand; leave out --side right"):
        read_recording(path, side="right")


def test_a_person_who_looks_against_z_has_its_left_hand_at_our_left(tmp_path):
    """hc_mocap's skeletons have x to the right of the person, who looks against z."""
    back = np.diag([-1.0, 1.0, -1.0])
    tree = [(name, parent, tuple(back @ offset)) for name, parent, offset in TREE]
    turns = TURNS * [1.0, -1.0, -1.0]  # about y, x, z, in the axes turned by half a turn about y
    frames = capture.numbers(tree, turns, "YXZ", MOVED @ back, False)
    recording = read_recording(saved(tmp_path, capture.bvh(tree, frames)), side="right")
    np.testing.assert_allclose(recording.landmarks, expected("right"), atol=2e-6)


GOOD = text()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (GOOD.replace("Pinky", "Little"), "no hand with fingers.*enable the fingers"),
        (GOOD.replace(f"Frames: {FRAMES}", "Frames: 31"), "states 31 frames.*it has 30"),
        (GOOD[: len(GOOD) - 40], "one of .* numbers; the file is incomplete or damaged"),
        (GOOD.replace("Frames: 30", "Frames: x"), "the line 'Frames:' must hold numbers"),
        (GOOD.replace("CHANNELS 3 Yrotation", "CHANNELS 4 Yrotation", 1), "out of place"),
        (GOOD.replace("Yrotation", "Yscale", 1), "a position or a rotation, not 'Yscale'"),
        (GOOD.replace("MOTION", "}\nMOTION"), "'}' is out of place"),
        (GOOD[:500], "'the end of the file' is out of place"),
        (GOOD.replace("2.100000", "0.000000"), "End Site of the right index is at its last joint"),
        (text(scale=1.7), "is 2.* long .* the file.s unit is none of m, cm, mm, inch"),
        ("HIERARCHY\n" + "ROOT a\n{\n" * 1001, "out of place"),
        (GOOD.replace("Frames: 30", "Frames: 1e12"), "GB|MB"),
    ],
)
def test_a_damaged_file_says_what_is_wrong(tmp_path, content, words):
    with pytest.raises(RecordingError, match=words):
        read_recording(saved(tmp_path, content), side="right")


def test_a_number_that_is_not_finite_is_a_lost_hand(tmp_path):
    frames = capture.numbers(TREE, TURNS, "YXZ", MOVED, False)
    hand = TREE.index(next(one for one in TREE if one[0] == "RightHandIndex1"))
    before = sum(3 for name, _, _ in TREE[:hand] if not name.endswith("End")) + 3
    frames[4, before] = np.nan
    recording = read_recording(saved(tmp_path, capture.bvh(TREE, frames)), side="right")
    assert recording.valid[3].all()
    assert recording.valid[4].tolist() == [k not in (6, 7, 8) for k in range(21)]


def test_without_a_frame_time_the_rate_must_be_given(tmp_path):
    path = saved(tmp_path, text(period=0))
    with pytest.raises(RecordingError, match="--rate"):
        read_recording(path, side="right")
    assert read_recording(path, side="right", rate=50.0).rate_hz == pytest.approx(50.0)


def test_damaged_files_raise_only_errors_of_this_program(tmp_path):
    frames = capture.numbers(TREE, TURNS, "YXZ", MOVED, False)[:3]
    mutants = fuzzing.damaged_bytes(capture.bvh(TREE, frames).encode())
    refused, _ = fuzzing.outcomes(mutants, 60, fuzzing.recording_at(tmp_path / "take.bvh"))
    assert len(refused) > 12
