"""Reads recordings of hands: MANUS gloves, plain landmark arrays, and the project's own log."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError, brief, listed
from smooth_operator.formats.arrays import PICKLE_REMEDY, StoredArray, StoredArrays, open_arrays
from smooth_operator.formats.checks import check_side, stamps_from_rate
from smooth_operator.formats.clip import Clip, ClipRef, ReadingOptions
from smooth_operator.formats.commands import only_commands
from smooth_operator.formats.foreign import body_parameters
from smooth_operator.formats.hand_arrays import (
    own_stamps,
    pose_rows,
    quaternion_order,
    unread_flags,
    validity,
)
from smooth_operator.formats.registry import (
    file_kind,
    named_as_recording,
    readable,
    recording_format,
)
from smooth_operator.io.landmark_order import in_our_order, layout_order
from smooth_operator.landmarks import NODE_LAYOUTS
from smooth_operator.types import HandRecording, Side, as_side

LANDMARK_STAMPS = "landmark_timestamps"
"""Array of frame timestamps in a file whose ``timestamps`` are those of commands."""

_STAMP_KEYS = (LANDMARK_STAMPS, "timestamps", "stamps")
_SIDE_KEYS = ("chirality", "side")
_SIDE_OF: Final[dict[str, Side]] = {
    "right_fingers": "right",
    "left_fingers": "left",
    "right": "right",
    "left": "left",
}
"""Names of landmark arrays that contain the side."""


def read_recording(
    path: str | os.PathLike[str],
    *,
    rate: float | None = None,
    side: Side | None = None,
    layout: str | None = None,
) -> HandRecording:
    """Reads a recording of one hand.

    The format is recognised by the first bytes of the file (for some plugins, by its suffix). These
    formats can be read:

    - a MANUS ``.npz``: ``data`` (T, 25, 7) px py pz [m] and a quaternion, ``timestamps`` (T,) [s],
      ``keypoint_ids`` (25,), ``chirality``, ``quaternion_order``;
    - a ``.npy`` of shape (T, 21, 3) [m], or an ``.npz`` that holds one, named ``joints`` or
      ``landmarks`` or its only 3-D array, optionally with ``timestamps`` or ``stamps`` (T,) [s]
      and ``side`` or ``chirality``. 25 nodes (MANUS, WebXR), 26 (OpenXR) and 27 (WebXR's and two of
      the forearm) are mapped to the 21 landmarks; a single frame (21, 3) is a recording of one. 4 x
      4 transforms (T, n, 4, 4), also as ``right_fingers`` and ``left_fingers``, are read for their
      positions. Further arrays that are read: ``valid`` (T,) or (T, 21), true or false or 1 or 0,
      ``T_world_wrist`` (T, 7) or (T, 4, 4), with the name ``world`` and ``quaternion_order`` (wxyz
      by default), and, with 21 points, ``metacarpals`` (T, 4, 3) [m] and ``orientations`` (T, 21,
      4) wxyz;
    - the log that ``LogWriter`` writes, even if it is truncated;
    - the ``.h5`` that ``smooth-operator convert`` writes (with the extra ``hdf5``);
    - a ``.bvh`` of a body capture with fingers (``smooth_operator.formats.bvh``);
    - a ``.csv`` of landmarks or of Project Aria (``smooth_operator.formats.landmark_csv``);
    - files that the readers of plugins recognise (``smooth_operator.formats.registry``).

    Landmarks that are not finite, and frames whose landmarks are all exactly zero (a tracker's "no
    hand") in a file without flags, are flagged in ``valid``. If neither the file nor the caller
    states the side, a right hand is assumed and ``meta["side_assumed"]`` is True.
    ``meta["format"]`` is ``"manus"``, ``"array"``, ``"log"``, ``"hdf5"`` or ``"bvh"``, or the name
    of a plugin's reader. Single frames and landmarks with an implausible size are flagged as
    invalid; ``meta["implausible_frames"]`` is the number of affected frames. A recording is refused
    if its shape is that of the other hand, or if its landmarks are in another order or do not form
    a hand (``check_hand``).

    Args:
        path: the file.
        rate: frame rate [Hz]; required if the file has no timestamps.
        side: side of the hand; required for a left hand if the file does not state the side.
        layout: the order of the landmarks in an array of 21, by its name in
            ``LAYOUTS``; None for the project's own, which is checked.
            The order of other files is known.

    Returns:
        The recording. Its units, stamps, side and order have been checked.

    Raises:
        RecordingError: the file is missing, empty, damaged, pickled or of another program; its
            shape, units or timestamps are wrong; it has no valid landmarks; its sides are mixed or
            contradict ``side``; or its shape is that of the other hand or of another order. The
            message states what was expected, what was found, and what to do.
        ConfigError: ``rate`` or ``side`` is invalid.
        UnknownNameError: there is no such ``layout``.
        MissingExtraError: the file needs an extra that is not installed.
    """
    path = Path(path)
    side = None if side is None else as_side(side)
    layout_order(layout)  # an unknown one is refused, whatever the file
    kind = file_kind(path)
    recording = recording_format(kind).recording(path, rate, side, layout)
    recording.meta.setdefault("format", kind)
    return recording


class Files:
    """Reader of any recording of one hand; each file is one clip."""

    what = "a recording of one hand"
    expects = "a file that 'smooth-operator retarget' reads"

    def matches(self, path: Path) -> bool:
        """True if the file has the name of a recording and contains more than commands."""
        return named_as_recording(path) and path.is_file() and not only_commands(path)

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """Yields the file as one clip."""
        yield ClipRef(path.stem, path, layout="files", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Reads the hand of a clip.

        Raises:
            RecordingError: as ``read_recording``.
        """
        layout_order(options.order)  # an unknown one is refused, whatever the file
        reader = recording_format(file_kind(ref.path))
        return reader.read_one_hand(ref, options)


FILES: Final = Files()


def read_arrays(
    path: Path, rate: float | None, side: Side | None, layout: str | None
) -> HandRecording:
    """Reads the landmarks in a ``.npy`` or ``.npz`` file; the arguments are those of
    ``read_recording``.

    Raises:
        RecordingError: as ``read_recording``, without the checks of size, side and order.
    """
    arrays = open_arrays(path)
    data = arrays.get("data")
    if data is not None and len(data.shape) == 3 and data.shape[-1] == 7:
        return array_hand(arrays, None, rate, side, layout)
    return array_hand(arrays, _find_landmarks(arrays, side), rate, side, layout)


def array_hand(
    arrays: StoredArrays,
    item: StoredArray | None,
    rate: float | None,
    side: Side | None,
    layout: str | None = None,
) -> HandRecording:
    """Reads one hand of a file, with its timestamps, flags and wrist; see ``read_arrays``.

    Args:
        item: array of the landmarks; None for the nodes of a MANUS recording.
    """
    where = str(arrays.path)
    named: Side | None = None
    meta: dict[str, Any]
    quaternions = orientations = None
    if item is None:
        nodes, quaternions, meta = manus_nodes(arrays)
    else:
        nodes, named, meta = _frames(item), _SIDE_OF.get(item.name), {"format": "array"}
    count = nodes.shape[1]
    picked, metacarpals = NODE_LAYOUTS[count]
    if layout is not None and count == 21 and item is not None:
        picked, meta["layout"] = layout_order(layout), layout
        positions = in_our_order(nodes, layout)
    else:
        positions = nodes[:, picked]
    if quaternions is not None:
        orientations = quaternions[:, picked]

    # "No hand in view" is all zeros in some trackers; as positions they would close the hand.
    lost = (positions == 0.0).all(axis=(1, 2))
    valid = np.isfinite(positions).all(axis=-1) & ~lost[:, None]
    own = _beside_landmarks(arrays, named, len(positions), picked, count, meta)
    if "valid" in own:  # the file knows better than a guess from zeros
        valid = own["valid"]
    elif lost.any():
        meta["zero_frames"] = int(lost.sum())

    labels: list[str] = [] if named is None else [named]
    labels += [text for key in _SIDE_KEYS if key in arrays for text in arrays[key].texts()]
    label, meta["side_assumed"] = check_side(labels, side, where)
    return HandRecording(
        positions,
        _stamps(arrays, len(positions), rate),
        label,
        valid=valid,
        metacarpals=own.get("metacarpals") if metacarpals is None else nodes[:, metacarpals],
        orientations=own.get("orientations", orientations),
        T_world_wrist=own.get("T_world_wrist"),
        world=_world(arrays) if "T_world_wrist" in own else None,
        forearm=own.get("forearm"),
        name=arrays.path.stem,
        meta=meta,
    )


def _world(arrays: StoredArrays) -> str | None:
    stored = arrays.get("world")
    return None if stored is None or stored.dtype.kind != "U" else stored.text()[:64]


def _beside_landmarks(
    arrays: StoredArrays,
    side: Side | None,
    count: int,
    picked: Sequence[int],
    nodes: int,
    meta: dict[str, Any],
) -> dict[str, np.ndarray]:
    """Reads flags, wrist, metacarpals and orientations; ``meta["ignored"]`` names arrays that are
    not read.

    Args:
        side: side of the landmarks, if the name of their array states it; then arrays with this
            side at the end of their name, such as ``valid_right``, belong to them.

    Raises:
        RecordingError: the flags or the wrist have an unsupported form. Ignoring them would give
            wrong hands without a warning.
    """
    names = {
        name: next((key for key in (f"{name}_{side}", name) if key in arrays), "")
        for name in ("valid", "T_world_wrist", "metacarpals", "orientations", "forearm")
    }
    own: dict[str, np.ndarray] = {}
    ignored = unread_flags(arrays, {*names.values(), "wrist_valid"})
    if names["valid"]:
        own["valid"] = validity(arrays[names["valid"]], count, picked, nodes)
    if names["T_world_wrist"]:
        stored = arrays[names["T_world_wrist"]]
        own["T_world_wrist"] = pose_rows(stored, count, quaternion_order(arrays))
    for name, shape in (
        ("metacarpals", (count, 4, 3)),
        ("orientations", (count, 21, 4)),
        ("forearm", (count, 3)),
    ):
        if names[name]:
            stored = arrays[names[name]]
            fits = stored.shape == shape and stored.dtype.kind == "f"
            if fits and (nodes == 21 or name == "forearm"):
                own[name] = stored.load()
            else:
                ignored.append(names[name])
    if "orientations" in own:
        own["orientations"] = own["orientations"][:, list(picked)]
    if ignored:
        meta["ignored"] = ignored
    return own


def _find_landmarks(arrays: StoredArrays, side: Side | None) -> StoredArray:
    """Finds the array of landmarks in a file, or raises an error that describes the contents."""
    path = arrays.path
    for item in arrays.values():
        if item.dtype.hasobject and (len(arrays) == 1 or item.name in ("joints", "landmarks")):
            label = f"array {brief(item.name)}" if item.name else "the array"
            raise RecordingError(f"{path}: {label} holds pickled objects; {PICKLE_REMEDY}")
    named = [arrays[name] for name in ("landmarks", "joints") if name in arrays]
    hands = [name for name in _SIDE_OF if name in arrays and len(arrays[name].shape) >= 3]
    if "" in arrays:
        return arrays[""]
    if not named and hands:
        names = [name for name in hands if side in (None, _SIDE_OF[name])] or hands
        if len(names) > 1:
            raise RecordingError(
                f"{path}: it contains both hands; choose one with --side right or --side left"
            )
        return arrays[names[0]]
    if len(named) == 1:
        return named[0]
    if len(named) > 1:
        raise RecordingError(
            f"{path}: it contains both 'landmarks' and 'joints'; keep only one of them"
        )
    cubes = [item for item in arrays.values() if len(item.shape) == 3]
    if len(cubes) == 1:
        return cubes[0]
    poses = [item for item in arrays.values() if item.shape in {(n, 3) for n in NODE_LAYOUTS}]
    if cubes or len(poses) > 1:
        names = [item.name for item in cubes or poses]
        what, first = "recordings" if cubes else "single poses", names[0][:40]
        raise RecordingError(
            f"{path}: it contains {len(names)} {what} rather than one recording: {listed(names)}; "
            f"save one in its own file: numpy.save('{first}.npy', "
            f"numpy.load('{path.name}')['{first}'])"
        )
    if poses:
        return poses[0]
    body = body_parameters({item.name: item.shape for item in arrays.values()})
    if body is not None:
        raise RecordingError(f"{path}: these are {body}")
    raise RecordingError(
        f"{path}: it has no array of landmarks, only {arrays.describe()}. Readable files: "
        f"{readable()}"
    )


def _frames(item: StoredArray) -> Float[np.ndarray, "T n 3"]:
    """Load (T, n, 3) points, with n nodes as in ``NODE_LAYOUTS``; an array (n, 3) becomes one
    frame, and 4 x 4 transforms become their positions.
    """
    shape = item.shape
    if shape[-2:] == (4, 4) and len(shape) in (3, 4) and shape[-3] in NODE_LAYOUTS:
        matrices = item.numbers().reshape(-1, *shape[-3:])
        if not (np.isnan(matrices) | (matrices == np.eye(4)))[..., 3, :].all():
            raise RecordingError(
                f"{item.path}: 4 x 4 transforms must have the last row 0 0 0 1, with the position "
                "in the last column; if they are transposed: array.swapaxes(-1, -2)"
            )
        return matrices[..., :3, 3]
    if len(shape) == 2 and shape[0] in NODE_LAYOUTS and shape[1] == 3:
        return item.numbers()[None]
    if len(shape) == 3 and shape[0] == 0:
        raise RecordingError(f"{item.path}: the recording contains no frames; its shape is {shape}")
    if len(shape) == 3 and shape[1] in NODE_LAYOUTS and shape[2] == 3:
        return item.numbers()
    raise RecordingError(
        f"{item.path}: landmarks must have shape (T, 21, 3), or 25 (MANUS, WebXR), 26 "
        "(OpenXR) or 27 (with the forearm) nodes instead of 21, or be 4 x 4 transforms (T, "
        f"25, 4, 4), not {shape}{_shape_hint(shape)}"
    )


def _shape_hint(shape: tuple[int, ...]) -> str:
    if len(shape) == 2 and shape[1] % 3 == 0 and shape[1] // 3 in NODE_LAYOUTS:
        return f"; if the rows are x, y, z in turn: array.reshape(-1, {shape[1] // 3}, 3)"
    if len(shape) == 3 and shape[1] == 3 and shape[2] in NODE_LAYOUTS:
        return "; swap the last two axes: array.transpose(0, 2, 1)"
    if len(shape) == 3 and shape[1] in NODE_LAYOUTS and shape[2] > 3:
        return "; if x, y, z come first: array[..., :3]"
    if len(shape) == 3 and shape[1:] == (16, 3):
        return (
            "; MANO's 16 joints do not include the fingertips: add the fingertips of MANO's mesh, "
            "then use --layout mano"
        )
    if shape[-2:] == (4, 4):
        return "; from transforms, save the positions of the hand's joints: array[..., :3, 3]"
    if len(shape) == 4:
        return "; if it contains several hands, save one of them: array[:, 0]"
    return ""


def _stamps(arrays: StoredArrays, count: int, rate: float | None) -> Float[np.ndarray, " T"]:
    where = str(arrays.path)
    keys = [key for key in _STAMP_KEYS if key in arrays]
    if not keys:
        return stamps_from_rate(count, rate, where)
    stamps = arrays[keys[0]].numbers()
    if count == 1 and stamps.ndim == 0:
        stamps = stamps[None]
    if stamps.shape != (count,):
        raise RecordingError(
            f"{where}: {keys[0]!r} must have one timestamp for each of the {count} frames, "
            f"not shape {stamps.shape}"
        )
    return own_stamps(stamps, rate, where)


_NUM_NODES = 25
_MOST_GLOVES: Final = 16
# Columns of the quaternion in wxyz order; px py pz come before it.
_QUATERNION_COLUMNS = {"wxyz": (3, 4, 5, 6), "xyzw": (6, 3, 4, 5)}


def manus_nodes(
    arrays: StoredArrays,
) -> tuple[Float[np.ndarray, "T 25 3"], Float[np.ndarray, "T 25 4"], dict[str, Any]]:
    """Reads ``data`` of a MANUS ``.npz``: columns px py pz [m] and a quaternion for each node.

    The node with id i is at index i of the results, whatever the order in the file. If
    ``keypoint_ids`` or ``quaternion_order`` is not in the file, the glove's own order (0 .. 24,
    wxyz) is assumed, and the third result lists the assumption under ``"assumed"``.

    Returns:
        Positions (T, 25, 3) [m], orientations (T, 25, 4) as unit quaternions wxyz (NaN if the file
        has a zero quaternion), and a mapping with other information in the file.

    Raises:
        RecordingError: there are no frames, ids are missing or repeated, the quaternion order is
            unknown, or ``StoredArray.numbers`` fails.
    """
    where = str(arrays.path)
    item = arrays["data"]
    if item.shape[0] == 0:
        raise RecordingError(
            f"{where}: the recording contains no frames; its shape is {item.shape}"
        )
    meta: dict[str, Any] = {"format": "manus"}
    assumed = []

    if "keypoint_ids" in arrays:
        order = _order(arrays["keypoint_ids"].numbers(), item.shape[1], where)
    elif item.shape[1] == _NUM_NODES:
        order = np.arange(_NUM_NODES)
        assumed.append("keypoint_ids")
    else:
        raise RecordingError(
            f"{where}: a MANUS recording has {_NUM_NODES} nodes, but this one has {item.shape[1]} "
            "and no 'keypoint_ids' to identify them; export it again with the ids"
        )

    if "quaternion_order" not in arrays:
        assumed.append("quaternion_order")
    data = item.numbers()[:, order]
    quaternions = data[..., _QUATERNION_COLUMNS[quaternion_order(arrays)]]
    norms = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    # The gloves' own are up to 1 % off unit length.
    quaternions = np.divide(
        quaternions, norms, out=np.full_like(quaternions, np.nan), where=norms > 0.0
    )
    if "glove_ids" in arrays:
        ids = arrays["glove_ids"]
        if ids.dtype.kind in "iuSU" and math.prod(ids.shape) <= _MOST_GLOVES:
            meta["glove_ids"] = (
                ids.texts() if ids.dtype.kind in "SU" else ids.load().ravel().tolist()
            )
    if assumed:
        meta["assumed"] = assumed
    return data[..., :3], quaternions, meta


def _order(ids: np.ndarray, count: int, where: str) -> np.ndarray:
    """Finds the row of each id 0 .. 24 in the data."""
    if ids.shape != (count,):
        raise RecordingError(
            f"{where}: 'keypoint_ids' must name each of the {count} nodes, not shape {ids.shape}"
        )
    missing = sorted(set(range(_NUM_NODES)) - set(ids.tolist()))
    if missing:
        raise RecordingError(
            f"{where}: 'keypoint_ids' must hold 0 to {_NUM_NODES - 1}, but {missing} are missing; "
            "export the recording again with all nodes of the hand"
        )
    fingers = ids[ids < _NUM_NODES]
    if len(np.unique(fingers)) != len(fingers):
        raise RecordingError(
            f"{where}: 'keypoint_ids' holds an id more than once: {brief(ids.tolist())}"
        )
    return np.asarray([np.flatnonzero(ids == i)[0] for i in range(_NUM_NODES)])
