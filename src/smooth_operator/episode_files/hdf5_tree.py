"""The groups and arrays of an HDF5 file, within bounds; and hands of the EgoDex data set.

A file of EgoDex has 4 x 4 transforms in ARKit's world: the group ``transforms`` with an array
(T, 4, 4) for each joint (``rightHand``, ``rightIndexFingerTip``, ...) and for the camera, and
perhaps ``confidences`` with an array (T,) for each joint. Both hands are in one file; times are
not.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import DocumentError, MissingExtraError, RecordingError, listed
from smooth_operator.formats.arrays import Allowance, damaged
from smooth_operator.formats.checks import check_recording, check_side, stamps_from_rate
from smooth_operator.io.plain_files import check_plain_file
from smooth_operator.landmarks import FROM_WEBXR_25, METACARPALS_WEBXR_25
from smooth_operator.poses import (
    WORLD_AXES,
    WRIST_AXES,
    from_matrices,
    is_rigid,
    points_to_ours,
    to_ours,
)
from smooth_operator.types import HandRecording, Side

_BONES = ("Knuckle", "IntermediateBase", "IntermediateTip", "Tip")
_FINGERS = ("Index", "Middle", "Ring", "Little")
EGODEX_JOINTS = {
    side: (
        f"{side}Hand",
        *(f"{side}Thumb{bone}" for bone in _BONES),
        *(f"{side}{name}Finger{bone}" for name in _FINGERS for bone in ("Metacarpal", *_BONES)),
    )
    for side in ("right", "left")
}
"""Side -> the 25 joints of a hand in EgoDex, in WebXR's order."""

GROUPS = (
    *("hand", "commands", "commands/stages_ms", "state"),
    *("transforms", "confidences", "camera"),
)
ARRAYS = {
    "transforms": (*EGODEX_JOINTS["right"], *EGODEX_JOINTS["left"], "camera"),
    "confidences": EGODEX_JOINTS["right"] + EGODEX_JOINTS["left"],
    "camera": ("intrinsic",),
    "/": ("configuration",),
    "hand": ("landmarks", "stamps", "valid", "metacarpals", "orientations", "T_world_wrist"),
    "commands": (
        *("joint_positions", "joint_names", "stamps", "latency_ms", "status"),
        *("wrist", "wrist_engaged", "wrist_valid"),
        *("arm", "arm_measured", "arm_wrist"),
    ),
    "state": ("joint_positions", "joint_names", "stamps", "actuator_names", "currents", "touch"),
}
"""Of the groups; all arrays of ``stages_ms`` are read."""

_MOST_STAGES = 64
_MOST_NAMES = 100
_MOST_ATTRIBUTES = 100
_MOST_WORDS = 4096
_TEXT_BYTES = 64


@dataclass(frozen=True, eq=False)
class Hdf5Array:
    """An array of a file.

    Attributes:
        name: with its groups.
        shape: its shape.
        kind: kind of its elements in NumPy's letters: ``f``, ``i``, ``u``, ``b``, or another.
        type: the same for a person.
        attributes: texts, numbers and lists of them.
        data: its numbers, None where it holds something else.
        texts: its texts, in one row; None where it holds something else.
    """

    name: str
    shape: tuple[int, ...]
    kind: str
    type: str
    attributes: dict[str, Any]
    data: np.ndarray | None
    texts: list[str | None] | None


@dataclass(frozen=True, eq=False)
class Hdf5Group:
    """A group of a file.

    Attributes:
        name: with those that it is in.
        names: names of its members, the first hundred.
        attributes: texts, numbers and lists of them.
        arrays: those that this package reads.
    """

    name: str
    names: list[str]
    attributes: dict[str, Any]
    arrays: dict[str, Hdf5Array]

    def describe(self) -> str:
        """Content, for messages."""
        return listed(self.names) or "nothing"


def read_tree(path: Path, *, head: bool = False) -> dict[str, Hdf5Group]:
    """The groups that this package reads, by name; the file itself is ``/``.

    Args:
        path: the file.
        head: only the attributes of the file.

    Raises:
        MissingExtraError: h5py is not installed.
        RecordingError: the file is damaged, links to others, or takes more memory than a file of
            its size may.
    """
    h5py = h5py_of()
    try:
        most = Allowance.of(path, check_plain_file(path)).most
    except (OSError, DocumentError) as error:
        raise RecordingError(f"{path}: can't be read: {error}") from error
    try:
        with h5py.File(path, "r", locking=False) as file:
            return dict(_groups(file, most, head, h5py))
    except _RefusedError as error:
        raise RecordingError(
            f"{path}: {error}; save it again with all data inside the file, or as .npz"
        ) from error
    except Exception as error:  # h5py promises no list of what damaged bytes raise
        raise damaged(path, f"HDF5: {str(error)[:300] or type(error).__name__}") from error


class _RefusedError(Exception):
    """The file holds what is not read; the message follows its name."""


def _groups(file: Any, most: int, head: bool, h5py: Any) -> Iterator[tuple[str, Hdf5Group]]:
    """Groups by name. ``most`` is the number of bytes that all arrays may take."""
    left = [most]
    yield "/", _group(file, () if head else ARRAYS["/"], left, h5py)
    groups = {"": file}
    for name in () if head else GROUPS:
        above, _, last = name.rpartition("/")
        if above not in groups or last not in groups[above]:
            continue
        group = _linked(groups[above], last, h5py)
        if isinstance(group, h5py.Group):
            groups[name] = group
            arrays = ARRAYS.get(name) or tuple(_names(group, _MOST_STAGES + 1))
            if len(arrays) > _MOST_STAGES:
                raise _RefusedError(f"its group {name} holds more than {_MOST_STAGES} arrays")
            yield name, _group(group, arrays, left, h5py)


def _group(group: Any, arrays: tuple[str, ...], left: list[int], h5py: Any) -> Hdf5Group:
    held = {}
    for name in arrays:
        if name in group:
            data = _linked(group, name, h5py)
            if isinstance(data, h5py.Dataset):
                held[name] = _array(data, left, h5py)
    return Hdf5Group(group.name, _names(group, _MOST_NAMES), _attributes(group, h5py), held)


def _names(group: Any, most: int) -> list[str]:
    names: list[str] = []
    for name in group:
        if len(names) == most:
            break
        names.append(name)
    return names


def _linked(group: Any, name: str, h5py: Any) -> Any:
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise _RefusedError(f"its {name!r} is a link, and links are not followed")
    return group[name]


def _array(data: Any, left: list[int], h5py: Any) -> Hdf5Array:
    dtype, shape = data.dtype, data.shape  # h5py asks the file each time
    if shape is None:  # an array without a space
        raise _RefusedError(f"its array {data.name} is empty")
    if data.external or data.is_virtual:
        raise _RefusedError(
            f"the data of {data.name} are stored in other files, which are not read"
        )
    words = h5py.check_string_dtype(dtype) is not None
    each = max(dtype.itemsize, _TEXT_BYTES if words else 8)
    takes = max(math.prod(shape), math.prod(data.chunks or ())) * each
    if takes > left[0]:
        raise _RefusedError(
            f"it would take {takes / 1e6:,.0f} MB of memory to read {data.name}, more than is "
            f"allowed for a file of this size ({left[0] / 1e6:,.0f} MB are left)"
        )
    numbers: np.ndarray | None = None
    texts: list[str | None] | None = None
    if words:
        if math.prod(shape) > _MOST_WORDS:
            raise _RefusedError(f"its array {data.name} holds more than {_MOST_WORDS} strings")
        texts = [_text(item) for item in np.ravel(data[()])]
    elif dtype.kind in "fiub":
        kind = {"f": "<f8", "b": "|b1", "i": "<i8", "u": "<i8"}[dtype.kind]
        with np.errstate(all="ignore"):
            numbers = np.ascontiguousarray(data[()], kind)
        left[0] -= numbers.nbytes
    return Hdf5Array(
        data.name, tuple(shape), dtype.kind, str(dtype), _attributes(data, h5py), numbers, texts
    )


def _attributes(item: Any, h5py: Any) -> dict[str, Any]:
    held: dict[str, Any] = {}
    for name in list(item.attrs)[:_MOST_ATTRIBUTES]:
        with contextlib.suppress(KeyError):
            about = item.attrs.get_id(name)
            count = math.prod(about.shape)
            if count > _MOST_WORDS or count * about.dtype.itemsize > 1 << 20:
                continue
            value = item.attrs[name]
            if isinstance(value, h5py.Empty):
                continue
            flat = [_plain(x) for x in np.ravel(np.asarray(value, object)).tolist()]
            held[name] = flat if np.ndim(value) else flat[0]
    return held


def _plain(value: Any) -> Any:
    value = value.item() if hasattr(value, "item") else value  # of NumPy
    return value if isinstance(value, bool | int | float) else _text(value)


def _text(value: Any) -> str | None:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else None


def h5py_of() -> Any:
    """The module ``h5py``.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("an HDF5 file", "hdf5") from error
    return h5py


WORLD: Final = "egodex"
RATE_HZ: Final = 30.0
"""Frames a second of the data set, which its files do not say."""

_AXES: Final = WORLD_AXES["openxr"]
_WRISTS: Final[Mapping[Side, Float[np.ndarray, "3 3"]]] = {
    "right": WRIST_AXES["arkit_right"],
    "left": WRIST_AXES["arkit_left"],
}


def read_egodex(
    tree: Mapping[str, Hdf5Group], path: Path, rate: float | None, side: Side | None
) -> HandRecording:
    """One hand of a file, its wrist and landmarks in a z-up world.

    Args:
        tree: the file's groups.
        path: the file, for messages.
        rate: frames a second [Hz]; the data set has 30.
        side: side of the hand; the right one if left out.

    Raises:
        RecordingError: joints are missing or have another shape; there is no rate.
    """
    label, assumed = check_side([], side, str(path))
    recording = egodex_hand(tree, path, rate, label)
    recording.meta["side_assumed"] = assumed
    check_recording(recording, str(path))
    return recording


def egodex_hand(
    tree: Mapping[str, Hdf5Group], path: Path, rate: float | None, side: Side
) -> HandRecording:
    """The same before units and stamps are checked; joints that ARKit lost or are no poses are NaN.

    Raises:
        RecordingError: as ``read_egodex``.
    """
    names = EGODEX_JOINTS[side]
    joints = np.stack([egodex_transforms(tree, name, path) for name in names], axis=1)
    with np.errstate(all="ignore"):  # of numbers beyond any transform
        volume = np.linalg.det(joints[..., :3, :3])  # 1 of a rotation; mirrored ones have -1
    valid = np.isfinite(joints).all(axis=(2, 3)) & (volume > 0.5) & (volume < 2.0)
    sure = egodex_confidences(tree, side, len(joints))
    if sure is not None:
        valid &= ~(sure <= 0.0)  # NaN: the file does not say
    joints[~valid] = np.nan
    points = points_to_ours(joints[..., :3, 3], _AXES)
    return HandRecording(
        points[:, FROM_WEBXR_25],
        stamps_from_rate(len(points), rate, str(path)),
        side,
        metacarpals=points[:, METACARPALS_WEBXR_25],
        name=path.stem,
        meta={"format": "egodex"},
        T_world_wrist=to_ours(_poses(joints[:, 0]), _AXES, _WRISTS[side]),
        world=WORLD,
    )


def egodex_camera(tree: Mapping[str, Hdf5Group], path: Path) -> Float[np.ndarray, "T 7"] | None:
    """(T, 7) poses of the camera in the same world, x right, y down, z into the picture.

    Its axes in the file are those already: the inverse of ``transforms/camera`` and the 3 x 3
    ``camera/intrinsic`` project joints to pixels. None if it is not there.

    Raises:
        RecordingError: it has another shape.
    """
    if "camera" not in tree["transforms"].arrays:
        return None
    return to_ours(_poses(egodex_transforms(tree, "camera", path)), _AXES, np.eye(3))


def egodex_confidences(
    tree: Mapping[str, Hdf5Group], side: Side, count: int
) -> Float[np.ndarray, "T 25"] | None:
    """Confidence of ARKit in each joint, 0 to 1; NaN for a joint without; None without any."""
    group = tree.get("confidences")
    held = {} if group is None else group.arrays
    sure = np.full((count, len(EGODEX_JOINTS[side])), np.nan)
    for column, name in enumerate(EGODEX_JOINTS[side]):
        stored = held.get(name)
        if stored is not None and stored.data is not None and stored.shape == (count,):
            sure[:, column] = stored.data
    return None if np.isnan(sure).all() else sure


def egodex_transforms(
    tree: Mapping[str, Hdf5Group], name: str, path: Path
) -> Float[np.ndarray, "T 4 4"]:
    """The transforms of a joint or of the camera, as they are in the file.

    Raises:
        RecordingError: there are none, or another number than of the other joints.
    """
    group = tree["transforms"]
    first = next((n for pair in EGODEX_JOINTS.values() for n in pair if n in group.arrays), name)
    stored, example = group.arrays.get(name), group.arrays.get(first)
    count = example.shape[0] if example is not None and example.shape else 0
    if stored is None or stored.data is None or stored.shape != (count, 4, 4):
        what = "nothing" if stored is None else f"{stored.type[:80]} {stored.shape}"
        raise RecordingError(
            f"{path}: a file of EgoDex has {group.name}/{name} with numbers of shape "
            f"(frames, 4, 4); this one has {what}"
        )
    return stored.data.astype(np.float64)


def _poses(matrices: Float[np.ndarray, "T 4 4"]) -> Float[np.ndarray, "T 7"]:
    """NaN where a matrix is no rigid transform."""
    good = is_rigid(matrices)
    poses = np.full((len(matrices), 7), np.nan)
    poses[good] = from_matrices(matrices[good])
    return poses
