"""Files of pickles, read as data: what of them is no data is refused, and nothing is executed.

MANO's model files, and the files of several data sets of hands, are pickles or hold pickles in
``.npy`` and ``.npz``. ``load_restricted`` builds from them NumPy's arrays, tables, lists, texts and
numbers, and stand-ins for sparse matrices, for chumpy's arrays and for PyTorch's tensors, whose
numbers ``numbers`` gives. All else that a file asks for is refused with its name.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.errors import DocumentError, RecordingError, listed
from smooth_operator.formats.arrays import StoredArray, open_arrays
from smooth_operator.io.documents import check_plain_file
from smooth_operator.lab.datasets.mano.pickle_arrays import PickledArray, numbers
from smooth_operator.lab.datasets.mano.pickle_machine import Machine
from smooth_operator.lab.datasets.mano.pickle_parts import (
    FREE_BYTES,
    RATIO,
    Budget,
    NotDataError,
)
from smooth_operator.lab.datasets.mano.pickle_values import check_nesting, find_global

__all__ = ("MOST_BYTES", "array", "load_restricted", "numbers", "table", "text")

MOST_BYTES: Final = 1 << 30
"""Longest file that is read."""

_NPY: Final = b"\x93NUMPY"
_ZIP: Final = (b"PK\x03\x04", b"PK\x05\x06")
_READ: Final = (
    "of a pickle only arrays, sparse matrices, tensors, tables, lists, texts and numbers are read"
)


def load_restricted(path: Path, *, names: Collection[str] | None = None) -> Any:
    """What a pickle, ``.npy`` or ``.npz`` holds, without running any code of it.

    Args:
        path: the file; what it is, its first bytes say.
        names: of an ``.npz``, the arrays to read; None for all. Those that are missing are left
            out.

    Returns:
        The value of a pickle; the array of a ``.npy``, or what is in it, if it is an array of one
        object; name -> such a value for an ``.npz``.

    Raises:
        RecordingError: the file is missing, damaged, too large, or asks for what is no data.
    """
    try:
        size = check_plain_file(path)
        if size > MOST_BYTES:
            raise NotDataError(f"it has {size} bytes, more than the {MOST_BYTES} that are read")
        with path.open("rb") as stream:
            head = stream.read(6)
            whole = head + stream.read(MOST_BYTES) if not head.startswith((_NPY, *_ZIP)) else b""
    except (OSError, DocumentError) as error:
        raise RecordingError(f"{path}: it can't be read: {_reason(error)}") from error
    except NotDataError as error:
        raise RecordingError(f"{path}: {error}") from error
    if whole or not head:
        return _decoded(whole, 0, str(path))
    arrays = open_arrays(path)
    if "" in arrays:
        return _stored(arrays[""], str(path))
    wanted = arrays.keys() if names is None else [name for name in names if name in arrays]
    return {name: _stored(arrays[name], f"{path}, {name[:80]!r}") for name in wanted}


def table(value: Any, where: str, needs: Collection[str] = ()) -> dict[Any, Any]:
    """A value that must be a table with some keys.

    Args:
        value: what a file holds.
        where: the file and part, for messages.
        needs: keys that it must have.

    Raises:
        RecordingError: it is none, or lacks one; says by name which, and what is there.
    """
    if not isinstance(value, dict):
        raise RecordingError(f"{where}: a table was expected there, not a {type(value).__name__}")
    missing = [key for key in needs if key not in value]
    if missing:
        have = listed(sorted(str(key)[:40] for key in list(value)[:40]))
        raise RecordingError(
            f"{where}: it lacks {listed(missing)}; it has {have or 'nothing'}, so it may be a file "
            "of another layout"
        )
    return value


def array(
    value: Any, where: str, shape: tuple[int | None, ...], *, finite: bool = False
) -> np.ndarray:
    """A value that must be numbers of a shape, as float64.

    Args:
        value: what a file holds.
        where: the file and part, for messages.
        shape: lengths; None where any will do.
        finite: whether numbers that are not finite are refused.

    Raises:
        RecordingError: it is something else; says what was expected and what is there.
    """
    try:
        found = numbers(value)
    except NotDataError as error:
        raise RecordingError(f"{where}: {error}") from error
    fits = found.ndim == len(shape) and all(
        n is None or n == m for n, m in zip(shape, found.shape, strict=True)
    )
    if not fits:
        words = ", ".join("any" if n is None else str(n) for n in shape)
        raise RecordingError(
            f"{where}: numbers of shape ({words}) were expected, not {found.shape}"
        )
    if finite and not np.isfinite(found).all():
        raise RecordingError(f"{where}: it has numbers that are not finite")
    return found


def text(value: Any, most: int = 200) -> str | None:
    """A value as text, cut where it is long; None if it is no text."""
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    if isinstance(value, np.ndarray) and value.shape == () and value.dtype.kind == "U":
        value = str(value[()])
    return value[:most] if isinstance(value, str) else None


def _decoded(data: bytes, start: int, where: str, *, inner: bool = False) -> Any:
    """The value of a pickle; ``inner`` for that in a ``.npy``, which is an array of objects."""
    try:
        value = Machine(data, start, Budget(len(data)), find_global).run()
        if not inner:
            check_nesting(value)
            return value
        if not isinstance(value, PickledArray) or value.objects is None:
            raise NotDataError("it is damaged: its array of objects is missing")
        check_nesting(value.objects)
        return value.objects[0] if value.objects_shape == () else value.objects
    except NotDataError as error:
        raise RecordingError(f"{where}: {error}; {_READ}") from error


def _stored(item: StoredArray, where: str) -> Any:
    if not item.dtype.hasobject:
        return item.load()
    if item.dtype != np.dtype(object):
        raise RecordingError(f"{where}: it has fields of objects, which are not read; {_READ}")
    # A zip of a few bytes may unpack to any number of them.
    most = min(FREE_BYTES + RATIO * item.path.stat().st_size, MOST_BYTES)
    try:
        with item.open() as stream:
            data = stream.read(most + 1)
    except Exception as error:  # zipfile and the decompressors promise no list
        raise RecordingError(f"{where}: it is damaged or cut off ({_reason(error)})") from error
    if len(data) > most:
        raise RecordingError(
            f"{where}: it unpacks to more than the {most} bytes that a file of this size may; if "
            "the file is right, save it without compression"
        )
    # The header has been read once, so its length is sound: two or four bytes after the version.
    long = data[6:7] != b"\x01"
    start = 12 if long else 10
    start += int.from_bytes(data[8 : 12 if long else 10], "little")
    return _decoded(data, start, where, inner=True)


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return " ".join(str(error).split())[:160] or type(error).__name__
