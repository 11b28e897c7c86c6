"""Opens ``.npy`` and ``.npz`` files without ever unpickling.

Headers are read first, so an unsuitable array is refused before its data is loaded.

One byte of a deflate, gzip or Zstandard stream can expand to thousands of bytes, an HDF5 array that
was never written needs no space, and NumPy strings without characters have no size. Therefore the
declared size of the contents is compared with the size of the file before anything is unpacked.
Recordings stay far below the limit: noisy numbers shrink to a half or a third, and uncompressed
files of any length are accepted.
"""

from __future__ import annotations

import contextlib
import math
import sys
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from smooth_operator.errors import RecordingError, brief, listed, reason
from smooth_operator.io.plain_files import check_plain_file

FREE_BYTES: Final = 32 << 20
"""Unpacked size that any file may have [bytes]: 10 minutes of landmarks at 100 Hz."""

ARRAYS_RATIO: Final = 16
"""Largest size of arrays in memory, as a multiple of the size of the file."""

LOG_RATIO: Final = 64
"""The same limit for the text of a log, which compresses better."""

NUMBER_BYTES: Final = 8
"""Smallest number of bytes counted per element, because every number is read as float64."""

TEXT_BYTES: Final = 64
"""Number of bytes counted per string, in addition to its characters."""


class TooLargeError(RecordingError):
    """A file would expand to more memory than its size allows."""


@dataclass
class Allowance:
    """Number of bytes that may still be unpacked from one file.

    Attributes:
        path: the file, for messages.
        most: largest total number of bytes.
        used: bytes of each part so far.
        total: sum over all files.
    """

    path: Path
    most: int
    used: dict[str, int] = field(default_factory=dict)
    total: int = 0

    @classmethod
    def of(cls, path: Path, size: int, ratio: int = ARRAYS_RATIO) -> Allowance:
        """Returns the allowance for a file of a given size [bytes]."""
        return cls(path, max(FREE_BYTES, ratio * size))

    def take(self, part: str, count: int) -> None:
        """Counts the bytes of a part before it is unpacked. A part that is unpacked again counts
        once. Raises TooLargeError if the total would exceed the limit."""
        total = self.total - self.used.get(part, 0) + count
        if total > self.most:
            raise TooLargeError(
                f"{self.path}: reading {part[:80]!r} would take {_size(total)} of memory, more "
                f"than the {_size(self.most)} allowed for a file of this size; if the file is "
                "correct, save it without compression, or in parts"
            )
        self.used[part], self.total = count, total


def _size(count: int) -> str:
    return f"{count / 1e6:,.0f} MB" if count < 10**15 else "more than 10^9 MB"


_Bytes: TypeAlias = Any
"""A binary file or a member of a zip; they have no common type at run time."""

_NPY_MAGIC = np.lib.format.MAGIC_PREFIX
_MOST_MEMBERS = 1000  # of a zip; a recording has a dozen

PICKLE_REMEDY = (
    "pickles can run any code when they are read, so they are never opened here. If you "
    "trust the file, convert it once: numpy.savez('recording.npz', landmarks=<array of shape "
    "(T, 21, 3), in metres>, timestamps=<array of shape (T,), in seconds>, side='right')"
)


def damaged(path: Path, cause: object) -> RecordingError:
    """Returns the error for a file that can't be read to its end."""
    text = reason(cause) or "no detail"
    return RecordingError(
        f"{path}: the file is damaged or incomplete ({text}); copy or record it again"
    )


@dataclass(frozen=True)
class StoredArray:
    """One array of a file: its header, and methods to load its data.

    Attributes:
        shape: its shape.
        dtype: its element type; ``dtype.hasobject`` means that it is a pickle.
        allowance: number of bytes that may be unpacked from the file.
    """

    path: Path
    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    open: Callable[[], _Bytes]
    allowance: Allowance

    def load(self) -> np.ndarray:
        """Reads the data. Raises RecordingError if the array is pickled or damaged, or takes more
        memory than a file of this size may."""
        label = f"array {self.name!r}" if self.name else "the array"
        if self.dtype.hasobject:
            raise RecordingError(f"{self.path}: {label} holds pickled objects; {PICKLE_REMEDY}")
        each = max(self.dtype.itemsize, NUMBER_BYTES)
        if self.dtype.kind in "US":
            each = self.dtype.itemsize + TEXT_BYTES
        self.allowance.take(self.name or "the array", math.prod(self.shape) * each)
        with _foreign(self.path), self.open() as stream:
            return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))

    def numbers(self) -> np.ndarray:
        """Reads the data as float64.

        Raises:
            RecordingError: as ``load``, or the array is not numeric.
        """
        array = self.load()
        if array.dtype.kind not in "fiu":
            raise RecordingError(
                f"{self.path}: array {self.name!r} must hold real numbers, not {self.dtype}"
            )
        return array.astype(np.float64, copy=False)

    def text(self) -> str:
        """Reads the data as one string.

        Raises:
            RecordingError: as ``texts``, or there is more than one string.
        """
        if self.shape not in ((), (1,)):
            raise RecordingError(
                f"{self.path}: array {self.name!r} must hold one string, not an array of shape "
                f"{self.shape}"
            )
        return self.texts()[0]

    def texts(self) -> list[str]:
        """Reads the data as a flat list of strings (bytes are decoded as ASCII).

        Raises:
            RecordingError: as ``load``, or the array is not text.
        """
        array = self.load()
        if array.dtype.kind not in "US":
            raise RecordingError(
                f"{self.path}: array {self.name!r} must hold text, not {self.dtype}"
            )
        if array.dtype.kind == "S":
            array = np.char.decode(array, "ascii", "replace")
        else:  # NumPy checks the text only when it is read
            native = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
            codes = native.reshape(-1).view(np.uint32) if array.dtype.itemsize else np.zeros(0)
            if ((codes > sys.maxunicode) | ((codes >= 0xD800) & (codes < 0xE000))).any():
                raise damaged(self.path, f"array {brief(self.name)} has values that are not text")
        return [str(item) for item in array.ravel()]


class StoredArrays(Mapping[str, StoredArray]):
    """The arrays of an ``.npz`` file by name; a ``.npy`` file is one array named ``""``."""

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
        """Lists the names and shapes of the arrays, for error messages."""
        items = (f"{name or 'one array'} {item.shape}" for name, item in self.items())
        return listed(items) or "no arrays"


def open_arrays(path: Path) -> StoredArrays:
    """Reads the headers of the arrays in an ``.npy`` or ``.npz`` file. Raises RecordingError if the
    file is truncated, damaged, not a regular file, or a zip that contains a pickle (PyTorch's
    format)."""
    with _foreign(path):
        size = check_plain_file(path)
        allowance = Allowance.of(path, size)
        with path.open("rb") as stream:
            is_npy = stream.read(len(_NPY_MAGIC)) == _NPY_MAGIC
            stream.seek(0)
            if is_npy:
                shape, dtype = _header(stream, path, "", size)
                one = StoredArray(path, "", shape, dtype, lambda: path.open("rb"), allowance)
                return StoredArrays(path, {"": one})
        with zipfile.ZipFile(path) as archive:
            return StoredArrays(path, _members(archive, path, allowance))


def npz_arrays(path: Path) -> Mapping[str, StoredArray]:
    """Returns the arrays of an ``.npz`` file. The mapping is empty for another or a broken file."""
    try:
        return open_arrays(path) if path.suffix.lower() == ".npz" and path.is_file() else {}
    except RecordingError:
        return {}


def _members(archive: zipfile.ZipFile, path: Path, allowance: Allowance) -> dict[str, StoredArray]:
    members = archive.infolist()
    if len(members) > _MOST_MEMBERS:
        raise RecordingError(
            f"{path}: it contains {len(members)} files, but at most {_MOST_MEMBERS} can be read; "
            "save each recording in its own file"
        )
    pickles = [m.filename for m in members if m.filename.endswith((".pkl", ".pickle"))]
    if pickles:
        raise RecordingError(f"{path}: it contains the pickle {brief(pickles[0])}; {PICKLE_REMEDY}")
    entries = {}
    for member in members:
        if member.filename.endswith(".npy"):
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as stream:
                shape, dtype = _header(stream, path, name, member.file_size)
            opener = _member_opener(path, member.filename)
            entries[name] = StoredArray(path, name, shape, dtype, opener, allowance)
    return entries


@contextlib.contextmanager
def _foreign(path: Path) -> Iterator[None]:
    """Converts every error of NumPy, zipfile and the decompressors on damaged bytes to one error.

    Their errors are not documented completely: a flipped bit in a header can make NumPy's call of
    ``tokenize`` fail, and the flags of a member can make zipfile ask for a password.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Python 2's headers and of names that come twice
            yield
    except RecordingError:
        raise
    except Exception as error:
        raise damaged(path, error) from error


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
    if any(isinstance(length, bool) or length < 0 for length in shape):
        raise damaged(path, f"an array has the shape {shape}")
    expected = math.prod(shape) * dtype.itemsize + stream.tell()
    if not dtype.hasobject and size < expected:
        # Before loading, since a header with an absurd shape would otherwise ask for the memory.
        label = f"array {brief(name)}" if name else "the array"
        raise damaged(path, f"{label} should take {expected} bytes, but has {size}")
    return shape, dtype


def _member_opener(path: Path, member: str) -> Callable[[], _Bytes]:
    def opener() -> _Bytes:
        # The member keeps the archive's file alive, and closing the member closes it.
        with zipfile.ZipFile(path) as archive:
            return archive.open(member)

    return opener
