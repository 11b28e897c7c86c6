"""Reads pickles safely: MANO's model files, and the files of several data sets of hands.

``load_restricted`` reads pickles, also inside ``.npy`` and ``.npz`` files, with an ``Unpickler``
that imports nothing: classes of this module replace the arrays of NumPy and chumpy, sparse matrices
and tensors of PyTorch, and ``numbers`` returns their numbers. Every other name is refused.
``MOST_BYTES`` limits the size of files and of what they unpack to; a pickle that is made to take
more memory than that is not detected.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from collections import OrderedDict
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from smooth_operator.errors import DocumentError, RecordingError, listed
from smooth_operator.formats.arrays import StoredArray, open_arrays
from smooth_operator.io.plain_files import check_plain_file

__all__ = ("MOST_BYTES", "NotDataError", "array", "load_restricted", "numbers", "table", "text")

MOST_BYTES: Final = 1 << 30
"""Largest size of a file, and of a pickle in a compressed file [bytes]."""

_NPY: Final = b"\x93NUMPY"
_ZIP: Final = (b"PK\x03\x04", b"PK\x05\x06")
_READ: Final = "only arrays, sparse matrices, tensors, tables, lists, strings, numbers are read"
_NUMBERS: Final = re.compile(r"[<>=|]?(b1|i[1248]|u[1248]|f(2|4|8|16)|c8|c16|[SU]\d{0,6}|O8?)")


class NotDataError(RecordingError):
    """Raised if a pickle names a refused class or function, is damaged, or is too large."""


def load_restricted(path: Path, *, names: Collection[str] | None = None) -> Any:
    """Returns the content of a pickle, ``.npy`` or ``.npz``, without running any code in it.

    Args:
        path: the file, which is recognised by its first bytes.
        names: names of the arrays of an ``.npz`` to read; None for all. Missing ones are ignored.

    Returns:
        The value of a pickle; the array of a ``.npy``, or its object if it is an array of one
        object; such values by name for an ``.npz``.

    Raises:
        RecordingError: the file is missing, damaged or too large, or names a refused class.
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
    members = arrays.keys() if names is None else [name for name in names if name in arrays]
    return {name: _stored(arrays[name], f"{path}, {name[:80]!r}") for name in members}


def table(value: Any, where: str, needs: Collection[str] = ()) -> dict[Any, Any]:
    """Returns a value that must be a table with some keys.

    Args:
        value: content of a file.
        where: the file and part, for messages.
        needs: keys that the table must have.

    Raises:
        RecordingError: it is not a table, or lacks a key; the message names the missing and the
            present keys.
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
    value: Any,
    where: str,
    shape: tuple[int | None, ...],
    *,
    finite: bool = False,
    batch: bool = False,
) -> np.ndarray:
    """Returns a value that must be numbers of a shape, as float64.

    Args:
        value: content of a file.
        where: the file and part, for messages.
        shape: expected lengths; None for any.
        finite: True to refuse numbers that are not finite.
        batch: True to drop additional leading axes of length one, which models add.

    Raises:
        RecordingError: it is not an array of numbers with this shape.
    """
    try:
        array = numbers(value)
    except NotDataError as error:
        raise RecordingError(f"{where}: {error}") from error
    while batch and array.ndim > len(shape) and array.shape[0] == 1:
        array = array[0]
    fits = array.ndim == len(shape) and all(
        n is None or n == m for n, m in zip(shape, array.shape, strict=True)
    )
    if not fits:
        words = ", ".join("any" if n is None else str(n) for n in shape)
        raise RecordingError(
            f"{where}: numbers of shape ({words}) were expected, not {array.shape}"
        )
    if finite and not np.isfinite(array).all():
        raise RecordingError(f"{where}: it has numbers that are not finite")
    return array


def text(value: Any, most: int = 200) -> str | None:
    """Returns a value as text, cut to a length; None if it is not text."""
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    if isinstance(value, np.ndarray) and value.shape == () and value.dtype.kind == "U":
        value = str(value[()])
    return value[:most] if isinstance(value, str) else None


def numbers(value: Any) -> np.ndarray:
    """Returns the numbers of a value of a pickle as float64.

    Args:
        value: an array, a stand-in, a number, or lists of numbers up to three levels.

    Raises:
        NotDataError: it contains something else.
    """
    if isinstance(value, _Stated):
        return value.array()
    if isinstance(value, list | tuple) and not _are_numbers(value, 2):
        raise NotDataError("expected lists of numbers, but they contain other values")
    if isinstance(value, list | tuple | bool | int | float):
        try:
            value = np.asarray(value, np.float64)
        except (ValueError, OverflowError) as error:
            raise NotDataError("it has rows of different lengths or huge numbers") from error
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
        raise NotDataError(f"expected numbers, not a {type(value).__name__}")
    if isinstance(value, _Array) and value.objects is not None:
        raise NotDataError("expected an array of numbers, not of objects")
    return np.asarray(value, np.float64)


def _are_numbers(rows: list[Any] | tuple[Any, ...], levels: int) -> bool:
    """True for numbers in lists of at most so many further levels."""
    return all(
        isinstance(item, bool | int | float)
        or (levels > 0 and isinstance(item, list | tuple) and _are_numbers(item, levels - 1))
        for item in rows
    )


def _decoded(data: bytes, start: int, where: str, *, inner: bool = False) -> Any:
    """The value of a pickle; ``inner`` for that in a ``.npy``, which is an array of objects."""
    try:
        stream = io.BytesIO(data)
        stream.seek(start)
        value = _load(stream)
        if not inner:
            return value
        if not isinstance(value, _Array) or value.objects is None:
            raise NotDataError("it is damaged: its array of objects is missing")
        return value.objects[0] if value.objects_shape == () else value.objects
    except NotDataError as error:
        raise RecordingError(f"{where}: {error}; {_READ}") from error


def _stored(item: StoredArray, where: str) -> Any:
    if not item.dtype.hasobject:
        return item.load()
    if item.dtype != np.dtype(object):
        raise RecordingError(f"{where}: it has fields of objects, which are not read; {_READ}")
    try:
        with item.open() as stream:
            data = stream.read(MOST_BYTES + 1)
    except Exception as error:  # zipfile and the decompressors document no list of errors
        raise RecordingError(f"{where}: it is damaged or cut off ({_reason(error)})") from error
    if len(data) > MOST_BYTES:
        raise RecordingError(
            f"{where}: it unpacks to more than the {MOST_BYTES} bytes that are read"
        )
    # The header has been read once, so its length is sound: two or four bytes after the version.
    start = 12 if data[6:7] != b"\x01" else 10
    return _decoded(data, start + int.from_bytes(data[8:start], "little"), where, inner=True)


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return " ".join(str(error).split())[:160] or type(error).__name__


class _Unpickler(pickle.Unpickler):
    """Replaces names of ``_ALLOWED``, chumpy and SciPy by classes of this module; imports none."""

    def find_class(self, module: str, name: str) -> Any:
        """Returns the replacement of a class or function; a new one for chumpy and SciPy.

        Raises:
            NotDataError: the name is refused; the message has it.
        """
        whole = f"{_OLD_MODULES.get(module, module)}.{name}"
        if whole in _ALLOWED:
            return _ALLOWED[whole]
        if re.fullmatch(r"(chumpy|scipy\.sparse)(\.\w+)+", whole):
            return type("Stated", (_Stated,), {"name": whole})
        raise NotDataError(f"it refers to {whole[:120]!r}, which is not data")

    def persistent_load(self, pid: Any) -> Any:
        """(element type, key, count) of a tensor's storage, the only kind of external object."""
        _, kind, key, _, count, *view = pid
        if pid[0] != "storage" or any(view):
            raise NotDataError("its tensor is damaged")
        return _TORCH_TYPES[kind.name], key, count


def _load(stream: io.BytesIO) -> Any:
    """Reads the pickle at the position of a stream.

    Raises:
        NotDataError: it is damaged, or names a refused class or function.
    """
    try:
        return _Unpickler(stream, encoding="latin1").load()  # for texts of Python 2
    except NotDataError:
        raise
    except Exception as error:  # pickle documents no list of errors
        raise NotDataError("it is damaged or cut off") from error


class _Function:
    """Replaces a function or class that a pickle calls; a pickle can't change it."""

    def __init__(self, name: str, make: Callable[..., Any]) -> None:
        self.name, self._make = name, make

    def __call__(self, *arguments: Any) -> Any:
        return self._make(*arguments)

    def __setstate__(self, state: Any) -> None:
        raise TypeError("a function has no state")


class _Dtype:
    """An element type; that of NumPy takes flags from a pickle unchecked."""

    def __init__(self, code: Any, *_: Any) -> None:
        if not isinstance(code, str) or not _NUMBERS.fullmatch(code):
            raise NotDataError("it has an array of an element type that is not read")
        self.value: np.dtype[Any] = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        """Sets the order of bytes; fields and sub-arrays are refused."""
        if any(state[2:5]):
            raise NotDataError("it has an array of an element type that is not read")
        self.value = self.value.newbyteorder(state[1])


class _Array(np.ndarray):
    """An array, empty until its state is set.

    Attributes:
        objects: the objects of an array of objects, which are kept outside of it.
    """

    objects: list[Any] | None = None
    objects_shape: tuple[int, ...] = ()

    def __setstate__(self, state: Any) -> None:
        """Sets shape, element type and bytes."""
        shape, dtype, fortran, raw = state[-4:]
        if dtype.value.hasobject:
            if len(raw) != math.prod(shape):
                raise ValueError("objects")
            self.objects, self.objects_shape = list(raw), tuple(shape)
            return
        values = _from_buffer(raw, dtype, shape)
        checked: Any = (1, values.shape, values.dtype, bool(fortran), values.tobytes())
        np.ndarray.__setstate__(self, checked)


def _new_array(kind: Any, *_: Any) -> _Array:
    """An empty array, as from ``numpy.core.multiarray._reconstruct``."""
    if kind is not _ALLOWED["numpy.ndarray"]:
        raise NotDataError("it has an array of a kind that is not read")
    return np.ndarray.__new__(_Array, (0,), np.int8)


def _from_buffer(raw: Any, dtype: Any, shape: Any = (), order: Any = "C") -> np.ndarray:
    """An array of bytes in the pickle, which must have exactly its length."""
    values = np.frombuffer(_bytearray(raw), dtype.value).reshape(_lengths(shape), order=order)
    if values.dtype.kind == "U":
        values.tolist()  # NumPy checks text only when it is read
    return values


def _lengths(shape: Any) -> tuple[int, ...]:
    """A shape of plain numbers that are not negative.

    Raises:
        TypeError, ValueError: the shape is invalid.
    """
    lengths = (shape,) if isinstance(shape, int) else tuple(shape)
    if not all(isinstance(n, int) and 0 <= n < 1 << 40 for n in lengths):
        raise ValueError("shape")
    return lengths


class _Stated:
    """An object of chumpy or SciPy that is known by its class and attributes."""

    name = ""

    state: dict[Any, Any]

    def __new__(cls, *_: Any) -> _Stated:
        """An object without attributes, as a pickle makes it before they follow."""
        instance = object.__new__(cls)
        instance.state = {}
        return instance

    def __setstate__(self, state: Any) -> None:
        """Takes the attributes; of a pair, as Python has it for slots, the first."""
        self.state = dict(state[0] if isinstance(state, tuple) else state)

    def array(self) -> np.ndarray:
        """The numbers of the object: ``x`` of chumpy's ``Ch``, ``a.ravel()[idxs]`` in a shape of
        its ``Select``, and a sparse matrix with its zeros.

        Raises:
            NotDataError: it is damaged, or its class is not known.
        """
        state = self.state
        try:
            if self.name == "chumpy.ch.Ch" and "x" in state:
                return numbers(state["x"])
            if self.name == "chumpy.reordering.Select" and "a" in state:
                values = numbers(state["a"]).ravel()[numbers(state["idxs"]).astype(np.int64)]
                shape = state.get("preferred_shape")
                return values if shape is None else values.reshape(_lengths(shape))
            for form, kind in (("csc", csc_matrix), ("csr", csr_matrix)):
                if re.fullmatch(rf"scipy\.sparse\._?{form}\.{form}_(matrix|array)", self.name):
                    rows, columns = _lengths(state.get("_shape", state.get("shape")))
                    if rows * columns > _MOST_CELLS:
                        raise NotDataError("its sparse matrix is too large")
                    data, *places = (numbers(state[key]) for key in ("data", "indices", "indptr"))
                    parts = (data, *(place.astype(np.int64) for place in places))
                    matrix = kind(parts, shape=(rows, columns))
                    matrix.check_format(full_check=True)
                    return np.asarray(matrix.toarray(), np.float64)
        except (LookupError, TypeError, ValueError) as error:
            raise NotDataError(f"its array of {self.name[:80]} is damaged") from error
        raise NotDataError(
            f"it has an array of {self.name[:80]}, which is not supported; convert the file to "
            "plain arrays first, as tools/clean_ch.py of smplx does"
        )


_MOST_CELLS: Final = 50_000_000
"""Largest number of elements of a sparse matrix, zeros included."""

_TORCH_MAGIC: Final = 0x1950A86A20F9469CFC6C
_TORCH_TYPES: Final = {
    f"torch.{name}Storage": code
    for name, code in (
        ("Float", "<f4"),
        ("Double", "<f8"),
        ("Half", "<f2"),
        ("Long", "<i8"),
        ("Int", "<i4"),
        ("Short", "<i2"),
        ("Char", "i1"),
        ("Byte", "u1"),
        ("Bool", "?"),
    )
}


def _storage(raw: bytes) -> np.ndarray:
    """(n,) numbers of tensors, from the bytes of ``torch.save`` in its old form: five pickles,
    their count, and the numbers."""
    stream = io.BytesIO(raw)
    magic, version, system, (code, key, count), keys = (_load(stream) for _ in range(5))
    if (magic, version) != (_TORCH_MAGIC, 1001) or system["little_endian"] is not True:
        raise NotDataError("it has a tensor in a form that is not read")
    if keys != [key] or count != int.from_bytes(stream.read(8), "little"):
        raise NotDataError("its tensor is damaged")
    return np.frombuffer(raw, code, count, stream.tell())


def _tensor(values: Any, offset: Any, size: Any, stride: Any, *_: Any) -> np.ndarray:
    """Makes a tensor of PyTorch, which is a view of its storage."""
    (start,), size, stride = _lengths(offset), _lengths(size), _lengths(stride)
    last = start + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    # of numbers that count several times, which parameters of hands do not
    if math.prod(size) > len(values) or (math.prod(size) and last >= len(values)):
        raise NotDataError("its tensor has more elements than there are numbers in the file")
    steps = [step * values.itemsize for step in stride]
    return np.lib.stride_tricks.as_strided(values[start:], size, steps).copy()


def _new_object(kind: Any, *_: Any) -> Any:
    if not issubclass(kind, _Stated):
        raise TypeError("class")
    return kind()


def _refused(*_: Any) -> Any:
    raise NotDataError("it has an array of a kind that is not read")


def _bytearray(raw: Any = b"", *_: Any) -> bytes:
    # Python 2 writes a text with the name of an encoding.
    return raw.encode("latin-1") if isinstance(raw, str) else bytes(memoryview(raw))


_FUNCTIONS: Final[dict[str, Callable[..., Any]]] = {
    "builtins.bytes": lambda: b"",
    "builtins.bytearray": _bytearray,
    "builtins.complex": complex,
    "builtins.object": _refused,
    "_codecs.encode": lambda text, *_: text.encode("latin-1"),
    "copyreg.__newobj__": _new_object,
    "copyreg._reconstructor": _new_object,
    "numpy.dtype": _Dtype,
    "numpy.ndarray": _refused,
    "numpy.core.multiarray._reconstruct": _new_array,
    "numpy.core.multiarray.scalar": lambda dtype, raw: _from_buffer(raw, dtype).item(),
    "numpy.core.numeric._frombuffer": _from_buffer,
    "torch.Size": lambda lengths: _lengths(tuple(lengths)),
    "torch._utils._rebuild_parameter": lambda tensor, *_: tensor,
    "torch._utils._rebuild_tensor": _tensor,
    "torch._utils._rebuild_tensor_v2": _tensor,
    "torch._load_from_bytes": _storage,
    **dict.fromkeys(_TORCH_TYPES, _refused),
}
_ALLOWED: Final[dict[str, Any]] = {
    "builtins.set": set,
    "builtins.frozenset": frozenset,
    "collections.OrderedDict": OrderedDict,
    **{name: _Function(name, make) for name, make in _FUNCTIONS.items()},
}
"""Allowed names in a pickle -> their replacements."""

_OLD_MODULES: Final = {
    "__builtin__": "builtins",
    "copy_reg": "copyreg",
    "numpy._core.multiarray": "numpy.core.multiarray",
    "numpy._core.numeric": "numpy.core.numeric",
    "torch.cuda": "torch",
    "torch.storage": "torch",
}
