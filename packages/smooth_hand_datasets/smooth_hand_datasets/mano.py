"""Reader of MANO parameters in the forms of smplx, manopth and HaMeR, from ``.npz`` or pickle
files.

A file contains one hand, with its side, or two hands: in tables ``right`` and ``left``, or with
names that begin with ``right_`` and ``left_``. It must state what the numbers do not show: whether
zeros mean the flat hand (``flat_hand_mean``), and whether the numbers are coefficients of principal
components (``use_pca``). ``docs/reference/data-sets.md`` lists the names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.mano_model import PlacedHand, load_model
from smooth_hand_datasets.scene import Scene, checked_count, world_pose
from smooth_hand_datasets.unpickle import NotDataError, array, load_restricted, numbers, table, text
from smooth_operator import poses
from smooth_operator.errors import ConfigError, RecordingError, listed
from smooth_operator.formats.arrays import npz_arrays
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.formats.clip import CAMERA, SIDES, Clip, ClipRef, ReadingOptions
from smooth_operator.formats.foreign import body_parameters
from smooth_operator.formats.hand_arrays import shares
from smooth_operator.poses import WORLD_AXES
from smooth_operator.types import Side, as_side

_ROOT: Final = ("global_orient", "root_orient", "rot")
_POSE: Final = ("hand_pose", "pose")
_WHOLE: Final = ("poses", "mano_pose", "theta", "thetas")
_SHAPE: Final = ("betas", "shape", "mano_shape")
_PLACE: Final = ("transl", "trans", "translation", "pred_cam_t_full")
_HAND: Final = (*_ROOT, *_POSE, *_WHOLE, *_SHAPE, *_PLACE, "valid", "confidence")
_SIDE: Final = ("side", "is_right", "is_rhand")
_ABOUT: Final = (
    *(*_SIDE, "flat_hand_mean", "use_pca", "mirrored", "center_idx"),
    *("fps", "framerate", "timestamps", "world", "task"),
)
_WORLDS: Final = ("z_up", "openxr", "z_up_y_forward")
_HEAD_BYTES: Final = 4 << 20
_RIGID: Final = 0.02


class Mano:
    """Reader of files with MANO parameters."""

    generic = True  # other layouts have such names, too, so it is asked after them
    what = "parameters of MANO"
    expects = (
        "for each hand global_orient (T, 3), hand_pose (T, 45), betas (10,) and transl (T, 3), or "
        "the rotations as matrices; side, flat_hand_mean, use_pca; fps or timestamps"
    )

    def matches(self, path: Path) -> bool:
        """True if a file has the names of a pose and a shape."""
        if not path.is_file():
            return False
        if path.suffix.lower() == ".npz":
            arrays = npz_arrays(path)
            bare = {name.removeprefix("right_").removeprefix("left_") for name in arrays}
            tables = [arrays[side] for side in SIDES if side in arrays]
            return _complete(bare) or any(one.dtype.hasobject for one in tables)
        if path.suffix not in (".pkl", ".pickle"):
            return False
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
        return b"shapedirs" not in head and _complete(
            {name for name in _HAND if name.encode() in head}
        )

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """List the file."""
        yield ClipRef(path.stem, path, layout="mano", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands."""
        where = str(ref.path)
        names = {f"{start}{name}" for start in ("", "right_", "left_") for name in _HAND}
        names |= {f"{start}{name}" for start in ("", "right_", "left_") for name in _ABOUT}
        held = table(load_restricted(ref.path, names=sorted({*names, *SIDES})), where)
        parameters = {
            side: _parameters(part, where, side) for side, part in _parts(held, where, options.side)
        }
        count = checked_count(
            {f"{side} hand": len(one.rotations_or_pose) for side, one in parameters.items()}, where
        )
        placed = {side: one.placed(options.mano, side) for side, one in parameters.items()}
        world, axes = _world(held, where)
        return Scene(
            placed,
            _stamps(held, count, options, where),
            world,
            (ref.path,),
            world_pose(axes),
            {side: np.median(one.betas, axis=0) for side, one in parameters.items()},
            task=text(held.get("task"), 1000),
            confidence={
                side: one.confidence
                for side, one in parameters.items()
                if one.confidence is not None
            },
        ).clip(ref, "mano", self.expects)


def _complete(names: set[str]) -> bool:
    pose = names & set(_WHOLE) or (names & set(_ROOT) and names & set(_POSE))
    return bool(pose and names & set(_SHAPE))


def _parts(
    held: dict[Any, Any], where: str, side: Side | None
) -> Iterator[tuple[Side, dict[str, Any]]]:
    """Yields the parameters of each hand, including those that the file has for both hands.

    Args:
        side: side of the hand, for a file with one hand that does not state its side.
    """
    body = body_parameters({"poses": getattr(held.get("poses"), "shape", ())})
    if body is not None:
        raise RecordingError(f"{where}: these are {body}")
    about = {key: held[key] for key in _ABOUT if key in held and key not in _SIDE}
    two = False
    for each in SIDES:
        own = {
            key.removeprefix(f"{each}_"): value
            for key, value in held.items()
            if isinstance(key, str) and key.startswith(f"{each}_")
        }
        if held.get(each) is not None:
            own |= table(held[each], f"{where}, {each}")
        if own:
            two = True
            yield each, {**about, **own}
    if two:
        return
    labels = [held[key] for key in _SIDE if key in held]
    if not labels and side is None:
        raise RecordingError(
            f"{where}: it does not say which hand it is; use --side right or --side left, or save "
            "side in the file, or save both hands with names that begin with right_ and left_"
        )
    yield (
        _side(labels[0], where) if labels else side or "right",
        {key: value for key, value in held.items() if key in _HAND} | about,
    )


def _side(label: Any, where: str) -> Side:
    label_text = text(label)
    try:
        if label_text is not None:
            return as_side(label_text)
    except ConfigError as error:
        raise RecordingError(f"{where}: {error}") from error
    flags = _numbers(label, where).ravel()
    if not len(flags) or (flags != flags[0]).any() or flags[0] not in (0.0, 1.0):
        raise RecordingError(f"{where}: is_right must be 1 or 0, the same in all frames")
    return "right" if flags[0] else "left"


@dataclass(frozen=True, eq=False)
class _Parameters:
    rotations_or_pose: np.ndarray
    root: np.ndarray
    betas: Float[np.ndarray, "n 10"]
    translation: Float[np.ndarray, "T 3"]
    pca: bool
    flat: bool
    mirrored: bool
    about_wrist: bool
    confidence: np.ndarray | None

    def placed(self, folder: Path | None, side: Side) -> PlacedHand:
        """Places the hand. A left hand in a mirrored image is a right hand, so it is mirrored
        back."""
        mirrored = self.mirrored and side == "left"
        model = load_model(folder, "right" if mirrored else side)
        if self.rotations_or_pose.ndim == 4:
            turns = np.concatenate([self.root[:, None], self.rotations_or_pose], axis=1)
        else:
            turns = model.rotations(
                self.root, self.rotations_or_pose, pca=self.pca, flat_hand_mean=self.flat
            )
        moves: Any = "wrist" if self.about_wrist else "model"
        if not mirrored:
            return model.place(turns, self.betas, self.translation, moves=moves)
        placed_hand = model.place(turns, self.betas, np.zeros_like(self.translation), moves=moves)
        points = placed_hand.landmarks * np.array([-1.0, 1.0, 1.0]) + self.translation[:, None]
        with np.errstate(all="ignore"):  # impossible points, which are refused later
            return PlacedHand(points, poses.wrist_from_landmarks(points, side))


def _parameters(part: Mapping[str, Any], where: str, side: Side) -> _Parameters:
    label = f"{where}, {side} hand"
    root, pose = _pose(part, label)
    count = len(pose)
    betas = _first(part, _SHAPE, label)
    betas = betas[None] if betas.ndim == 1 else betas
    betas = array(betas[..., :10], f"{label}, betas", (None, 10), finite=True)
    at = array(_first(part, _PLACE, label), f"{label}, transl", (None, 3))
    rows = {"hand_pose": count, "global_orient": len(root), "transl": len(at)}
    rows |= {} if len(betas) == 1 else {"betas": len(betas)}
    checked_count(rows, label)
    confidence = None
    if part.get("confidence") is not None:
        confidence = shares(array(part["confidence"], f"{label}, confidence", (count,)), label)
    if part.get("valid") is not None:
        valid = array(part["valid"], f"{label}, valid", (count,), finite=True) != 0
        at = np.where(valid[:, None], at, np.nan)
    matrices = pose.ndim == 4
    pca = False if matrices else _flag(part, "use_pca", label, default=pose.shape[1] != 45)
    if not matrices and not pca and pose.shape[1] != 45:
        raise RecordingError(
            f"{label}: hand_pose has {pose.shape[1]} numbers; without use_pca, it needs 45"
        )
    if not matrices and pca and part.get("use_pca") is None:
        raise RecordingError(
            f"{label}: hand_pose has {pose.shape[1]} numbers; if they are coefficients of "
            "principal components, set use_pca = True"
        )
    if not matrices and part.get("flat_hand_mean") is None:
        raise RecordingError(
            f"{label}: it does not say whether zeros mean the flat hand: add flat_hand_mean, "
            "True or False as passed to smplx (default False) or manopth (default True)"
        )
    flat = True if matrices else _flag(part, "flat_hand_mean", label, default=True)
    centre = part.get("center_idx")
    about_wrist = centre is not None and bool(_scalar(centre, f"{label}, center_idx") == 0)
    mirrored = _flag(part, "mirrored", label, default=False)
    return _Parameters(pose, root, betas, at, pca, flat, mirrored, about_wrist, confidence)


def _pose(part: Mapping[str, Any], label: str) -> tuple[np.ndarray, np.ndarray]:
    """Reads root and fingers: both as axis times angle or coefficients, or both as matrices."""
    whole = next((part[key] for key in _WHOLE if part.get(key) is not None), None)
    if whole is not None:
        rows = array(whole, f"{label}, poses", (None, 48))
        return rows[:, :3], rows[:, 3:]
    root, pose = _first(part, _ROOT, label), _first(part, _POSE, label)
    if pose.ndim >= 4 or pose.shape[1:] == (15, 9):
        pose = array(pose.reshape(len(pose), -1), f"{label}, hand_pose", (None, 135))
        root = array(root.reshape(len(root), -1), f"{label}, global_orient", (None, 9))
        root, pose = root.reshape(-1, 3, 3), pose.reshape(-1, 15, 3, 3)
        for name, turns in (("global_orient", root), ("hand_pose", pose)):
            _check_turns(turns.reshape(-1, 3, 3), f"{label}, {name}")
        return root, pose
    if pose.ndim == 3:
        pose = array(pose, f"{label}, hand_pose", (None, 15, 3)).reshape(-1, 45)
    pose = array(pose, f"{label}, hand_pose", (None, None))
    if not 0 < pose.shape[1] <= 45:
        raise RecordingError(
            f"{label}: hand_pose has {pose.shape[1]} numbers per frame, not 1 to 45"
        )
    return array(root.reshape(len(root), -1), f"{label}, global_orient", (None, 3)), pose


def _check_turns(turns: np.ndarray, label: str) -> None:
    finite = turns[np.isfinite(turns).all(axis=(1, 2))]
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(finite @ np.swapaxes(finite, 1, 2) - np.eye(3)) > _RIGID
        if off.any() or (np.linalg.det(finite) < 0).any():
            raise RecordingError(f"{label}: it has matrices that are not rotations")


def _first(part: Mapping[str, Any], names: tuple[str, ...], label: str) -> np.ndarray:
    value = next((part[name] for name in names if part.get(name) is not None), None)
    if value is None:
        have = listed(sorted(str(key)[:40] for key in part))
        raise RecordingError(f"{label}: it lacks {names[0]}; it has {have or 'nothing'}")
    rows = _numbers(value, f"{label}, {names[0]}")
    if rows.ndim == 0:
        raise RecordingError(f"{label}: {names[0]} is one number")
    return rows


def _numbers(value: Any, label: str) -> np.ndarray:
    try:
        return numbers(value)
    except NotDataError as error:
        raise RecordingError(f"{label}: {error}") from error


def _scalar(value: Any, label: str) -> float:
    values = _numbers(value, label).ravel()
    if len(values) != 1 or not np.isfinite(values[0]):
        raise RecordingError(f"{label}: it must be one number")
    return float(values[0])


def _flag(part: Mapping[str, Any], name: str, label: str, *, default: bool) -> bool:
    if part.get(name) is None:
        return default
    value = _scalar(part[name], f"{label}, {name}")
    if value not in (0.0, 1.0):
        raise RecordingError(f"{label}: {name} must be True or False")
    return bool(value)


def _world(held: Mapping[str, Any], where: str) -> tuple[str, np.ndarray]:
    world = text(held.get("world"))
    if world is None:
        return "mano/unstated", WORLD_AXES["z_up"]
    if world == CAMERA:
        return CAMERA, WORLD_AXES["z_up"]
    if world not in _WORLDS:
        raise RecordingError(f"{where}: world must be {CAMERA} or one of {listed(_WORLDS)}")
    return f"mano/{world}", WORLD_AXES[world]


def _stamps(
    held: Mapping[str, Any], count: int, options: ReadingOptions, where: str
) -> Float[np.ndarray, " T"]:
    if held.get("timestamps") is not None:
        return array(held["timestamps"], f"{where}, timestamps", (count,), finite=True)
    rate = options.rate
    for name in ("fps", "framerate"):
        if rate is None and held.get(name) is not None:
            rate = _scalar(held[name], f"{where}, {name}")
    try:
        return stamps_from_rate(count, rate, where)
    except ConfigError as error:
        raise RecordingError(f"{where}: {error}") from error


MANO: Final = Mano()
