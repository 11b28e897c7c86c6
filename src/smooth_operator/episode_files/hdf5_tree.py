"""Reads groups and arrays of an HDF5 file within limits on memory."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smooth_operator.errors import DocumentError, MissingExtraError, RecordingError, listed
from smooth_operator.formats.arrays import (
    NUMBER_BYTES,
    TEXT_BYTES,
    Allowance,
    TooLargeError,
    damaged,
)
from smooth_operator.io.plain_files import check_plain_file

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
    "transforms": (
        *(*EGODEX_JOINTS["right"], *EGODEX_JOINTS["left"]),
        *("rightForearm", "leftForearm", "camera"),
    ),
    "confidences": EGODEX_JOINTS["right"] + EGODEX_JOINTS["left"],
    "camera": ("intrinsic",),
    "/": ("configuration",),
    "hand": (
        *("landmarks", "stamps", "valid", "metacarpals", "orientations"),
        *("T_world_wrist", "forearm"),
    ),
    "commands": (
        *("joint_positions", "joint_names", "stamps", "latency_ms", "status"),
        *("wrist", "wrist_engaged", "wrist_valid"),
        *("arm", "arm_measured", "arm_wrist"),
    ),
    "state": (
        *("joint_positions", "joint_names", "stamps", "actuator_names"),
        *("currents", "touch", "contact", "newtons"),
    ),
}
"""Group -> arrays that are read from it; all arrays of ``stages_ms`` are read."""

_MOST_STAGES = 64
_MOST_NAMES = 100
_MOST_ATTRIBUTES = 100
_MOST_WORDS = 4096


@dataclass(frozen=True, eq=False)
class Hdf5Array:
    """An array of an HDF5 file.

    Attributes:
        name: name of the array, including its groups.
        shape: its shape.
        kind: kind of its elements in NumPy's letters: ``f``, ``i``, ``u``, ``b``, or another.
        type: human-readable type of its elements.
        attributes: strings, numbers and lists of them.
        data: its numbers; None if it has other content.
        texts: its strings, as a flat list; None if it has other content.
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
    """A group of an HDF5 file.

    Attributes:
        name: name of the group, including its parent groups.
        names: names of its first hundred members.
        attributes: strings, numbers and lists of them.
        arrays: its arrays that this package reads.
    """

    name: str
    names: list[str]
    attributes: dict[str, Any]
    arrays: dict[str, Hdf5Array]

    def describe(self) -> str:
        """Describes the content of the group, for messages."""
        return listed(self.names) or "nothing"


def read_tree(path: Path, *, head: bool = False) -> dict[str, Hdf5Group]:
    """Reads the groups that this package uses, by name; the file itself is ``/``.

    Args:
        path: the file.
        head: True to read only the attributes of the file.

    Raises:
        MissingExtraError: h5py is not installed.
        RecordingError: the file is damaged, links to other files, or takes more memory than a file
            of its size may.
    """
    h5py = h5py_of()
    try:
        allowance = Allowance.of(path, check_plain_file(path))
    except (OSError, DocumentError) as error:
        raise RecordingError(f"{path}: can't be read: {error}") from error
    try:
        with h5py.File(path, "r", locking=False) as file:
            return dict(_groups(file, allowance, head))
    except TooLargeError:
        raise
    except _RefusedError as error:
        raise RecordingError(
            f"{path}: {error}; save it again with all data inside the file, or as .npz"
        ) from error
    except Exception as error:  # h5py promises no list of what damaged bytes raise
        raise damaged(path, f"HDF5: {str(error)[:300] or type(error).__name__}") from error


class _RefusedError(Exception):
    """The file contains something that is not read; the message continues the file's name."""


def _groups(file: Any, allowance: Allowance, head: bool) -> Iterator[tuple[str, Hdf5Group]]:
    yield "/", _group(file, () if head else ARRAYS["/"], allowance)
    groups = {"": file}
    for name in () if head else GROUPS:
        above, _, last = name.rpartition("/")
        if above not in groups or last not in groups[above]:
            continue
        group = _linked(groups[above], last)
        if isinstance(group, h5py_of().Group):
            groups[name] = group
            arrays = ARRAYS.get(name) or tuple(itertools.islice(group, _MOST_STAGES + 1))
            if len(arrays) > _MOST_STAGES:
                raise _RefusedError(f"its group {name} holds more than {_MOST_STAGES} arrays")
            yield name, _group(group, arrays, allowance)


def _group(group: Any, arrays: tuple[str, ...], allowance: Allowance) -> Hdf5Group:
    held = {}
    for name in arrays:
        if name in group:
            data = _linked(group, name)
            if isinstance(data, h5py_of().Dataset):
                held[name] = _array(data, allowance)
    names = list(itertools.islice(group, _MOST_NAMES))
    return Hdf5Group(group.name, names, _attributes(group), held)


def _linked(group: Any, name: str) -> Any:
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py_of().HardLink):
        raise _RefusedError(f"its {name!r} is a link, and links are not followed")
    return group[name]


def _array(data: Any, allowance: Allowance) -> Hdf5Array:
    dtype, shape = data.dtype, data.shape  # h5py asks the file each time
    if shape is None:  # an array without a space
        raise _RefusedError(f"its array {data.name} is empty")
    if data.external or data.is_virtual:
        raise _RefusedError(
            f"the data of {data.name} are in other files, which this program does not read"
        )
    words = h5py_of().check_string_dtype(dtype) is not None
    each = max(dtype.itemsize, TEXT_BYTES if words else NUMBER_BYTES)
    allowance.take(data.name, max(math.prod(shape), math.prod(data.chunks or ())) * each)
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
    return Hdf5Array(
        data.name, tuple(shape), dtype.kind, str(dtype), _attributes(data), numbers, texts
    )


def _attributes(item: Any) -> dict[str, Any]:
    held: dict[str, Any] = {}
    for name in list(item.attrs)[:_MOST_ATTRIBUTES]:
        with contextlib.suppress(KeyError):
            about = item.attrs.get_id(name)
            count = math.prod(about.shape)
            if count > _MOST_WORDS or count * about.dtype.itemsize > 1 << 20:
                continue
            value = item.attrs[name]
            if isinstance(value, h5py_of().Empty):
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
    """Imports and returns the module ``h5py``; MissingExtraError if it is not installed."""
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("an HDF5 file", "hdf5") from error
    return h5py
