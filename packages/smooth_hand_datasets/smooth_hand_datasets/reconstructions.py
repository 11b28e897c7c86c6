"""Readers of hands and cameras that HaWoR and Dyn-HaMR reconstruct in one world from a video.

Both write MANO parameters, so the user's model files are needed. Angles are those of HaMeR's
models: axis times angle of each joint from the flat hand, with the fingertips of smplx.

- HaWoR, in the folder named as the video: ``world_space_res.pth``, a list of translations
  (2, T, 3) [m], rotations (2, T, 3), poses (2, T, 45), shapes (2, T, 10) and flags (2, T), the left
  hand first; ``SLAM/hawor_slam_w_scale_*.npz``: ``traj`` (T, 7), x y z and quaternion x y z w of
  the camera, and ``scale``, which converts x y z to metres. The sign of the left model's shape
  directions is corrected.
- Dyn-HaMR: ``*_world_results.npz`` with ``trans`` (B, T, 3), ``root_orient`` (B, T, 3),
  ``pose_body`` (B, T, 15, 3), ``betas`` (B, 10) and ``is_right`` (B, T) of each track, and the
  camera as ``cam_R`` (B, T, 3, 3) and ``cam_t`` (B, T, 3), world to camera. Left hands use the
  right model and are mirrored in x after they are placed.

The world is that of the camera tracking: its axes are those of the first camera, not upright.

Source: ``hawor_video.py``, ``hawor/utils/process.py`` and ``lib/eval_utils/custom_utils.py`` of
ThunderVVV/HaWoR; programs that read Dyn-HaMR's results (Dyn-HaMR's own export to OpenXR joints).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, Literal

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.mano_model import ManoModel, PlacedHand, load_model
from smooth_hand_datasets.scene import wrist_of_points
from smooth_hand_datasets.unpickle import array, load_restricted
from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.formats.arrays import StoredArrays, npz_arrays, open_arrays
from smooth_operator.formats.both_hands import checked_hands, first_video
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.formats.clip import SIDES, Clip, ClipRef, ReadingOptions
from smooth_operator.types import HandRecording, Side, unit_poses

_SIDE_OF: Final[tuple[Side, Side]] = ("left", "right")
"""Sides along the first axis of HaWoR's arrays."""
_PARTS: Final = ("trans", "root_orient", "pose_body", "betas", "is_right")
_MIRROR: Final = np.array([-1.0, 1.0, 1.0])


class Hawor:
    """Reader of HaWoR's results; each file is one clip."""

    what = "world_space_res.pth of HaWoR"
    expects = (
        "world_space_res.pth, a list of translations (2, T, 3), rotations (2, T, 3), poses "
        "(2, T, 45), shapes (2, T, 10) and flags (2, T), and SLAM/hawor_slam_w_scale_*.npz"
    )

    def matches(self, path: Path) -> bool:
        """True if a path is the file of that name, or the folder that contains it."""
        return _world_file(path).is_file()

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """List the file, with the name of its folder, which is that of the video."""
        file = _world_file(path)
        yield ClipRef(file.parent.name or file.stem, file, layout="hawor", size=file.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands and the camera in one world; frames that are not flagged are NaN.

        Raises:
            RecordingError: parts are missing or have another shape; there is no rate, or there are
                no model files of MANO.
        """
        path = ref.path
        parts = load_restricted(path)
        if not isinstance(parts, list | tuple) or len(parts) != 5:
            raise RecordingError(f"{path}: expected {self.expects}")
        trans = array(parts[0], f"{path}, translations", (2, None, 3))
        count = trans.shape[1]
        rotations = array(parts[1], f"{path}, rotations", (2, count, 3))
        fingers = array(parts[2], f"{path}, poses", (2, count, 45))
        betas = array(parts[3], f"{path}, shapes", (2, count, 10))
        flags = array(parts[4], f"{path}, flags", (2, count)) > 0.5
        stamps = stamps_from_rate(count, options.rate, str(path))
        hands: dict[Side, HandRecording] = {}
        shape: dict[Side, np.ndarray] = {}
        for row, side in enumerate(_SIDE_OF):
            valid = flags[row] & np.isfinite(betas[row]).all(axis=1)
            if not valid.any():
                continue
            model = load_model(options.mano, side, mirrored_shape=True)
            placed = _placed(model, rotations[row], fingers[row], betas[row], trans[row])
            hands[side] = _recording(placed, side, stamps, "hawor", valid)
            shape[side] = np.median(betas[row][valid], axis=0)
        checked = checked_hands(hands, str(path), self.expects)
        slam = next(iter(sorted(path.parent.glob("SLAM/hawor_slam_w_scale_*.npz"))), None)
        video = first_video(path.parent.parent / f"{path.parent.name}.mp4")
        source = [path, *(one for one in (slam, video) if one is not None)]
        return Clip(
            ref.name,
            checked,
            "hawor",
            tuple(source),
            T_world_camera=None if slam is None else _slam_camera(slam, count),
            shape={side: shape[side] for side in checked},
            video=video,
        )


class DynHamr:
    """Reader of Dyn-HaMR's results; each file is one clip."""

    what = "a *_world_results.npz of Dyn-HaMR"
    expects = (
        "an .npz with trans (B, T, 3), root_orient (B, T, 3), pose_body (B, T, 15, 3), betas "
        "(B, 10) and is_right (B, T)"
    )

    def matches(self, path: Path) -> bool:
        """True if a path is an ``.npz`` file with Dyn-HaMR's arrays."""
        return set(_PARTS) <= npz_arrays(path).keys()

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """Yields the file as one clip."""
        name = path.stem.removesuffix("_world_results")
        yield ClipRef(name, path, layout="dynhamr", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the first track of each side, and the camera, in one world.

        Raises:
            RecordingError: parts are missing or have another shape; a track changes its side; there
                is no rate, or there are no model files of MANO.
        """
        path, arrays = ref.path, open_arrays(ref.path)
        missing = [name for name in _PARTS if name not in arrays]
        if missing:
            raise RecordingError(
                f"{path}: it lacks {', '.join(missing)}; it holds {arrays.describe()}; expected "
                f"{self.expects}"
            )
        trans = _part(arrays, "trans", (None, None, 3))
        tracks, count = trans.shape[:2]
        rotations = _part(arrays, "root_orient", (tracks, count, 3))
        fingers = _part(arrays, "pose_body", (tracks, count, 15, 3)).reshape(tracks, count, 45)
        betas = _part(arrays, "betas", (tracks, 10))
        first = _first_tracks(_part(arrays, "is_right", (tracks, count)), path)
        stamps = stamps_from_rate(count, options.rate, str(path))
        hands: dict[Side, HandRecording] = {}
        for side, row in first.items():
            model = load_model(options.mano, "right")
            placed = _placed(model, rotations[row], fingers[row], betas[row], trans[row])
            if side == "left":
                points = placed.landmarks * _MIRROR
                placed = PlacedHand(points, wrist_of_points(points, side))
            hands[side] = _recording(placed, side, stamps, "dynhamr")
        checked = checked_hands(hands, str(path), self.expects)
        return Clip(
            ref.name,
            checked,
            "dynhamr",
            (path,),
            T_world_camera=_camera(arrays, tracks, count),
            shape={side: betas[first[side]] for side in checked},
            meta={"more_tracks": tracks - len(first)} if tracks > len(first) else {},
        )


def _placed(
    model: ManoModel,
    rotations: np.ndarray,
    fingers: np.ndarray,
    betas: np.ndarray,
    trans: np.ndarray,
) -> PlacedHand:
    with np.errstate(all="ignore"):  # of impossible numbers, which are refused later
        turned = model.rotations(rotations, fingers, flat_hand_mean=True)
        return model.place(turned, betas, trans, tips="smplx")


def _recording(
    placed: PlacedHand,
    side: Side,
    stamps: np.ndarray,
    world: Literal["hawor", "dynhamr"],
    valid: np.ndarray | None = None,
) -> HandRecording:
    points, wrist = placed.landmarks.copy(), placed.T_world_wrist.copy()
    if valid is not None:
        points[~valid], wrist[~valid] = np.nan, np.nan
    return HandRecording(
        points, stamps, side, meta={"format": world}, T_world_wrist=wrist, world=world
    )


def _slam_camera(path: Path, count: int) -> Float[np.ndarray, "T 7"] | None:
    """The camera's path; None if the file has keyframes only."""
    arrays = open_arrays(path)
    for name in ("traj", "scale"):
        if name not in arrays:
            raise RecordingError(f"{path}: it lacks {name}; it holds {arrays.describe()}")
    camera = _part(arrays, "traj", (None, 7))
    scale = np.ravel(arrays["scale"].numbers())
    if len(scale) != 1 or not scale[0] > 0 or not np.isfinite(scale[0]):
        raise RecordingError(f"{path}: scale must be one positive number")
    if len(camera) != count:
        return None
    return unit_poses(np.concatenate([camera[:, :3] * scale[0], camera[:, [6, 3, 4, 5]]], axis=1))


def _first_tracks(right: Float[np.ndarray, "B T"], path: Path) -> Mapping[Side, int]:
    """Index of the first track of each side."""
    first: dict[Side, int] = {}
    for row, flags in enumerate(right):
        if not np.isin(flags, (0.0, 1.0)).all() or len(np.unique(flags)) != 1:
            raise RecordingError(
                f"{path}: is_right of track {row} must be 0 or 1, the same in all frames"
            )
        first.setdefault("right" if flags[0] else "left", row)
    return {side: first[side] for side in SIDES if side in first}


def _camera(arrays: StoredArrays, tracks: int, count: int) -> Float[np.ndarray, "T 7"] | None:
    """Pose of the camera in the world. It is the same for all tracks, so it is read from the
    first."""
    if "cam_R" not in arrays or "cam_t" not in arrays or not tracks:
        return None
    to_camera = np.tile(np.eye(4), (count, 1, 1))
    to_camera[:, :3, :3] = _part(arrays, "cam_R", (tracks, count, 3, 3))[0]
    to_camera[:, :3, 3] = _part(arrays, "cam_t", (tracks, count, 3))[0]
    good = poses.is_rigid(to_camera)
    camera = np.full((count, 7), np.nan)
    camera[good] = poses.invert(poses.from_matrices(to_camera[good]))
    return camera


def _part(arrays: StoredArrays, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    return array(arrays[name].numbers(), f"{arrays.path}, {name}", shape)


def _world_file(path: Path) -> Path:
    return path if path.name == "world_space_res.pth" else path / "world_space_res.pth"


HAWOR: Final = Hawor()
DYN_HAMR: Final = DynHamr()
