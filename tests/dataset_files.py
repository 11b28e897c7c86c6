"""Files of data sets of hands, written here from their published layouts without a reader's code.

``hand`` makes a moving hand in the project's world; each writer turns both into the frame, order
and container of its layout. ``wrong_frames`` counts the frames of a clip that show the other hand.
"""

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Any

import headset_apps as app
import numpy as np

from smooth_operator.synthetic import SyntheticOperator, WristMotion
from smooth_operator.types import Side

RATE = 30.0
SIDES: tuple[Side, Side] = ("right", "left")
PICKED = [0, 1, 2, 3, 4, 6, 7, 8, 9, 11, 12, 13, 14, 16, 17, 18, 19, 21, 22, 23, 24]
BASES = [5, 10, 15, 20]
EGODEX_ORDER = ["Hand", "ThumbKnuckle", "ThumbIntermediateBase"]
EGODEX_ORDER += ["ThumbIntermediateTip", "ThumbTip"]
for _finger in ("Index", "Middle", "Ring", "Little"):
    EGODEX_ORDER += [
        f"{_finger}Finger{part}"
        for part in ("Metacarpal", "Knuckle", "IntermediateBase", "IntermediateTip", "Tip")
    ]


@dataclass(frozen=True)
class Hand:
    """A hand over a second, in a z-up world: x ahead, y left.

    Attributes:
        nodes: (T, 25, 3) in WebXR's order [m].
        wrist: (T, 7) x y z and w x y z.
    """

    nodes: np.ndarray
    wrist: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """(T, 21, 3)."""
        return self.nodes[:, PICKED]


@lru_cache
def hand(side: Side, seconds: float = 1.0) -> Hand:
    """The virtual operator's hand, with a wrist that moves."""
    motion = WristMotion(0.1, 0.4, seed=3)
    sent = SyntheticOperator(seed=1, side=side, wrist=motion, rate_hz=RATE).record(seconds)
    nodes = np.zeros((len(sent), 25, 3))
    # The operator's x is palmar, y radial of the right hand, z distal: palm down, ahead.
    turned = (2, 1, 0)
    nodes[:, PICKED] = sent.landmarks[..., turned] * (1, 1, -1)
    nodes[:, BASES] = sent.metacarpals[..., turned] * (1, 1, -1)
    shift = np.array([0.0, -0.15 if side == "right" else 0.15, 1.0])
    wrist = sent.T_world_wrist.copy()
    wrist[:, :3] += shift
    return Hand(nodes + shift, wrist)


def other(side: Side) -> Side:
    return "left" if side == "right" else "right"


def wrong_frames(points: np.ndarray, valid: np.ndarray, side: Side) -> tuple[int, int]:
    """Frames that show the other hand, and whole frames.

    In those, the fingertips lie clearly on the wrong side of the palm; that is the median of the
    planes of any two knuckles, so that one landmark in a wrong place makes no other hand.
    """
    whole = points[valid.all(axis=1)]
    length = np.linalg.norm(whole[:, 9] - whole[:, 0], axis=1)
    tips = whole[:, [8, 12, 16, 20]] - whole[:, [5, 9, 13, 17]]
    bends = []
    for one, other in combinations((5, 9, 13, 17), 2):
        normal = np.cross(whole[:, one] - whole[:, 0], whole[:, other] - whole[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        bends.append(np.median((tips * normal[:, None]).sum(axis=-1), axis=1))
    bent = np.median(bends, axis=0) / np.maximum(length, 1e-12)
    if side == "left":
        bent = -bent
    return int((bent < -0.1).sum()), len(whole)


# EgoDex: ARKit's world (x to the right, y up, z to the viewer), 4 x 4 transforms.


def arkit(points: np.ndarray) -> np.ndarray:
    return np.stack([-points[..., 1], points[..., 2], -points[..., 0]], axis=-1)


def camera_in_arkit(count: int) -> np.ndarray:
    """(T, 4, 4): a head that looks ahead and down and moves to the left, its z being ahead."""
    out = np.tile(np.eye(4), (count, 1, 1))
    tilt = np.deg2rad(35.0)
    ahead = np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    right = np.array([0.0, -1.0, 0.0])
    for k, axis in enumerate((right, np.cross(ahead, right), ahead)):
        out[:, :3, k] = arkit(axis)
    at = np.stack([np.zeros(count), 0.002 * np.arange(count), np.full(count, 1.5)], axis=1)
    out[:, :3, 3] = arkit(at)
    return out


def egodex_file(
    path: Path,
    *,
    confidence: float | dict[Side, float] = 1.0,
    left_out: Sequence[str] = (),
    exchanged: bool = False,
    about: dict[str, Any] | None = None,
) -> None:
    """A file of EgoDex.

    Args:
        path: the file.
        confidence: of frame 3 of each joint, the others being 1; a number for each side is that of
            all frames.
        left_out: joints that are missing.
        exchanged: whether the right hand's joints have the left hand's names.
        about: its attributes.
    """
    import h5py

    with h5py.File(path, "w") as file:
        for side in SIDES:
            it = hand(side)
            named = other(side) if exchanged else side
            nodes = arkit(it.nodes)
            turn = np.stack([app.turn(q) for q in it.wrist[:, 3:]])
            fingers, _, back = (arkit(turn[:, :, k]) for k in range(3))
            # the right hand's x points to the forearm, y out of the back; the left hand's x to the
            # fingers, y out of the palm; z completes both
            x, y = (-fingers, back) if side == "right" else (fingers, -back)
            for k, name in enumerate(EGODEX_ORDER):
                joint = np.tile(np.eye(4), (len(nodes), 1, 1))
                joint[:, :3, 3] = nodes[:, k]
                joint[:, :3, 0], joint[:, :3, 1], joint[:, :3, 2] = x, y, np.cross(x, y)
                if side + name in left_out:
                    continue
                file[f"transforms/{named}{name}"] = joint.astype(np.float32)
                seen = np.ones(len(nodes), np.float32)
                if isinstance(confidence, dict):
                    seen[:] = confidence[side]
                else:
                    seen[3] = confidence
                file[f"confidences/{named}{name}"] = seen
            elbow = np.tile(np.eye(4), (len(nodes), 1, 1))
            elbow[:, :3, 3] = nodes[:, 0] - 0.25 * fingers
            file[f"transforms/{named}Forearm"] = elbow.astype(np.float32)
        file["transforms/camera"] = camera_in_arkit(len(nodes))
        file["camera/intrinsic"] = np.array([[736.6, 0, 960], [0, 736.6, 540], [0, 0, 1.0]])
        for key, value in (about or {}).items():
            file.attrs[key] = value


# Headset apps.


def avp_file(
    path: Path,
    *,
    sides: Sequence[Side] = SIDES,
    lost: dict[Side, range] | None = None,
    exchanged: bool = False,
) -> None:
    """Tracking Streamer's lines; a hand that is lost is sent as it was, for all that follows."""
    lines = []
    last: dict[Side, Any] = {}
    for k in range(len(hand("right").wrist)):
        line: dict[str, Any] = {"videoWidth": 0, "timestamp": k / RATE}
        for side in SIDES:
            it = hand(side)
            turn = app.turn(it.wrist[k, 3:])
            local = (it.nodes[k] - it.nodes[k, 0]) @ turn
            wrist = app.arkit_wrist(side, tuple(it.wrist[k]))
            now = app.avp_jsonl_hand(wrist, app.arkit_joints(side, local))
            if side not in sides:
                still = np.stack([np.eye(4)] * 27)
                now = app.avp_jsonl_hand(np.eye(4), still)
            if lost is None or k not in lost.get(side, ()):
                last[side] = now
            named = other(side) if exchanged else side
            line[f"{named}Hand"] = last[side]
        lines.append(json.dumps(line, separators=(",", ":")))
    path.write_text("\n".join(lines) + "\n")


def hts_file(
    path: Path,
    *,
    sides: Sequence[Side] = SIDES,
    stamped: bool = True,
    apart_ns: int = 0,
    exchanged: bool = False,
    between: bytes = b"\n",
) -> None:
    """Hand Tracking Streamer's lines; the left hand is sent some time after the right one."""
    parts = []
    for k in range(len(hand("right").wrist)):
        for n, side in enumerate(sides):
            it = hand(side)
            local = (it.points[k] - it.points[k, 0]) @ app.turn(it.wrist[k, 3:])
            at = 10**9 + round(k / RATE * 1e9) + n * apart_ns
            meta = f" | f = {k} | t = {at}" if stamped else ""
            named = other(side) if exchanged else side
            parts.append(app.hts_packet(named, tuple(it.wrist[k]), local, meta))
    parts.append(b"Head pose:, 0, 1.5, 0, 0, 0, 0, 1")
    path.write_bytes(between.join(parts))


# What hand models say of a video: the camera's frame, x right, y down, z into the picture.


def in_camera(side: Side) -> np.ndarray:
    """(T, 21, 3) as the camera of ``camera_in_arkit`` sees them."""
    it = hand(side)
    camera = camera_in_arkit(len(it.nodes))
    back = np.linalg.inv(camera)
    seen = arkit(it.points)
    return np.einsum("tij,tnj->tni", back[:, :3, :3], seen) + back[:, None, :3, 3]


def wilor_frames(*, exchanged: bool = False, lost: dict[Side, range] | None = None) -> list[Any]:
    """What ``predict`` of WiLoR-mini gives for each frame of a video."""
    frames: list[Any] = []
    for k in range(len(hand("right").wrist)):
        hands = []
        for side in SIDES:
            if lost is not None and k in lost.get(side, ()):
                continue
            points = in_camera(side)[k].astype(np.float32)
            at = points[0] + np.float32(0.01)
            right = (side == "right") != exchanged
            hands.append(
                {
                    "hand_bbox": [10.0, 20.0, 200.0, 220.0],
                    "is_right": float(right),
                    "wilor_preds": {
                        "pred_keypoints_3d": (points - at)[None],
                        "pred_cam_t_full": at[None],
                        "betas": np.zeros((1, 10), np.float32),
                        "scaled_focal_length": 5000.0,
                    },
                }
            )
        frames.append(hands)
    return frames


def plain(value: Any) -> Any:
    """Arrays as lists, for JSON."""
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [plain(one) for one in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def egotouch_lines(*, exchanged: bool = False) -> str:
    """``wilor_hands.json`` of EgoTouch: a line for each frame; the left hand is missing in one."""
    rows = []
    for k in range(len(hand("right").wrist)):
        row: dict[str, Any] = {"frame_index": k}
        for side in SIDES:
            named = other(side) if exchanged else side
            row[f"{named}_pos"] = in_camera(side)[k].round(6).tolist()
        if k == 4:
            row["left_pos"] = None
        rows.append(json.dumps(row))
    return "\n".join(rows) + "\n"


def hawor_tags(*, exchanged: bool = False) -> dict[str, Any]:
    """What Data-Juicer's operator of HaWoR puts into a sample; the left hand from frame 5 on."""
    out: dict[str, Any] = {"fov_x": 1.0, "img_focal": 600.0}
    for side in SIDES:
        named = other(side) if exchanged else side
        first = 0 if side == "right" else 5
        points = in_camera(side)[first:]
        out[named] = {
            "frame_ids": list(range(first, first + len(points))),
            "betas": [[0.0] * 10] * len(points),
            "joints_cam": points.round(6).tolist(),
        }
    return out


def hamer_arrays() -> dict[str, Any]:
    """The landmarks that forks of HaMeR save for a video."""
    return {
        **{f"j3d.{side}": in_camera(side).astype(np.float32) for side in SIDES},
        "im_paths": [f"{k:06d}.jpg" for k in range(len(hand("right").wrist))],
    }


def detections_npz() -> bytes:
    """Hands of all frames in one array."""
    count = len(hand("right").wrist)
    stream = io.BytesIO()
    np.savez(
        stream,
        pred_keypoints_3d=np.concatenate([in_camera(s) - in_camera(s)[:, :1] for s in SIDES]),
        pred_cam_t_full=np.concatenate([in_camera(s)[:, 0] for s in SIDES]),
        is_right=np.repeat([1, 0], count),
        frame=np.tile(np.arange(count), 2),
    )
    return stream.getvalue()


def egohandkit_file(
    path: Path,
    *,
    stamped: bool = True,
    empty_rows: bool = False,
    exchanged: bool = False,
    said: dict[bytes, bytes] | None = None,
) -> None:
    """``hand_tracking.parquet``; the left hand is missing in frames 6 to 8, and all in the last.

    Args:
        path: the file.
        stamped: whether frames have times.
        empty_rows: whether a missing hand is null, as in its first version, and not NaN.
        exchanged: whether left and right have each other's columns.
        said: metadata in place of its own.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    joints = pa.list_(pa.list_(pa.float32(), 3), 21)
    count = len(hand("right").wrist)
    rows: dict[str, list[Any]] = {"frame_idx": list(range(count))}
    rows["timestamp_ns"] = [
        10**9 + round(k / RATE * 1e9) if stamped else None for k in range(count)
    ]
    for side in SIDES:
        named = other(side) if exchanged else side
        gone = {count - 1} | (set(range(6, 9)) if side == "left" else set())
        points = in_camera(side).astype(np.float32)
        missing = None if empty_rows else np.full((21, 3), np.nan, np.float32).tolist()
        rows[f"{named}_present"] = [k not in gone for k in range(count)]
        rows[f"{named}_joints_3d"] = [
            missing if k in gone else p.tolist() for k, p in enumerate(points)
        ]
        rows[f"{named}_confidence"] = [None if k in gone else 0.5 + 0.01 * k for k in range(count)]
    rows["source"] = ["hawor"] * count
    own = {b"coordinate_system": b"opencv_x_right_y_down_z_forward", b"joint_order": b"openpose21"}
    kinds = {"frame_idx": pa.int64(), "timestamp_ns": pa.int64(), "source": pa.string()}
    for side in SIDES:
        kinds[f"{side}_present"] = pa.bool_()
        kinds[f"{side}_joints_3d"] = joints
        kinds[f"{side}_confidence"] = pa.float32()
    schema = pa.schema([(name, kinds[name]) for name in rows], metadata={**own, **(said or {})})
    pq.write_table(pa.table(rows, schema=schema), path)


def landmarks_file(path: Path, *, exchanged: bool = False, **more: Any) -> None:
    """The project's own layout for anybody's data; a value of None leaves an array out."""
    count = len(hand("right").wrist)
    arrays: dict[str, Any] = {"timestamps": 5.0 + np.arange(count) / RATE}
    for side in SIDES:
        named = other(side) if exchanged else side
        arrays[named] = hand(side).points
        arrays[f"T_world_wrist_{named}"] = hand(side).wrist
    arrays |= more
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
