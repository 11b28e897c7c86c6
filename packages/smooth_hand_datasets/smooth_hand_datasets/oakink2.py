"""OakInk2: two hands and many objects in tasks of several steps, from motion capture.

Source: Zhan et al., *OakInk2*, CVPR 2024, and https://github.com/oakink/OakInk2.
``anno_preview/TOKEN.pkl`` has a sequence, frame by frame at 120 Hz, in a world with y up.
``program/task_target.json`` has the tasks.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_hand_datasets.mano_model import load_model
from smooth_hand_datasets.scene import (
    Scene,
    Thing,
    checked_count,
    nearby,
    read_table,
    rigid,
    world_pose,
)
from smooth_hand_datasets.unpickle import array, load_restricted, table, text
from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import Clip, ClipRef, ReadingOptions
from smooth_operator.poses import WORLD_AXES
from smooth_operator.types import Side

RATE_HZ: Final = 120.0
_KEYS: Final = ("raw_mano", "mocap_frame_id_list", "obj_list", "obj_transf")
_SIDES: Final[dict[str, Side]] = {"rh": "right", "lh": "left"}
_TO_WORLD: Final = world_pose(WORLD_AXES["openxr"])


class OakInk2:
    """Reader of OakInk2's sequences, ``anno_preview/TOKEN.pkl``."""

    what = "a sequence of OakInk2"
    expects = (
        "anno_preview/TOKEN.pkl with mocap_frame_id_list, raw_mano (frame -> rh__pose_coeffs "
        "(1, 16, 4), rh__tsl (1, 3), rh__betas (1, 10) and the same with lh), obj_list, obj_transf"
    )

    def matches(self, path: Path) -> bool:
        """True if a path is a pickle with the name of a sequence in a folder of annotations."""
        return (
            path.suffix == ".pkl"
            and "++" in path.name
            and path.resolve().parent.name.startswith("anno")
            and path.is_file()
        )

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """List the sequence."""
        yield ClipRef(
            path.stem.replace("++", "/"), path, layout="oakink2", size=path.stat().st_size
        )

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands, the objects and the camera on the head."""
        where = str(ref.path)
        held = table(load_restricted(ref.path), where, _KEYS)
        ids = _ids(held["mocap_frame_id_list"], f"{where}, mocap_frame_id_list")
        count = checked_count({"mocap_frame_id_list": len(ids)}, where)
        mano = table(held["raw_mano"], f"{where}, raw_mano")
        placed, shape = {}, {}
        for short, side in _SIDES.items():
            turns = _rows(mano, ids, f"{short}__pose_coeffs", (16, 4), where)
            at = _rows(mano, ids, f"{short}__tsl", (3,), where)
            betas = _rows(mano, ids, f"{short}__betas", (10,), where)
            finite = np.isfinite(betas).all(axis=1) & np.isfinite(at).all(axis=1)
            if not finite.any():
                continue
            size = np.linalg.norm(turns, axis=-1, keepdims=True)
            good = (np.abs(size - 1.0) < 0.1).all(axis=(1, 2))
            if (finite & ~good).any():
                raise RecordingError(
                    f"{where}: {short}__pose_coeffs must be unit quaternions w x y z; frame "
                    f"{ids[int(np.argmax(finite & ~good))]} has others"
                )
            matrices = np.full((count, 16, 3, 3), np.nan)
            matrices[finite] = poses.rotation_matrices(turns[finite] / size[finite])
            shape[side] = np.median(betas[finite], axis=0)
            betas[~finite] = 0.0
            model = load_model(options.mano, side)
            placed[side] = model.place(matrices, betas, at, moves="wrist", tips="manopth")
        folder = ref.path.resolve().parent
        meshes = options.objects or nearby(
            folder, *(f"object_{kind}/align_ds" for kind in ("repair", "raw", "preview"))
        )
        tasks = nearby(folder, "program/task_target.json")
        task = None if tasks is None else read_table(tasks).get(ref.path.stem.replace("++", "/"))
        return Scene(
            placed,
            (ids - ids[0]) / (options.rate or RATE_HZ),
            "oakink2",
            (ref.path,),
            _TO_WORLD,
            shape,
            _camera(held, ids, where),
            _things(held, ids, meshes, where),
            text(task, 1000),
        ).clip(ref, "oakink2", self.expects)


def _ids(value: Any, where: str) -> np.ndarray:
    ids = array(value, where, (None,), finite=True).astype(np.int64)
    if len(ids) and (np.diff(ids) <= 0).any():
        raise RecordingError(f"{where}: frame numbers must increase")
    return ids


def _rows(
    mano: dict[Any, Any], ids: np.ndarray, key: str, shape: tuple[int, ...], where: str
) -> np.ndarray:
    """(T, ...) values of a key; NaN for frames that raw_mano lacks."""
    rows = np.full((len(ids), *shape), np.nan)
    for row, number in zip(rows, ids.tolist(), strict=True):
        frame = mano.get(number)
        if frame is not None:
            named = f"{where}, raw_mano of frame {number}"
            row[...] = array(table(frame, named, (key,))[key], f"{named}, {key}", (1, *shape))[0]
    return rows


def _things(held: dict[Any, Any], ids: np.ndarray, meshes: Path | None, where: str) -> list[Thing]:
    moved = table(held["obj_transf"], f"{where}, obj_transf")
    things = []
    for name in held["obj_list"] if isinstance(held["obj_list"], list | tuple) else ():
        label = text(name)
        if label is None or name not in moved:
            raise RecordingError(f"{where}: an object of obj_list is not in obj_transf")
        named = f"{where}, obj_transf of {label}"
        frames = table(moved[name], named)
        track = np.full((len(ids), 7), np.nan)
        rows = [row for row, number in enumerate(ids.tolist()) if number in frames]
        if rows:
            stack = [array(frames[int(ids[row])], named, (4, 4)) for row in rows]
            track[rows] = rigid(np.stack(stack), named)
        things.append(Thing(label, track, _mesh(meshes, label)))
    return things


def _mesh(folder: Path | None, name: str) -> Path | None:
    place = None if folder is None else folder / Path(name).name
    if place is None or not place.is_dir():
        return None
    files = sorted(file for file in place.iterdir() if file.suffix in (".obj", ".ply"))
    return files[0] if files else None


def _camera(held: dict[Any, Any], ids: np.ndarray, where: str) -> np.ndarray | None:
    """Poses of the egocentric camera, whose 30 Hz values are held between its frames."""
    names, extrinsics = held.get("cam_def"), held.get("cam_extr")
    if not isinstance(names, dict) or not isinstance(extrinsics, dict):
        return None
    mine = [
        key
        for serial, name in names.items()
        if "ego" in str(text(name)).lower()
        for key in (serial, name)
        if isinstance(key, str) and key in extrinsics
    ]
    frames = extrinsics.get(mine[0]) if mine else None
    if not isinstance(frames, dict) or not frames:
        return None
    keys = sorted(key for key in frames if type(key) is int)
    if not keys:
        return None
    named = f"{where}, cam_extr"
    stack = np.stack([array(frames[key], named, (4, 4)) for key in keys])
    camera = rigid(stack, named, inverse=True)
    last = np.clip(np.searchsorted(keys, ids, side="right") - 1, 0, None)
    return np.asarray(camera[last])


OAKINK2: Final = OakInk2()
