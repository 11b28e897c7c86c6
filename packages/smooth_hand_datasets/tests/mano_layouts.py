"""Data sets with hands in MANO's parameters, made from the published layouts.

Each writer makes a small data set in a folder, from one motion of two hands, and says what a reader
should find: landmarks by ``reference_landmarks``, taken to our world by code of this file. Nothing
of the readers is used. Where a data set has pickles, they are written instruction by instruction.
"""

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mano_files
import numpy as np
from mano_files import Tensor, model_arrays, npy_of_object, pickled, reference_landmarks
from scipy.spatial.transform import Rotation

FRAMES = 8
JUDGED = (0, 5)
"""Frames whose landmarks are compared."""
SIDES = ("right", "left")
ARRAYS = {side: model_arrays(side) for side in SIDES}
_RNG = np.random.default_rng(19)
BETAS = {side: _RNG.normal(size=10) * 0.5 for side in SIDES}
MOTION = {side: mano_files.poses_of(side, FRAMES, seed=7) for side in SIDES}
PLACE = {
    side: np.cumsum(_RNG.normal(size=(FRAMES, 3)) * 0.01, axis=0) + _RNG.normal(size=3) * 0.3
    for side in SIDES
}
OBJECT = (
    Rotation.from_rotvec(np.cumsum(_RNG.normal(size=(FRAMES, 3)) * 0.1, axis=0)),
    np.cumsum(_RNG.normal(size=(FRAMES, 3)) * 0.01, axis=0),
)


@dataclass
class Made:
    """What was written.

    Attributes:
        path: what the reader is given.
        files: of it, those that are damaged by the test of damaged files.
        landmarks: side -> frame -> (21, 3) in our world.
        objects: name -> (T, 4, 4) in our world.
        camera: (T, 4, 4) or (4, 4) in our world, if known.
    """

    path: Path
    files: list[Path]
    landmarks: dict[str, dict[int, np.ndarray]] = field(default_factory=dict)
    objects: dict[str, np.ndarray] = field(default_factory=dict)
    camera: np.ndarray | None = None
    stamps: np.ndarray | None = None
    task: str | None = None
    meshes: dict[str, Path] = field(default_factory=dict)
    video: Path | None = None
    shape: dict[str, np.ndarray] = field(default_factory=lambda: dict(BETAS))


def expected(
    turn: np.ndarray,
    shift: Any = (0.0, 0.0, 0.0),
    *,
    tips: str = "smplx",
    about_wrist: bool = False,
    sides: tuple[str, ...] = SIDES,
    shape_of_right: bool = False,
) -> dict[str, dict[int, np.ndarray]]:
    """Landmarks in our world, which is reached by a rotation and a shift."""
    found: dict[str, dict[int, np.ndarray]] = {}
    for side in sides:
        found[side] = {}
        whose = "right" if shape_of_right else side
        for frame in JUDGED:
            points = _reference(side, frame, tips, about_wrist, whose)
            found[side][frame] = points @ np.asarray(turn).T + shift
    return found


def landmarks_of(
    arrays: dict[str, Any], pose: dict[str, Any], betas: np.ndarray, turn: Any = None
) -> dict[str, dict[int, np.ndarray]]:
    """Landmarks of both hands with other models, poses and shapes than those of ``expected``."""

    def points(side: str, frame: int) -> np.ndarray:
        root, at = MOTION[side][1][frame], PLACE[side][frame]
        found = reference_landmarks(arrays[side], side, root, pose[side][frame], betas, at)
        return found if turn is None else found @ turn.T

    return {side: {frame: points(side, frame) for frame in JUDGED} for side in SIDES}


@functools.cache
def _reference(side: str, frame: int, tips: str, about_wrist: bool, whose: str) -> np.ndarray:
    pose, root = MOTION[side]
    return reference_landmarks(
        ARRAYS[side],
        side,
        root[frame],
        pose[frame],
        BETAS[whose],
        PLACE[side][frame],
        tips,
        about_wrist,
    )


def coefficients(side: str, count: int, *, mean: bool) -> np.ndarray:
    """(T, count) of the components; exact for 45, else the motion is another."""
    pose = MOTION[side][0] - (ARRAYS[side]["hands_mean"] if mean else 0.0)
    return (pose @ ARRAYS[side]["hands_components"].T)[:, :count]


def homogeneous(turn: Any, at: Any) -> np.ndarray:
    turn, at = np.asarray(turn), np.asarray(at)
    found = np.zeros((*turn.shape[:-2], 4, 4))
    found[..., :3, :3], found[..., :3, 3], found[..., 3, 3] = turn, at, 1.0
    return found


def mesh_file(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("v 0 0 0\n")
    return path


def _object() -> np.ndarray:
    return homogeneous(OBJECT[0].as_matrix(), OBJECT[1])


def dexycb(folder: Path, side: str = "right") -> Made:
    sequence = folder / "20200709-subject-01" / "20200709_141754"
    sequence.mkdir(parents=True)
    hands = np.zeros((FRAMES, 1, 51), np.float64)
    hands[:, 0, :3], hands[:, 0, 48:] = MOTION[side][1], PLACE[side]
    hands[:, 0, 3:48] = coefficients(side, 45, mean=True)
    hands[2] = 0.0  # no hand in that frame
    things = np.tile([0.0, 0, 0, 1, 0, 0, 0], (FRAMES, 2, 1))
    things[:, 1, :4], things[:, 1, 4:] = OBJECT[0].as_quat(), OBJECT[1]
    np.savez(sequence / "pose.npz", pose_m=hands, pose_y=things)
    (sequence / "meta.yml").write_text(
        "serials:\n- '836212060125'\n- '840412060917'\n"
        f"num_frames: {FRAMES}\nextrinsics: '20200702_151821'\nmano_calib:\n- subject-01_{side}\n"
        f"mano_sides:\n- {side}\nycb_grasp_ind: 1\nycb_ids:\n- 3\n- 14\n"
    )
    calibration = folder / "calibration"
    shape = calibration / f"mano_subject-01_{side}"
    shape.mkdir(parents=True)
    lines = "\n".join(f"- {float(beta)!r}" for beta in BETAS[side])
    (shape / "mano.yml").write_text(f"betas:\n{lines}\n")
    cameras = calibration / "extrinsics_20200702_151821"
    cameras.mkdir()
    tag = homogeneous(Rotation.from_rotvec([0.3, -0.2, 2.0]).as_matrix(), [0.1, -0.3, 0.9])
    master = homogeneous(np.eye(3), np.zeros(3))

    def rows(matrix: np.ndarray) -> str:
        return "".join(f"  - {float(value)!r}\n" for value in matrix[:3].ravel())

    (cameras / "extrinsics.yml").write_text(
        f"extrinsics:\n  '840412060917':\n{rows(master)}  apriltag:\n{rows(tag)}"
        "master: '840412060917'\n"
    )
    mesh = mesh_file(folder / "models" / "025_mug" / "textured_simple.obj")
    back = np.linalg.inv(tag)
    return Made(
        sequence,
        [
            sequence / "pose.npz",
            sequence / "meta.yml",
            shape / "mano.yml",
            cameras / "extrinsics.yml",
        ],
        expected(back[:3, :3], back[:3, 3], tips="manopth", sides=(side,)),
        {"025_mug": back @ _object()},
        back @ master,
        np.arange(FRAMES) / 30.0,
        "pick up the mug",
        {"025_mug": mesh},
        shape={side: BETAS[side]},
    )


def ho3d(folder: Path, hands: int = 1) -> Made:
    sequence = folder / "train" / "MC1"
    (sequence / "meta").mkdir(parents=True)
    sides = ("right",) if hands == 1 else SIDES
    files = []
    betas = dict.fromkeys(SIDES, BETAS["right"])
    for frame in range(FRAMES):
        held: dict[Any, Any] = {b"camMat": np.eye(3), b"objName": b"025_mug", b"objLabel": 14}
        held[b"handBeta"] = betas["right"]
        for side in sides:
            before = b"hand" if hands == 1 else side.encode() + b"Hand"
            pose, root = MOTION[side]
            held[before + b"Pose"] = np.concatenate([root[frame], pose[frame]])
            held[before + b"Trans"] = PLACE[side][frame]
            held[before + b"Joints3D"] = np.zeros((21, 3))
        turn = OBJECT[0][frame].as_rotvec()
        held[b"objRot"] = turn[:, None] if hands == 1 else turn
        held[b"objTrans"] = OBJECT[1][frame]
        if frame == 2:  # without annotation
            held = {key: None if key != b"objName" else value for key, value in held.items()}
        file = sequence / "meta" / f"{frame + 10:04d}.pkl"
        file.write_bytes(pickled(held))
        files.append(file)
    turn = np.diag([1.0, -1.0, -1.0])
    thing = homogeneous(turn, np.zeros(3)) @ _object()
    return Made(
        sequence,
        files[:1] + files[3:4],
        expected(turn, sides=sides, shape_of_right=True),
        {"025_mug": thing},
        np.eye(4),
        np.arange(FRAMES) / 30.0,
        shape={side: betas[side] for side in sides},
    )


def arctic(folder: Path) -> Made:
    raw = folder / "raw_seqs" / "s01"
    raw.mkdir(parents=True)
    held = {}
    for side in SIDES:
        pose, root = MOTION[side]
        held[side] = {
            "rot": root,
            "pose": pose - ARRAYS[side]["hands_mean"],
            "trans": PLACE[side],
            "shape": BETAS[side],
            "fitting_err": [0.001] * FRAMES,
        }
    hands = raw / "box_grab_01.mano.npy"
    hands.write_bytes(npy_of_object(held))
    bend = np.linspace(0.0, 1.0, FRAMES)
    rows = np.concatenate([bend[:, None], OBJECT[0].as_rotvec(), 1000 * OBJECT[1]], axis=1)
    np.save(raw / "box_grab_01.object.npy", rows)
    turn = Rotation.from_rotvec(np.linspace([0, 0, 0], [0.3, 0.1, 2.0], FRAMES)).as_matrix()
    extrinsic = homogeneous(turn, np.linspace([0, 0, 1], [0.2, 0, 1], FRAMES))
    np.save(
        raw / "box_grab_01.egocam.dist.npy",
        {
            "R_k_cam_np": extrinsic[:, :3, :3],
            "T_k_cam_np": extrinsic[:, :3, 3:],
            "intrinsics": np.eye(3),
            "dist8": np.zeros(8),
        },
        allow_pickle=True,
    )  # type: ignore[arg-type]
    mesh = mesh_file(folder / "meta" / "object_vtemplates" / "box" / "top.obj")
    hinge = homogeneous(Rotation.from_rotvec(bend[:, None] * [0, 0, -1.0]).as_matrix(), np.zeros(3))
    return Made(
        hands,
        [hands, raw / "box_grab_01.object.npy", raw / "box_grab_01.egocam.dist.npy"],
        expected(np.eye(3)),
        {"box/bottom": _object(), "box/top": _object() @ hinge},
        np.linalg.inv(extrinsic),
        np.arange(FRAMES) / 30.0,
        "grab the box",
        {"box/top": mesh},
    )


def oakink2(folder: Path) -> Made:
    token = "scene_01__A001++seq__2023-04-27-19-17-54"
    ids = list(range(40, 40 + FRAMES))
    mano: dict[Any, Any] = {}
    for number, frame in enumerate(ids):
        one = {}
        for short, side in (("rh", "right"), ("lh", "left")):
            pose, root = MOTION[side]
            vectors = np.concatenate([root[number], pose[number]]).reshape(16, 3)
            turns = Rotation.from_rotvec(vectors).as_quat()[:, [3, 0, 1, 2]]
            one[f"{short}__pose_coeffs"] = Tensor(turns[None])
            one[f"{short}__tsl"] = Tensor(PLACE[side][number][None])
            one[f"{short}__betas"] = Tensor(BETAS[side][None])
        mano[frame] = one
    extrinsic = homogeneous(Rotation.from_rotvec([2.0, 0.1, 0.3]).as_matrix(), [0.1, 0.2, 1.0])
    held = {
        "cam_def": {"104422070969": "egocentric", "1": "allocentric_top"},
        "cam_selection": ["egocentric"],
        "frame_id_list": ids[::4],
        "cam_extr": {"104422070969": dict.fromkeys(ids[::4], extrinsic)},
        "mocap_frame_id_list": ids,
        "obj_list": ["O02@0015@00001"],
        "obj_transf": {"O02@0015@00001": dict(zip(ids, _object(), strict=True))},
        "raw_smplx": {40: {"world_tsl": Tensor(np.zeros((1, 3)))}},
        "raw_mano": mano,
    }
    path = folder / "anno_preview" / f"{token}.pkl"
    path.parent.mkdir(parents=True)
    path.write_bytes(pickled(held))
    mesh = mesh_file(folder / "object_repair" / "align_ds" / "O02@0015@00001" / "scan.obj")
    (folder / "program").mkdir()
    target = folder / "program" / "task_target.json"
    target.write_text(json.dumps({token.replace("++", "/"): "Heat the beaker."}))
    # y up, -z ahead: our x is -z, our y is -x, our z is y
    turn = np.array([[0, 0, -1.0], [-1, 0, 0], [0, 1, 0]])
    world = homogeneous(turn, np.zeros(3))
    return Made(
        path,
        [path, target],
        expected(turn, tips="manopth", about_wrist=True),
        {"O02@0015@00001": world @ _object()},
        world @ np.linalg.inv(extrinsic),
        np.arange(FRAMES) / 120.0,
        "Heat the beaker.",
        {"O02@0015@00001": mesh},
    )


def taco(folder: Path) -> Made:
    part = Path("(stir, spoon, bowl)") / "20231105_019"
    hands = folder / "Hand_Poses" / part
    objects = folder / "Object_Poses" / part
    cameras = folder / "Egocentric_Camera_Parameters" / part
    videos = folder / "Egocentric_RGB_Videos" / part
    for made in (hands, objects, cameras, videos):
        made.mkdir(parents=True)
    for side in SIDES:
        pose, root = MOTION[side]
        held = {
            f"{frame:05d}": {
                "hand_pose": Tensor(np.concatenate([root[frame], pose[frame]])),
                "hand_trans": Tensor(PLACE[side][frame]),
            }
            for frame in range(FRAMES)
        }
        (hands / f"{side}_hand.pkl").write_bytes(pickled(held))
        shape = {"hand_shape": Tensor(BETAS[side])}
        (hands / f"{side}_hand_shape.pkl").write_bytes(pickled(shape))
    np.save(objects / "tool_033.npy", _object())
    np.save(objects / "target_121.npy", _object()[::-1])
    extrinsic = np.tile(
        homogeneous(Rotation.from_rotvec([1, 0, 0.5]).as_matrix(), [0, 0, 1.0]), (FRAMES, 1, 1)
    )
    np.save(cameras / "egocentric_frame_extrinsic.npy", extrinsic)
    video = videos / "color.mp4"
    video.write_bytes(b"x")
    mesh = mesh_file(folder / "Object_Models" / "033_cm.obj")
    return Made(
        hands,
        [
            hands / "right_hand.pkl",
            hands / "left_hand_shape.pkl",
            objects / "tool_033.npy",
            cameras / "egocentric_frame_extrinsic.npy",
        ],
        expected(np.eye(3), tips="manopth", about_wrist=True),
        {"tool/033": _object(), "target/121": _object()[::-1]},
        np.linalg.inv(extrinsic),
        np.arange(FRAMES) / 30.0,
        "stir the bowl with the spoon",
        {"tool/033": mesh},
        video,
    )


def grab(folder: Path) -> Made:
    path = folder / "grab" / "s1" / "mug_drink_1.npz"
    path.parent.mkdir(parents=True)
    meshes = folder / "tools" / "subject_meshes" / "male"
    meshes.mkdir(parents=True)
    arrays, held, few = {}, {}, {}
    for key, side in (("rhand", "right"), ("lhand", "left")):
        root, c = MOTION[side][1], coefficients(side, 24, mean=False)
        template = ARRAYS[side]["v_template"] * 1.05 + 0.001
        arrays[side] = {**ARRAYS[side], "v_template": template}
        few[side] = c @ ARRAYS[side]["hands_components"][:24]
        lines = [" ".join(repr(float(v)) for v in row) for row in template]
        head = f"ply\nformat ascii 1.0\nelement vertex {len(lines)}\n"
        head += "".join(f"property double {axis}\n" for axis in "xyz")
        head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        (meshes / f"s1_{key}.ply").write_text(head + "\n".join((*lines, "3 0 1 2")) + "\n")
        held[key] = {
            "params": {
                "global_orient": root,
                "hand_pose": c,
                "transl": PLACE[side],
                "fullpose": few[side],
            },
            "vtemp": f"tools/subject_meshes/male/s1_{key}.ply",
        }
    held["object"] = {
        "params": {"global_orient": -OBJECT[0].as_rotvec(), "transl": OBJECT[1]},
        "object_mesh": "tools/object_meshes/contact_meshes/mug.ply",
    }
    np.savez(
        path,
        **held,
        obj_name="mug",
        sbj_id="s1",
        n_comps=24,
        gender="male",
        framerate=120.0,
        motion_intent="drink",
        n_frames=FRAMES,
        body={"params": {}},
        contact={"body": np.zeros(3)},
    )  # type: ignore[arg-type]
    return Made(
        path,
        [path, meshes / "s1_rhand.ply"],
        landmarks_of(arrays, few, np.zeros(10)),
        {"mug": _object()},
        None,
        np.arange(FRAMES) / 120.0,
        "drink the mug",
        shape={},
    )


def hot3d(folder: Path, headset: str = "Aria") -> Made:
    sequence = folder / "P0003_c701bd11"
    sequence.mkdir(parents=True)
    start, lines, rows = 56_752_108_188_860, [], []
    mended = {
        "right": ARRAYS["right"],
        "left": {
            **ARRAYS["left"],
            "shapedirs": ARRAYS["left"]["shapedirs"] * np.array([-1, 1, 1])[:, None],
        },
    }
    few = {
        side: coefficients(side, 15, mean=True) @ ARRAYS[side]["hands_components"][:15]
        + ARRAYS[side]["hands_mean"]
        for side in SIDES
    }
    uid = "223371871635142"
    for frame in range(FRAMES):
        for late in (0, 90_000):  # the headset's cameras, one after the other
            time = start + frame * 33_333_333 + late
            hands = {}
            for number, side in (("0", "left"), ("1", "right")):
                if frame == 2 and side == "left":
                    continue
                turn = Rotation.from_rotvec(MOTION[side][1][frame]).as_quat()[[3, 0, 1, 2]]
                hands[number] = {
                    "pose": coefficients(side, 15, mean=True)[frame].tolist(),
                    "wrist_xform": {"t_xyz": PLACE[side][frame].tolist(), "q_wxyz": turn.tolist()},
                    "betas": BETAS["right"].tolist(),
                }
            lines.append(json.dumps({"timestamp_ns": time, "hand_poses": hands}))
            quaternion = OBJECT[0][frame].as_quat()[[3, 0, 1, 2]]
            values = ",".join(repr(float(v)) for v in (*OBJECT[1][frame], *quaternion))
            rows.append(f"{uid},{time},{values}")
    hands_file = sequence / "mano_hand_pose_trajectory.jsonl"
    hands_file.write_text("\n".join(lines) + "\n")
    table = sequence / "dynamic_objects.csv"
    table.write_text(
        "object_uid,timestamp[ns],t_wo_x[m],t_wo_y[m],t_wo_z[m],q_wo_w,q_wo_x,q_wo_y,q_wo_z\n"
        + "\n".join(rows)
        + "\n"
    )
    about = sequence / "metadata.json"
    about.write_text(json.dumps({"headset": headset, "recording_name": sequence.name}))
    assets = folder / "assets"
    assets.mkdir()
    (assets / "instance.json").write_text(json.dumps({uid: {"instance_name": "mug_white"}}))
    (assets / f"{uid}.glb").write_bytes(b"x")
    turn = np.eye(3) if headset == "Aria" else np.array([[0, 0, -1.0], [-1, 0, 0], [0, 1, 0]])
    return Made(
        sequence,
        [hands_file, table, about],
        landmarks_of(mended, few, BETAS["right"], turn),
        {"mug_white": homogeneous(turn, np.zeros(3)) @ _object()},
        None,
        np.arange(FRAMES) * 33_333_333 / 1e9,
        None,
        {"mug_white": assets / f"{uid}.glb"},
        shape=dict.fromkeys(SIDES, BETAS["right"]),
    )


def mano(folder: Path) -> Made:
    path = folder / "take.npz"
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {"flat_hand_mean": True, "fps": 30.0, "world": "openxr", "task": "a"}
    for side in SIDES:
        pose, root = MOTION[side]
        arrays |= {
            f"{side}_global_orient": root,
            f"{side}_hand_pose": pose,
            f"{side}_betas": BETAS[side],
            f"{side}_transl": PLACE[side],
        }
    np.savez(path, **arrays)
    turn = np.array([[0, 0, -1.0], [-1, 0, 0], [0, 1, 0]])
    return Made(path, [path], expected(turn), stamps=np.arange(FRAMES) / 30.0, task="a")


def mano_pickle(folder: Path) -> Made:
    """Rotations as matrices, both hands in tables, of a model that looks at pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    held: dict[str, Any] = {"fps": 30, "world": "camera"}
    for side in SIDES:
        pose, root = MOTION[side]
        turns = Rotation.from_rotvec(pose.reshape(-1, 3)).as_matrix()
        held[side] = {
            "global_orient": Rotation.from_rotvec(root).as_matrix()[:, None],
            "hand_pose": turns.reshape(-1, 15, 3, 3),
            "betas": Tensor(np.tile(BETAS[side], (FRAMES, 1))),
            "transl": PLACE[side],
            "confidence": np.linspace(0, 1, FRAMES),
        }
    path = folder / "take.pkl"
    path.write_bytes(pickled(held))
    return Made(
        path, [path], expected(np.eye(3)), camera=np.eye(4), stamps=np.arange(FRAMES) / 30.0
    )


WRITERS: dict[str, Callable[[Path], Made]] = {
    "dexycb": dexycb,
    "ho3d": ho3d,
    "arctic": arctic,
    "oakink2": oakink2,
    "taco": taco,
    "grab": grab,
    "hot3d": hot3d,
    "mano": mano,
}
MORE: dict[str, tuple[str, Callable[[Path], Made]]] = {
    "dexycb left": ("dexycb", lambda folder: dexycb(folder, "left")),
    "ho3d two hands": ("ho3d", lambda folder: ho3d(folder, 2)),
    "hot3d quest": ("hot3d", lambda folder: hot3d(folder, "Quest3")),
    "mano pickle": ("mano", mano_pickle),
}
CASES: dict[str, tuple[str, Callable[[Path], Made]]] = {
    **{name: (name, writer) for name, writer in WRITERS.items()},
    **MORE,
}
