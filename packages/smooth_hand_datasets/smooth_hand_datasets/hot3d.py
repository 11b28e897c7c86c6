"""HOT3D (its MANO part): two hands and several objects, recorded with Aria glasses or a Quest 3.

Source: Banerjee et al., *HOT3D: Hand and Object Tracking in 3D from Egocentric Multi-View Videos*,
CVPR 2025, and https://github.com/facebookresearch/hot3d. A folder of a sequence has
``mano_hand_pose_trajectory.jsonl`` and ``dynamic_objects.csv``. Aria's world has z up, the Quest's
has y up; ``metadata.json`` names the headset. The pose of the camera in the headset is in the
recording (``.vrs``), which is not read.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_hand_datasets.mano_model import PlacedHand, load_model
from smooth_hand_datasets.scene import (
    MOST_FRAMES,
    Scene,
    Thing,
    checked_count,
    nearby,
    read_table,
    world_pose,
)
from smooth_hand_datasets.unpickle import array, table
from smooth_operator import poses
from smooth_operator.errors import DocumentError, RecordingError
from smooth_operator.formats.clip import Clip, ClipRef, ReadingOptions
from smooth_operator.io.documents import parse_json
from smooth_operator.io.plain_files import check_plain_file, read_text
from smooth_operator.poses import WORLD_AXES
from smooth_operator.types import Side

_HANDS: Final = "mano_hand_pose_trajectory.jsonl"
_OBJECTS: Final = ("dynamic_objects.csv", "dynamic_objects_v2.csv")
_SIDES: Final[dict[str, Side]] = {"0": "left", "1": "right"}
_MOST_BYTES: Final = 200_000_000
_MOST_TABLE_BYTES: Final = 64_000_000
_LONGEST_LINE: Final = 100_000
_TWICE_NS: Final = 5_000_000  # frames of the cameras of one headset are closer than that
_NEAR_NS: Final = 20_000_000  # most difference in time between a frame and an object's pose
_COLUMNS: Final = (
    "object_uid",
    "timestamp[ns]",
    "t_wo_x[m]",
    "t_wo_y[m]",
    "t_wo_z[m]",
    "q_wo_w",
    "q_wo_x",
    "q_wo_y",
    "q_wo_z",
)


class Hot3d:
    """Reader of HOT3D's folders of sequences."""

    what = "a sequence of HOT3D"
    expects = (
        f"{_HANDS} with timestamp_ns and hand_poses (0 left, 1 right: pose (15,), wrist_xform, "
        "betas (10,)) in each line, metadata.json, and dynamic_objects.csv"
    )

    def matches(self, path: Path) -> bool:
        """True if a path is a folder with MANO hands of HOT3D."""
        return (path / _HANDS).is_file()

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """List the sequence."""
        size = (path / _HANDS).stat().st_size
        yield ClipRef(path.resolve().name, path, layout="hot3d", size=size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands and objects."""
        path = ref.path / _HANDS
        headset = _headset(ref.path)
        times, lines = _lines(path)
        checked_count({_HANDS: len(times)}, str(path))
        placed: dict[Side, PlacedHand] = {}
        shape = {}
        for number, side in _SIDES.items():
            track, betas = _hand(lines, number, path)
            if not np.isfinite(track).any():
                continue
            model = load_model(options.mano, side, mirrored_shape=True)
            with_shape = np.isfinite(betas).all(axis=1)
            if not with_shape.any():
                raise RecordingError(f"{path}: no line has betas, the shape of the hand")
            shape[side] = np.median(betas[with_shape], axis=0)
            turns = model.rotations(
                np.zeros((len(track), 3)), track[:, 7:], pca=True, flat_hand_mean=False
            )
            finite = np.isfinite(track).all(axis=1)
            turns[~finite] = np.nan
            turns[finite, 0] = poses.rotation_matrices(track[finite, 3:7])
            placed[side] = model.place(turns, shape[side], track[:, :3], tips="smplx")
        return Scene(
            placed,
            (times - times[0]) / 1e9,
            f"hot3d/{headset}",
            (path,),
            world_pose(WORLD_AXES["openxr" if headset == "quest3" else "z_up"]),
            shape,
            things=_things(ref.path, times, options),
            meta={"headset": headset},
        ).clip(ref, "hot3d", self.expects)


def _headset(folder: Path) -> str:
    path = folder / "metadata.json"
    name = str(read_table(path, ("headset",))["headset"])[:40].lower()
    if name not in ("aria", "quest3"):
        raise RecordingError(
            f"{path}: headset must be Aria or Quest3, because it determines which axis points up, "
            f"not {name!r}"
        )
    return name


def _lines(path: Path) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """(T,) times [ns] and the hands at each time, without repeated times."""
    times: list[int] = []
    lines: list[dict[str, Any]] = []
    try:
        if check_plain_file(path) > _MOST_BYTES:
            raise RecordingError(f"{path}: it has more than {_MOST_BYTES} bytes")
        with path.open("rb") as stream:
            number = 0
            while line := stream.readline(_LONGEST_LINE + 1):
                number += 1
                if number > MOST_FRAMES or len(line) > _LONGEST_LINE:
                    raise RecordingError(
                        f"{path}: line {number} is too long, or exceeds {MOST_FRAMES} lines"
                    )
                if not line.strip():
                    continue
                named = f"{path}, line {number}"
                held = table(parse_json(line), named, ("timestamp_ns", "hand_poses"))
                time = held["timestamp_ns"]
                if type(time) is not int or not 0 <= time < 1 << 62:
                    raise RecordingError(f"{named}: timestamp_ns must be a whole number")
                if times and time < times[-1]:
                    raise RecordingError(f"{named}: the times go backwards")
                if not times or time - times[-1] > _TWICE_NS:
                    times.append(time)
                    lines.append(table(held["hand_poses"], f"{named}, hand_poses"))
    except (OSError, DocumentError) as error:
        raise RecordingError(f"{path}: it can't be read: {error}") from error
    return np.array(times, np.int64), lines


def _hand(lines: list[dict[str, Any]], number: str, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """(T, 22) positions, quaternions and 15 coefficients, and (T, 10) shapes; NaN if not seen."""
    rows, betas = np.full((len(lines), 22), np.nan), np.full((len(lines), 10), np.nan)
    for row, beta, held in zip(rows, betas, lines, strict=True):
        if held.get(number) is None:
            continue
        named = f"{path}, hand {number}"
        hand = table(held[number], named, ("pose", "wrist_xform"))
        wrist = table(hand["wrist_xform"], f"{named}, wrist_xform", ("t_xyz", "q_wxyz"))
        row[:3] = array(wrist["t_xyz"], f"{named}, t_xyz", (3,), finite=True)
        turn = array(wrist["q_wxyz"], f"{named}, q_wxyz", (4,), finite=True)
        size = float(np.linalg.norm(turn))
        if not 0.9 < size < 1.1:
            raise RecordingError(f"{named}: q_wxyz must be a unit quaternion w x y z")
        row[3:7] = turn / size
        row[7:] = array(hand["pose"], f"{named}, pose", (15,), finite=True)
        if hand.get("betas") is not None:
            beta[:] = array(hand["betas"], f"{named}, betas", (10,), finite=True)
    return rows, betas


def _things(folder: Path, times: np.ndarray, options: ReadingOptions) -> list[Thing]:
    path = next((folder / name for name in _OBJECTS if (folder / name).is_file()), None)
    if path is None:
        return []
    assets = options.objects or nearby(folder.resolve(), "assets", "object_models")
    names = _names(assets)
    return [
        Thing(
            names.get(uid, uid),
            _nearest(times, np.array(sorted(rows)), rows),
            None if assets is None else assets / f"{uid}.glb",
        )
        for uid, rows in sorted(_rows(path).items())
    ]


def _rows(path: Path) -> dict[str, dict[int, list[float]]]:
    """Poses by object and time [ns]."""
    rows: dict[str, dict[int, list[float]]] = {}
    try:
        reader = csv.reader(io.StringIO(read_text(path, most_bytes=_MOST_TABLE_BYTES)))
        header = next(reader, [])
        missing = [column for column in _COLUMNS if column not in header]
        if missing:
            raise RecordingError(f"{path}: it lacks the column {missing[0]}")
        places = [header.index(column) for column in _COLUMNS]
        for row in reader:
            if not row:
                continue
            uid, time, *values = (row[i] for i in places)
            if not uid.isalnum() or len(uid) > 40 or len(rows) > 1000:
                raise RecordingError(f"{path}: an object_uid is damaged")
            if not time.isdecimal() or len(time) > 18:
                raise RecordingError(f"{path}: a timestamp[ns] is damaged")
            rows.setdefault(uid, {})[int(time)] = [float(value) for value in values]
    except (OSError, DocumentError, csv.Error, LookupError, ValueError) as error:
        if isinstance(error, RecordingError):
            raise
        raise RecordingError(f"{path}: it is damaged: {str(error)[:160]}") from error
    return rows


def _nearest(times: np.ndarray, stamps: np.ndarray, rows: dict[int, list[float]]) -> np.ndarray:
    """(T, 7) poses nearest in time; NaN where no pose is close enough."""
    values = np.array([rows[time] for time in stamps.tolist()])
    after = np.clip(np.searchsorted(stamps, times), 0, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(stamps[before] - times) < np.abs(stamps[after] - times)
    best = np.where(nearer, before, after)
    nearest: np.ndarray = values[best]
    nearest[np.abs(stamps[best] - times) > _NEAR_NS] = np.nan
    return nearest


def _names(assets: Path | None) -> dict[str, str]:
    """Names of objects from ``instance.json``; empty without the file."""
    path = None if assets is None else assets / "instance.json"
    if path is None or not path.is_file():
        return {}
    return {
        uid: entry["instance_name"][:80]
        for uid, entry in read_table(path).items()
        if isinstance(entry, dict) and isinstance(entry.get("instance_name"), str)
    }


HOT3D: Final = Hot3d()
