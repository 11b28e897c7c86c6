"""Arrays of a group of an HDF5 file, written with units and read with their shapes checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from smooth_operator.episode_files.hdf5_tree import Hdf5Array, Hdf5Group
from smooth_operator.errors import RecordingError

POSE_UNITS: Final = "m, quaternion wxyz"

Group: TypeAlias = Any
"""A group of h5py, which comes without types."""


def write_array(group: Group, name: str, value: np.ndarray, units: str | None) -> None:
    """Add an array to a group, packed.

    Args:
        group: of an open h5py file.
        name: of the array.
        value: the array.
        units: its attribute; None for none.
    """
    # Shuffled bytes of neighbouring samples compress far better than the samples themselves.
    packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if value.size else {}
    data = group.create_dataset(name, data=value, **packed)
    if units is not None:
        data.attrs["units"] = units


def numbers(group: Hdf5Group, name: str, shape: tuple[int | None, ...], path: Path) -> np.ndarray:
    """An array of numbers as float64; see ``array_of``."""
    return array_of(group, name, shape, "fiu", path).astype(np.float64, copy=False)


def array_of(
    group: Hdf5Group, name: str, shape: tuple[int | None, ...], kinds: str, path: Path
) -> np.ndarray:
    """An array of numbers of the shape and kinds that are expected.

    Raises:
        RecordingError: it is missing, or of another shape or kind.
    """
    array = data_of(group, name, path)
    fits = len(array.shape) == len(shape) and all(
        expected in (None, size) for expected, size in zip(shape, array.shape, strict=True)
    )
    if not fits:
        expected = ", ".join("any" if size is None else str(size) for size in shape)
        raise RecordingError(
            f"{path}: {array.name} must have shape ({expected}), not {tuple(array.shape)}"
        )
    if array.kind not in kinds or array.data is None:
        what = "true or false" if kinds == "b" else "numbers"
        raise RecordingError(f"{path}: {array.name} must hold {what}, not {array.type[:80]}")
    return array.data


def data_of(group: Hdf5Group, name: str, path: Path) -> Hdf5Array:
    """An array as it is.

    Raises:
        RecordingError: the group has none of that name.
    """
    if name not in group.arrays:
        raise RecordingError(
            f"{path}: it lacks the array {group.name}/{name}; the group holds {group.describe()}"
        )
    return group.arrays[name]


def text_of(value: Any) -> str | None:
    """A value if it is a text."""
    return value if isinstance(value, str) else None
