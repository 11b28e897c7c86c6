"""Opening ``.npy`` and ``.npz`` files without ever unpickling.

Headers are read first: what an array is, is known (and refused) before its data is loaded.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from smooth_operator.errors import RecordingError
from smooth_operator.recording.sniff import NPY_MAGIC, PICKLE_REMEDY

_Bytes: TypeAlias = Any
"""A binary file or a member of a zip, which have no common type that holds at run time."""

# What NumPy, zipfile and zlib raise on damaged bytes. RuntimeError: an encrypted member.
_DAMAGE = (
    ValueError,
    EOFError,
    OSError,
    KeyError,
    SyntaxError,
    RuntimeError,
    NotImplementedError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
)


def damaged(path: Path, cause: object) -> RecordingError:
    """The error for a file whose bytes can't be read to the end."""
    return RecordingError(
        f"{path}: the file is damaged or cut off ({cause or 'no detail'}); copy or record it again"
    )


@dataclass(frozen=True)
class StoredArray:
    """One array of a file: what its header says, and how to load it.

    Attributes:
        shape: its shape.
        dtype: its element type; ``dtype.hasobject`` means that it is a pickle.
    """

    path: Path
    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    open: Callable[[], _Bytes]

    def load(self) -> np.ndarray:
        """Read the data.

        Raises:
            RecordingError: if it is a pickled array, or damaged.
        """
        label = f"array {self.name!r}" if self.name else "the array"
        if self.dtype.hasobject:
            raise RecordingError(f"{self.path}: {label} holds pickled objects; {PICKLE_REMEDY}")
        try:
            with self.open() as stream:
                return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
        except _DAMAGE as error:
            raise damaged(self.path, error) from error

    def numbers(self) -> np.ndarray:
        """Read the data as float64.

        Raises:
            RecordingError: as :meth:`load`, or if it is not numeric.
        """
        array = self.load()
        if array.dtype.kind not in "fiu":
            raise RecordingError(
                f"{self.path}: array {self.name!r} must hold real numbers, not {self.dtype}"
            )
        return array.astype(np.float64)

    def texts(self) -> list[str]:
        """Read the data as a flat list of strings (bytes are taken as ASCII).

        Raises:
            RecordingError: as :meth:`load`, or if it is not text.
        """
        array = self.load()
        if array.dtype.kind not in "US":
            raise RecordingError(
                f"{self.path}: array {self.name!r} must hold text, not {self.dtype}"
            )
        if array.dtype.kind == "S":
            array = np.char.decode(array, "ascii", "replace")
        return [str(item) for item in array.ravel()]


class StoredArrays(Mapping[str, StoredArray]):
    """The arrays of an ``.npz`` by name; a bare ``.npy`` is one array named ``""``."""

    def __init__(self, path: Path, entries: dict[str, StoredArray]) -> None:
        self.path = path
        self._entries = entries

    def __getitem__(self, name: str) -> StoredArray:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def describe(self) -> str:
        """Names and shapes, for error messages."""
        items = (f"{name or 'one array'} {item.shape}" for name, item in self.items())
        return ", ".join(items) or "no arrays"


def open_arrays(path: Path) -> StoredArrays:
    """Read the headers of the arrays in an ``.npy`` or ``.npz`` file.

    Raises:
        RecordingError: if the file is cut off, damaged, or a pickle inside a zip (PyTorch's form).
    """
    try:
        with path.open("rb") as stream:
            if stream.read(len(NPY_MAGIC)) == NPY_MAGIC:
                stream.seek(0)
                shape, dtype = _header(stream, path, "", path.stat().st_size)
                return StoredArrays(
                    path, {"": StoredArray(path, "", shape, dtype, lambda: path.open("rb"))}
                )
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            pickles = [m.filename for m in members if m.filename.endswith((".pkl", ".pickle"))]
            if pickles:
                raise RecordingError(f"{path}: it holds the pickle {pickles[0]!r}; {PICKLE_REMEDY}")
            entries = {}
            for member in members:
                if member.filename.endswith(".npy"):
                    name = member.filename.removesuffix(".npy")
                    with archive.open(member) as stream:
                        shape, dtype = _header(stream, path, name, member.file_size)
                    opener = _member_opener(path, member.filename)
                    entries[name] = StoredArray(path, name, shape, dtype, opener)
    except RecordingError:
        raise
    except _DAMAGE as error:
        raise damaged(path, error) from error
    return StoredArrays(path, entries)


def _header(
    stream: _Bytes, path: Path, name: str, size: int
) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(stream)
    # Version 3 differs from 2 only in the encoding of field names, which no array of ours has.
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read(stream)
    expected = int(np.prod(shape, dtype=object)) * dtype.itemsize + stream.tell()
    if not dtype.hasobject and size < expected:
        # Before loading, since a header with an absurd shape would otherwise ask for the memory.
        label = f"array {name!r}" if name else "the array"
        raise damaged(path, f"{label} should take {expected} bytes, {size} are there")
    return shape, dtype


def _member_opener(path: Path, member: str) -> Callable[[], _Bytes]:
    def opener() -> _Bytes:
        # The member keeps the archive's file alive, and closing the member closes it.
        with zipfile.ZipFile(path) as archive:
            return archive.open(member)

    return opener
