"""HO-3D (versions 2 and 3) and H2O-3D: hands and one object, a pickle for each frame.

Source: Hampali et al., *HOnnotate*, CVPR 2020, and *Keypoint Transformer*, CVPR 2022;
https://github.com/shreyashampali/ho3d. A folder of a sequence has ``meta/0000.pkl``, ... in the
camera frame of OpenGL: y up, z backward.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_hand_datasets.mano_model import from_axis_angle, load_model
from smooth_hand_datasets.scene import Scene, Thing, checked_count, world_pose
from smooth_hand_datasets.unpickle import array, load_restricted, table, text
from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.formats.clip import CAMERA, Clip, ClipRef, ReadingOptions
from smooth_operator.types import Side

RATE_HZ: Final = 30.0
_OTHERS: Final = ("calibration", "manual_annotations")
_FRAME: Final = re.compile(r"(\d{1,6})\.pkl")
_TO_CAMERA: Final = world_pose(poses.axes("x", "-y", "-z"))
_HANDS: Final[dict[str, Side]] = {
    "handPose": "right",
    "rightHandPose": "right",
    "leftHandPose": "left",
}


class Ho3d:
    """Reader of HO-3D's sequences, folders with ``train/SEQUENCE/meta/0000.pkl``."""

    what = "a sequence of HO-3D or H2O-3D"
    expects = (
        "meta/NUMBER.pkl with handPose (48,), handTrans (3,), handBeta (10,), objRot, objTrans and "
        "objName; for two hands rightHandPose, leftHandPose, ..."
    )

    def matches(self, path: Path) -> bool:
        """True if a path is a folder with numbered pickles in ``meta``, or next to such folders."""
        if path.name in _OTHERS and (path.parent / "train").is_dir():
            return True
        folder = path / "meta"
        return folder.is_dir() and next(_frames(folder), None) is not None

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """List the sequence; yields nothing for the other folders."""
        if path.name in _OTHERS:
            return
        yield ClipRef(
            path.resolve().name, path, layout="ho3d", size=sum(1 for _ in _frames(path / "meta"))
        )

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands and the object in the frame of the camera."""
        files = sorted(_frames(ref.path / "meta"))
        checked_count({"meta": len(files)}, str(ref.path))
        frames = [table(load_restricted(file), str(file)) for _, file in files]
        keys = [key for key in _HANDS if any(key in frame for frame in frames)]
        if not keys:
            raise RecordingError(
                f"{ref.path}: no frame has handPose; the published evaluation split has "
                "no poses of hands"
            )
        placed, shapes = {}, {}
        for key in keys:
            side = _HANDS[key]
            before = key.removesuffix("Pose")
            pose = _rows(frames, files, key, 48)
            at = _rows(frames, files, f"{before}Trans", 3)
            beta = _rows(frames, files, "handBeta", 10)
            finite = np.isfinite(np.concatenate([pose, at, beta], axis=1)).all(axis=1)
            if not finite.any():
                continue
            shapes[side] = np.median(beta[finite], axis=0)
            beta[~finite] = 0.0
            model = load_model(options.mano, side)
            turns = from_axis_angle(pose.reshape(-1, 16, 3))
            placed[side] = model.place(turns, beta, at, tips="smplx")
        numbers = np.array([number for number, _ in files])
        thing = _object(frames, files, options, ref.path)
        return Scene(
            placed,
            (numbers - numbers[0]) / (options.rate or RATE_HZ),
            CAMERA,
            (ref.path, *[file for _, file in files[:1]]),
            _TO_CAMERA,
            shapes,
            things=[thing] if thing else [],
        ).clip(ref, "ho3d", self.expects)


def _frames(folder: Path) -> Iterator[tuple[int, Path]]:
    for file in folder.iterdir():
        match = _FRAME.fullmatch(file.name)
        if match:
            yield int(match[1]), file


def _rows(
    frames: list[dict[Any, Any]], files: list[tuple[int, Path]], key: str, count: int
) -> np.ndarray:
    """(T, count) values of a key; NaN where a frame has None, which means no annotation."""
    rows = np.full((len(frames), count), np.nan)
    for row, frame, (_, file) in zip(rows, frames, files, strict=True):
        if key not in frame:
            raise RecordingError(f"{file}: it lacks {key}, which other frames have")
        if frame[key] is not None:
            row[:] = array(frame[key], f"{file}, {key}", (count,))
    return rows


def _object(
    frames: list[dict[Any, Any]],
    files: list[tuple[int, Path]],
    options: ReadingOptions,
    folder: Path,
) -> Thing | None:
    names = {text(frame.get("objName")) for frame in frames} - {None}
    if not names:
        return None
    if len(names) > 1:
        raise RecordingError(f"{folder}: its frames name different objects in objName")
    name = str(names.pop())
    track = np.full((len(frames), 7), np.nan)
    for row, frame, (_, file) in zip(track, frames, files, strict=True):
        if frame.get("objRot") is None or frame.get("objTrans") is None:
            continue
        turn = _column(frame["objRot"], f"{file}, objRot")
        row[:3] = array(frame["objTrans"], f"{file}, objTrans", (3,))
        row[3:] = poses.from_rotation_vectors(turn)
    mesh = None
    if options.objects is not None:
        mesh = options.objects / Path(name).name / "textured_simple.obj"
    return Thing(name, track, mesh)


def _column(value: Any, where: str) -> np.ndarray:
    """Reads a rotation of shape (3,) or (3, 1) as (3,)."""
    try:
        return array(value, where, (3, 1))[:, 0]
    except RecordingError:
        return array(value, where, (3,))


HO3D: Final = Ho3d()
