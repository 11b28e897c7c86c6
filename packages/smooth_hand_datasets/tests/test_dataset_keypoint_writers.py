"""Clips for SPIDER and FlashDexRetarget, read as these programs read them.

The readers here are written from the programs' published loaders: which arrays they take, in which
shapes and order, and from which paths.
"""

import json
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from robot_clips import robot_clip, rotation

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.registry import WRITERS, WritingOptions
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import CAMERA, ObjectTrack
from smooth_operator.landmarks import FINGERS

TIPS = [4, 8, 12, 16, 20]
SIZE = 0.03  # half a cube's edge [m]


@pytest.fixture
def cube(tmp_path) -> Path:
    """A cube of 2 x SIZE, in millimetres."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    lines = [f"v {x * SIZE * 1e3} {y * SIZE * 1e3} {z * SIZE * 1e3}" for x, y, z in corners]
    path = tmp_path / "cube.obj"
    path.write_text("\n".join([*lines, *(f"f {face}" for face in faces)]) + "\n")
    return path


def with_mesh(clip: RobotClip, mesh: Path) -> RobotClip:
    objects = tuple(replace(item, mesh=mesh, scale=0.001) for item in clip.clip.objects)
    return replace(clip, clip=replace(clip.clip, objects=objects))


def unpack(folder: Path) -> None:
    for shard in sorted((folder / "shards").iterdir()):
        with tarfile.open(shard) as tar:
            tar.extractall(folder, filter="data")


def write(form: str, output: Path, clips: list[RobotClip], **options: object) -> list[str]:
    with WRITERS.load(form).open(output, WritingOptions(**options)) as writer:
        for clip in clips:
            writer.write(clip)
    return list(writer.notes)


def read_spider(root: Path, embodiment: str) -> dict[str, dict[str, np.ndarray]]:
    """Task -> what SPIDER's ``ik.py`` and ``detect_contact.py`` load, with its checks of shapes."""
    found = {}
    for folder in sorted((root / "processed" / "smooth_operator" / "mano" / embodiment).iterdir()):
        info = json.loads((folder / "task_info.json").read_text())
        assert info["task"] == folder.name
        assert info["embodiment_type"] == embodiment
        data = dict(np.load(folder / "0" / "trajectory_keypoints.npz"))
        parts = [
            data["qpos_wrist_right"][:, None],
            data["qpos_finger_right"],
            data["qpos_wrist_left"][:, None],
            data["qpos_finger_left"],
            data["qpos_obj_right"][:, None],
            data["qpos_obj_left"][:, None],
        ]
        together = np.concatenate(parts, axis=1)
        assert together.shape[1:] == (14, 7)
        assert np.isfinite(together).all()
        for side in ("right", "left"):
            mesh = info[f"{side}_object_mesh_dir"]
            assert mesh is None or (root / mesh / "visual.obj").is_file()
        found[info["smooth_operator"]["name"]] = {**data, "ref_dt": np.array(info["ref_dt"])}
    return found


def spider_axes(points: np.ndarray, side: str) -> np.ndarray:
    """(T, 3, 3) SPIDER's wrist axes from 21 landmarks, as its data processors define them."""
    z = points[:, 9] - points[:, 0]
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    across = points[:, 5] - points[:, 13] if side == "right" else points[:, 13] - points[:, 5]
    x = np.cross(across, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=2)


def vertices(path: Path) -> np.ndarray:
    rows = [line.split()[1:] for line in path.read_text().splitlines() if line.startswith("v ")]
    return np.array(rows, float)


def test_spider_reads_both_hands_and_their_objects(tmp_path, cube):
    clip = with_mesh(robot_clip(0, frames=61, objects=2), cube)
    out = tmp_path / "out"
    write("spider", out, [clip, robot_clip(1, frames=30, sides=("left",))])
    unpack(out)
    data = read_spider(out, "bimanual")["part1/pick/0"]
    assert data["ref_dt"] == 0.02
    exact = robot_clip(0, frames=101, rate=50.0, objects=2)
    lifts = []
    for side in ("right", "left"):
        hand = exact.clip.hands[side]
        wrist, finger = data[f"qpos_wrist_{side}"], data[f"qpos_finger_{side}"]
        assert wrist.shape == (101, 7)
        assert finger.shape == (101, 5, 7)
        off = wrist[:, :3] - hand.T_world_wrist[:, :3]
        np.testing.assert_allclose(off[:, :2], 0.0, atol=1e-4)
        lifts.append(off[:, 2])
        axes = spider_axes(hand.landmarks.copy(), side)
        np.testing.assert_allclose(rotation(wrist[:, 3:]), axes, atol=0.02)
        tips = hand.landmarks[:, TIPS]
        np.testing.assert_allclose(finger[..., :2], tips[..., :2], atol=2e-4)
        np.testing.assert_array_equal(finger[..., 3:], np.tile([1, 0, 0, 0], (101, 5, 1)))
    assert np.ptp(np.concatenate(lifts)) < 2e-4  # all moved by one height
    lowest = np.inf
    for side in ("right", "left"):
        pose = data[f"qpos_obj_{side}"]
        info = next((out / "processed" / "smooth_operator" / "assets" / "objects").iterdir())
        corners = vertices(info / "visual.obj")
        assert np.abs(corners).max() == pytest.approx(SIZE)  # metres now
        world = np.einsum("tij,vj->tvi", rotation(pose[:, 3:]), corners) + pose[:, None, :3]
        lowest = min(lowest, float(world[..., 2].min()))
    assert lowest == pytest.approx(0.0, abs=1e-5)  # on the floor
    one = read_spider(out, "left")["part1/pick/1"]
    assert (one["qpos_wrist_right"] == [0, 0, 0, 1, 0, 0, 0]).all()
    assert (one["qpos_finger_right"] == [0, 0, 0, 1, 0, 0, 0]).all()
    assert np.ptp(one["qpos_wrist_left"][:, 0]) > 0.01


def test_one_object_of_both_hands_is_the_right_ones(tmp_path, cube):
    out = tmp_path / "out"
    write("spider", out, [with_mesh(robot_clip(0), cube)], loose=True)
    assert not (out / "shards").exists()
    data = read_spider(out, "bimanual")["part1/pick/0"]
    assert (data["qpos_obj_left"] == [0, 0, 0, 1, 0, 0, 0]).all()
    assert np.ptp(data["qpos_obj_right"][:, 0]) > 0.01
    (info,) = out.rglob("task_info.json")
    assert json.loads(info.read_text())["left_object_mesh_dir"] is None


def test_landmarks_of_a_trackers_own_frame_are_carried_to_the_wrist(tmp_path):
    clip = robot_clip(0, objects=0, rate=50.0)
    moved = {}
    for side, hand in clip.clip.hands.items():
        turn = rotation(np.array([[0.5, 0.5, -0.5, 0.5]]))[0]
        moved[side] = replace(hand, landmarks=hand.landmarks @ turn.T + [3.0, 0.0, -1.0])
    out = tmp_path / "out"
    write("spider", out, [replace(clip, clip=replace(clip.clip, hands=moved))], loose=True)
    data = read_spider(out, "bimanual")["part1/pick/0"]
    for side, hand in clip.clip.hands.items():
        off = data[f"qpos_finger_{side}"][..., :3] - hand.landmarks[:, TIPS]
        # The wrist's axes are those of the palm within some degrees.
        assert np.abs(off).max() < 0.01


def read_flashdex(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """Clip -> its arrays, as FlashDexRetarget's ``load_clip`` and ``joints`` take them."""
    parts = ("proximal", "intermediate", "distal", "tip")
    names = sorted(f"{finger}_{part}" for finger in FINGERS for part in parts)
    found, rates, hands = {}, set(), set()
    for path in sorted((folder / "human_demo").glob("*.npz")):
        with np.load(path) as data:
            clip = {key: data[key] for key in data.files}
        rates.add(float(clip["fps"]))
        sides = tuple(s for s in ("right", "left") if f"mano_{s}_wrist_pos" in clip)
        hands.add(sides)
        count = len(clip[f"mano_{sides[0]}_wrist_pos"])
        for side in sides:
            assert clip[f"mano_{side}_wrist_pos"].shape == (count, 3)
            assert clip[f"mano_{side}_wrist_rot"].shape == (count, 3, 3)
            listed = [str(name) for name in clip[f"mano_{side}_joint_names"]]
            joints = clip[f"mano_{side}_joints"][:, [listed.index(name) for name in names]]
            assert joints.shape == (count, 20, 3)
            clip[f"tips_{side}"] = joints[:, [names.index(f"{f}_tip") for f in FINGERS]]
            assert clip[f"obj_{side}_pose"].shape == (count, 4, 4)
            np.testing.assert_array_equal(clip[f"obj_{side}_pose"][:, 3], [[0, 0, 0, 1]] * count)
            mesh = folder / "objects" / str(clip[f"obj_{side}_id"]) / "visual.obj"
            assert len(vertices(mesh))
        found[path.stem] = clip
    assert len(rates) == 1  # the program refuses clips of several rates
    assert len(hands) == 1  # and of several hands
    return found


def test_flashdex_reads_hands_and_objects(tmp_path, cube):
    clips = [with_mesh(robot_clip(i, frames=40, objects=1 + i), cube) for i in range(2)]
    clips.append(with_mesh(robot_clip(2, frames=25, rate=15.0), cube))
    out = tmp_path / "out"
    write("flashdex", out, clips)
    unpack(out)
    found = read_flashdex(out)
    assert len(found) == 3
    first = next(clip for name, clip in found.items() if name.startswith("part1_pick_0"))
    exact = robot_clip(0, frames=79, rate=60.0)
    for side in ("right", "left"):
        hand = exact.clip.hands[side]
        axes = rotation(hand.T_world_wrist[:, 3:])
        np.testing.assert_allclose(first[f"mano_{side}_wrist_rot"], axes, atol=1e-4)
        # x to the fingers, z out of the back: the middle base is ahead, fingers bend against z
        middle = hand.landmarks[:, 9] - hand.landmarks[:, 0]
        assert np.einsum("ti,ti->t", first[f"mano_{side}_wrist_rot"][..., 0], middle).min() > 0.09
        tips = hand.landmarks[:, TIPS]
        np.testing.assert_allclose(first[f"tips_{side}"][..., :2], tips[..., :2], atol=2e-4)
        assert first[f"obj_{side}_id"] == first["obj_right_id"]  # one object for both hands


def test_short_gaps_are_filled_and_long_ones_refused(tmp_path, cube):
    whole = with_mesh(robot_clip(0, frames=40, rate=50.0), cube)

    def lost(frames: slice) -> RobotClip:
        hand = whole.clip.hands["right"]
        wrist = hand.T_world_wrist.copy()
        wrist[frames] = np.nan
        hands = {**whole.clip.hands, "right": replace(hand, T_world_wrist=wrist)}
        return replace(whole, clip=replace(whole.clip, hands=hands))

    notes = write("spider", tmp_path / "out", [lost(slice(5, 9))], loose=True)
    assert notes == ["1 clip: short gaps of the tracker were filled by interpolation"]
    data = read_spider(tmp_path / "out", "bimanual")["part1/pick/0"]
    truth = whole.clip.hands["right"].T_world_wrist
    np.testing.assert_allclose(data["qpos_wrist_right"][:, :2], truth[:, :2], atol=2e-3)
    with pytest.raises(RecordingError, match="right hand is unknown in 25% of the frames"):
        write("spider", tmp_path / "none", [lost(slice(5, 15))])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"world": CAMERA}, "unknown in a world with gravity"),
        ({"wrists": False}, "unknown in a world with gravity"),
        ({"objects": 0}, "needs one for each hand"),
        ({}, "the mesh of its object 'cup 0' is unknown"),
        ({"mesh": Path("none.obj")}, "can't be read as the mesh"),
    ],
)
def test_flashdex_refuses_incomplete_clips(change, said, tmp_path):
    with pytest.raises(RecordingError, match=said):
        write("flashdex", tmp_path / "out", [robot_clip(0, **change)])


def test_flashdex_keeps_to_the_hands_of_its_first_clip(tmp_path, cube):
    both = with_mesh(robot_clip(0), cube)
    one = with_mesh(robot_clip(1, sides=("left",)), cube)
    with pytest.raises(RecordingError, match="it has no right hand"):
        write("flashdex", tmp_path / "out", [both, one])
    write("flashdex", tmp_path / "left", [one, both], joints={"left": ()})
    unpack(tmp_path / "left")
    for clip in read_flashdex(tmp_path / "left").values():
        assert "mano_right_joints" not in clip


def test_a_flat_object_without_a_hull_is_refused(tmp_path):
    path = tmp_path / "flat.obj"
    path.write_text("v 0 0 0\nv 1 0 0\n")
    clip = robot_clip(0, objects=0)
    track = ObjectTrack("line", robot_clip(0).clip.objects[0].T_world_object, path)
    clip = replace(clip, clip=replace(clip.clip, objects=(track,)))
    with pytest.raises(RecordingError, match="can't be read as the mesh"):
        write("spider", tmp_path / "out", [clip])
