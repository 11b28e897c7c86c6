"""Files of pickles, read as data: every class and function of a pickle is refused but a few.

MANO's model files, and the files of several data sets of hands, are pickles or hold pickles in
``.npy`` and ``.npz``. ``load_restricted`` reads them with an ``Unpickler`` that imports nothing:
the names of NumPy's arrays, of sparse matrices, of chumpy's arrays and of PyTorch's tensors stand
for classes of this module, whose numbers ``numbers`` gives. Every other name is refused.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from smooth_operator.errors import DocumentError, RecordingError, listed
from smooth_operator.formats.arrays import StoredArray, open_arrays
from smooth_operator.io.plain_files import check_plain_file

__all__ = ("MOST_BYTES", "NotDataError", "array", "load_restricted", "numbers", "table", "text")

MOST_BYTES: Final = 1 << 30
"""Longest file that is read."""
FREE_BYTES: Final = 64 << 20
"""Bytes that the arrays of any pickle may take, however short it is."""
RATIO: Final = 16
"""Bytes that they may take in addition, as a multiple of its length."""
MOST_STEPS: Final = 20_000_000
"""Instructions of one pickle."""

_NPY: Final = b"\x93NUMPY"
_ZIP: Final = (b"PK\x03\x04", b"PK\x05\x06")
_READ: Final = (
    "of a pickle only arrays, sparse matrices, tensors, tables, lists, texts and numbers are read"
)
_MOST_ROWS: Final = 10_000_000  # numbers in lists
_NUMBERS: Final = re.compile(r"[<>=|]?(b1|i[1248]|u[1248]|f(2|4|8|16)|c8|c16|[SU]\d{0,6}|O8?)")
_PUTS: Final = ("PUT", "BINPUT", "LONG_BINPUT")
_ORDERS: Final = ("<", ">", "=", "|")


class NotDataError(RecordingError):
    """A pickle asks for a class or function that is refused, or is damaged, or too large."""


def load_restricted(path: Path, *, names: Collection[str] | None = None) -> Any:
    """What a pickle, ``.npy`` or ``.npz`` holds, without running any code of it.

    Args:
        path: the file; what it is, its first bytes say.
        names: names of the arrays of an ``.npz`` to read; None for all. Missing ones are
            left out.

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
    members = arrays.keys() if names is None else [name for name in names if name in arrays]
    return {name: _stored(arrays[name], f"{path}, {name[:80]!r}") for name in members}


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
        finite: True if numbers that are not finite are refused.

    Raises:
        RecordingError: it is something else; says what was expected and what is there.
    """
    try:
        array = numbers(value)
    except NotDataError as error:
        raise RecordingError(f"{where}: {error}") from error
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
    """A value as text, cut where it is long; None if it is no text."""
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    if isinstance(value, np.ndarray) and value.shape == () and value.dtype.kind == "U":
        value = str(value[()])
    return value[:most] if isinstance(value, str) else None


def _decoded(data: bytes, start: int, where: str, *, inner: bool = False) -> Any:
    """The value of a pickle; ``inner`` for that in a ``.npy``, which is an array of objects."""
    try:
        value = _load(io.BytesIO(data), start)
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


# --- the restricted unpickler --------------------------------------------------------------------


class _Unpickler(pickle.Unpickler):
    """Gives stand-ins for the names in a pickle, and imports nothing.

    Args:
        stream: the pickle, from its current place.
    """

    def __init__(self, stream: io.BytesIO) -> None:
        super().__init__(stream, encoding="latin1")  # of texts that Python 2 wrote
        self._left = FREE_BYTES + RATIO * len(stream.getbuffer())

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in of a global, which no other load shares.

        Raises:
            NotDataError: there is none, with its name.
        """
        whole = f"{_OLD_MODULES.get(module, module)}.{name}"
        if whole == "numpy.core.multiarray._reconstruct":
            return _Function(whole, self._new_array)
        if whole in _FUNCTIONS:
            return _Function(whole, _FUNCTIONS[whole])
        sparse = _SPARSE.fullmatch(whole)
        if sparse:
            return type("Sparse", (_Sparse,), {"name": sparse[2]})
        if re.fullmatch(r"chumpy(\.\w+)+", whole):
            return type("Chumpy", (_Chumpy,), {"name": whole})
        raise NotDataError(f"it asks for {whole[:120]!r}, which is no data")

    def persistent_load(self, pid: Any) -> Any:
        """(element type, key, count) of a tensor's storage; nothing else is outside of a pickle."""
        if not isinstance(pid, tuple) or len(pid) not in (5, 6) or pid[0] != "storage":
            raise NotDataError("it refers to objects outside of it")
        _, kind, key, _, count, *view = pid
        code = _TORCH_TYPES.get(kind.name) if isinstance(kind, _Function) else None
        if code is None or not isinstance(key, str) or not isinstance(count, int) or any(view):
            raise NotDataError("its tensor is damaged")
        return code, key, count

    def _new_array(self, kind: Any, *_: Any) -> _Array:
        """An empty array, as ``numpy.core.multiarray._reconstruct`` makes it."""
        if not isinstance(kind, _Function) or kind.name != "numpy.ndarray":
            raise NotDataError("it has an array of a kind that is not read")
        array = np.ndarray.__new__(_Array, (0,), np.int8)
        array.counted = self._take
        return array

    def _take(self, count: int) -> None:
        """Counts the bytes of an array before they are copied."""
        self._left -= count
        if self._left < 0:
            raise NotDataError("it would take more memory than a file of this size may")


def _load(stream: io.BytesIO, start: int) -> Any:
    """The value of the pickle at a place of a stream, which is behind it afterwards.

    Raises:
        NotDataError: it is damaged, too long, or asks for a class or function that is refused.
    """
    try:
        stream.seek(start)
        size = len(stream.getbuffer())
        for step, (instruction, argument, _) in enumerate(pickletools.genops(stream)):
            if step >= MOST_STEPS:
                raise NotDataError(f"it has more than {MOST_STEPS:,} instructions")
            # The unpickler makes room for as many entries as the index of one says.
            if instruction.name in _PUTS and isinstance(argument, int) and argument > size:
                raise NotDataError("it is damaged")
        stream.seek(start)
        return _Unpickler(stream).load()
    except NotDataError:
        raise
    except Exception as error:  # pickle promises no list
        raise NotDataError("it is damaged or cut off") from error


class _Function:
    """Stands for a function, or a class that a pickle calls."""

    def __init__(self, name: str, make: Callable[..., Any]) -> None:
        self.name, self._make = name, make

    def __call__(self, *arguments: Any) -> Any:
        return self._make(*arguments)

    def __setstate__(self, state: Any) -> None:
        raise TypeError("a function has no state")


# --- stand-ins -----------------------------------------------------------------------------------


class _Dtype:
    """An element type."""

    def __init__(self, code: Any) -> None:
        if not isinstance(code, str) or not _NUMBERS.fullmatch(code):
            raise NotDataError("it has an array of an element type that is not read")
        self.value: np.dtype[Any] = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        """Takes the order of bytes; fields and sub-arrays are not read."""
        if not isinstance(state, tuple) or len(state) < 5 or any(state[2:5]):
            raise NotDataError("it has an array of an element type that is not read")
        order = state[1]
        if order not in _ORDERS:
            raise ValueError("order of bytes")
        if order in "<>":
            self.value = self.value.newbyteorder(order)


class _Array(np.ndarray):
    """An array, empty until its state has come.

    Attributes:
        objects: the objects of an array of them, which are not put into it.
        counted: called with the bytes that it takes, before they are copied.
    """

    counted: Callable[[int], None]
    objects: list[Any] | None = None
    objects_shape: tuple[int, ...] = ()

    def __setstate__(self, state: Any) -> None:
        """Takes shape, element type and bytes."""
        if not isinstance(state, tuple) or len(state) not in (4, 5):
            raise TypeError("state of an array")
        shape, dtype, fortran, raw = state[-4:]
        if not isinstance(dtype, _Dtype):
            raise TypeError("element type")
        shape = _lengths(shape)
        if dtype.value.hasobject:
            if not isinstance(raw, list) or len(raw) != math.prod(shape):
                raise ValueError("objects")
            self.objects, self.objects_shape = raw, shape
            return
        raw = raw.encode("latin-1") if isinstance(raw, str) else raw
        _check_bytes(raw, shape, dtype.value)
        self.counted(len(raw))
        checked: Any = (1, shape, dtype.value, bool(fortran), raw)
        np.ndarray.__setstate__(self, checked)
        _check_text(self)


def _lengths(shape: Any) -> tuple[int, ...]:
    """A shape of plain numbers.

    Raises:
        TypeError, ValueError: it is none.
    """
    if isinstance(shape, int):
        shape = (shape,)
    if not isinstance(shape, tuple) or len(shape) > 16:
        raise TypeError("shape")
    if not all(isinstance(n, int) and 0 <= n < 1 << 40 for n in shape):
        raise ValueError("shape")
    return tuple(int(n) for n in shape)


def _check_bytes(raw: Any, shape: Sequence[int], dtype: np.dtype[Any]) -> None:
    if not isinstance(raw, bytes) or dtype.hasobject or not dtype.itemsize:
        raise TypeError("bytes of an array")
    if len(raw) != math.prod(shape) * dtype.itemsize:
        raise ValueError("length of an array")


def _check_text(array: np.ndarray) -> None:
    """NumPy checks text only when it is read."""
    if array.dtype.kind != "U":
        return
    native = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    codes = native.reshape(-1).view(np.uint32)
    if ((codes > 0x10FFFF) | ((codes >= 0xD800) & (codes < 0xE000))).any():
        raise ValueError("text")


def _scalar(dtype: Any, raw: Any = None) -> Any:
    """One number or text of an element type."""
    if not isinstance(dtype, _Dtype):
        raise TypeError("element type")
    raw = raw.encode("latin-1") if isinstance(raw, str) else raw
    _check_bytes(raw, (), dtype.value)
    value = np.frombuffer(raw, dtype.value)
    _check_text(value)
    return value[0].item()


def _from_buffer(raw: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    """An array of bytes that stand in the pickle, as protocol 5 has it."""
    if not isinstance(dtype, _Dtype) or order not in ("C", "F"):
        raise TypeError("element type")
    shape, raw = _lengths(shape), bytes(raw) if isinstance(raw, bytearray) else raw
    _check_bytes(raw, shape, dtype.value)
    values = np.frombuffer(raw, dtype.value).reshape(shape, order=order)
    _check_text(values)
    return values


class _Stated:
    """An object that is known by its class and attributes."""

    name = ""

    state: dict[Any, Any]

    def __new__(cls, *_: Any) -> _Stated:
        """An object without attributes, as a pickle makes it before they follow."""
        instance = object.__new__(cls)
        instance.state = {}
        return instance

    def __setstate__(self, state: Any) -> None:
        """Takes the attributes; of a pair, as Python has it for slots, the first."""
        if isinstance(state, tuple) and len(state) == 2 and not state[1]:
            state = state[0]
        if not isinstance(state, dict):
            raise TypeError("attributes")
        self.state = state

    def array(self) -> np.ndarray:
        """The numbers of the object.

        Raises:
            NotDataError: it is damaged, or its class is not known.
        """
        raise NotDataError(f"it has an object of {self.name[:80]} where numbers should be")


class _Chumpy(_Stated):
    """An array of chumpy, which is an expression: those of published models are read."""

    def array(self) -> np.ndarray:
        """Its numbers: ``x`` of ``Ch``, ``a.ravel()[idxs]`` in a shape of ``Select``."""
        state = self.state
        try:
            if self.name == "chumpy.ch.Ch" and "x" in state:
                return numbers(state["x"])
            if self.name == "chumpy.reordering.Select" and "a" in state:
                values = numbers(state["a"]).ravel()[numbers(state["idxs"]).astype(np.int64)]
                shape = state.get("preferred_shape")
                return values if shape is None else values.reshape(_lengths(shape))
        except (LookupError, TypeError, ValueError) as error:
            raise NotDataError(f"its array of {self.name} is damaged") from error
        raise NotDataError(
            f"it has an array of {self.name[:80]}, which is not read; convert the file once to "
            "plain arrays, as smplx does with tools/clean_ch.py"
        )


class _Sparse(_Stated):
    """A sparse matrix of SciPy; its name is ``csc`` or ``csr``."""

    def array(self) -> np.ndarray:
        """Its numbers, with the zeros."""
        state = self.state
        shape = state.get("_shape", state.get("shape"))
        data, *places = (numbers(state.get(key)) for key in ("data", "indices", "indptr"))
        parts = (data, *(place.astype(np.int64) for place in places))
        if not isinstance(shape, tuple) or len(shape) != 2:
            raise NotDataError("it has a sparse matrix of a kind that is not read")
        rows, columns = (int(n) for n in _lengths(shape))
        if rows * columns > 50_000_000:
            raise NotDataError("its sparse matrix is too large")
        kind = csc_matrix if self.name == "csc" else csr_matrix
        try:
            matrix = kind(parts, shape=(rows, columns))
            matrix.check_format(full_check=True)
            return np.asarray(matrix.toarray(), np.float64)
        except (TypeError, ValueError, IndexError) as error:
            raise NotDataError("its sparse matrix is damaged") from error


def numbers(value: Any) -> np.ndarray:
    """The numbers of a value of a pickle, as float64 whatever held them.

    Args:
        value: an array, a stand-in, a number, or lists of numbers up to three levels.

    Raises:
        NotDataError: it holds something else.
    """
    if isinstance(value, _Stated):
        return np.asarray(value.array(), np.float64)
    if isinstance(value, list | tuple):
        _check_rows(value)
        try:
            value = np.asarray(value)
        except ValueError as error:  # rows of different lengths
            raise NotDataError("it has rows of different lengths") from error
    if isinstance(value, bool | int | float):
        value = np.asarray(float(value))
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf":
        raise NotDataError(f"it has a {type(value).__name__} where numbers should be")
    if isinstance(value, _Array) and value.objects is not None:
        raise NotDataError("it has an array of objects where numbers should be")
    return np.asarray(value, np.float64)


def _check_rows(rows: Any) -> None:
    """Refuses lists of other things than numbers, of too many, or of more than three levels."""
    left, count = [(rows, 3)], 0
    while left:
        row, levels = left.pop()
        count += len(row)
        if not levels or count > _MOST_ROWS:
            raise NotDataError("it has lists in lists where numbers should be")
        for item in row:
            if isinstance(item, list | tuple):
                left.append((item, levels - 1))
            elif not isinstance(item, bool | int | float) or abs(item) > 1e300:
                raise NotDataError(f"it has a {type(item).__name__} where numbers should be")


_TORCH_MAGIC: Final = 0x1950A86A20F9469CFC6C
_TORCH_TYPES: Final = {
    f"torch.{name}Storage": code
    for name, code in (
        ("Float", "<f4"), ("Double", "<f8"), ("Half", "<f2"), ("Long", "<i8"), ("Int", "<i4"),
        ("Short", "<i2"), ("Char", "i1"), ("Byte", "u1"), ("Bool", "?"),
    )
}  # fmt: skip


def _storage(raw: Any) -> np.ndarray:
    """(n,) numbers of tensors, from the bytes of ``torch.save`` in its old form: five pickles,
    their count, and the numbers."""
    if not isinstance(raw, bytes):
        raise TypeError("storage")
    stream = io.BytesIO(raw)
    magic, version, system, (code, key, count), keys = (
        _load(stream, stream.tell()) for _ in range(5)
    )
    if magic != _TORCH_MAGIC or version != 1001:
        raise NotDataError("it has a tensor in a form that is not read")
    if system.get("little_endian") is not True or keys != [key]:
        raise NotDataError("its tensor is damaged")
    if count != int.from_bytes(stream.read(8), "little"):
        raise NotDataError("its tensor is damaged")
    return np.frombuffer(raw, code, count, stream.tell())


def _tensor(values: Any, offset: Any, size: Any, stride: Any, *_: Any) -> np.ndarray:
    """A tensor of PyTorch, whose numbers are a view of its storage's."""
    size, stride = _lengths(size), _lengths(stride)
    if not isinstance(values, np.ndarray) or not isinstance(offset, int) or offset < 0:
        raise TypeError("tensor")
    spans = [(n - 1) * step for n, step in zip(size, stride, strict=True)]
    # of numbers that count several times, which parameters of hands do not
    if math.prod(size) > len(values) or (math.prod(size) and offset + sum(spans) >= len(values)):
        raise NotDataError("its tensor takes more than its numbers")
    steps = [step * values.itemsize for step in stride]
    return np.lib.stride_tricks.as_strided(values[offset:], size, steps).copy()


# --- names that a pickle may ask for -------------------------------------------------------------


def _set(items: Any = ()) -> set[Any]:
    if not isinstance(items, list | tuple) or not all(isinstance(i, str | int) for i in items):
        raise TypeError("set")
    return set(items)


def _ordered(items: Any = ()) -> dict[Any, Any]:
    if not isinstance(items, list | tuple) or items:
        raise TypeError("table")
    return {}


def _encoded(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise TypeError("bytes")
    return text.encode("latin-1")


def _bytearray(raw: Any = b"", *_: Any) -> bytes:
    if isinstance(raw, str):  # as Python 2 has it, with the name of an encoding
        raw = raw.encode("latin-1")
    if not isinstance(raw, bytes | bytearray):
        raise TypeError("bytes")
    return bytes(raw)


def _reconstructed(kind: Any, base: Any, state: Any = None) -> Any:
    if not isinstance(kind, type) or not issubclass(kind, _Stated) or state is not None:
        raise TypeError("class")
    return kind()


def _new_object(kind: Any, *_: Any) -> Any:
    return _reconstructed(kind, None)


def _refused(*_: Any) -> Any:
    raise NotDataError("it has an array of a kind that is not read")


_FUNCTIONS: Final[dict[str, Callable[..., Any]]] = {
    "builtins.set": _set,
    "builtins.frozenset": _set,
    "builtins.bytes": lambda: b"",
    "builtins.bytearray": _bytearray,
    "builtins.complex": lambda real, imaginary: complex(float(real), float(imaginary)),
    "builtins.object": _refused,
    "_codecs.encode": _encoded,
    "collections.OrderedDict": _ordered,
    "copyreg.__newobj__": _new_object,
    "copyreg._reconstructor": _reconstructed,
    "numpy.dtype": lambda code, *_: _Dtype(code),
    "numpy.ndarray": _refused,
    "numpy.core.multiarray.scalar": _scalar,
    "numpy.core.numeric._frombuffer": _from_buffer,
    "torch.Size": lambda lengths: _lengths(tuple(lengths)),
    "torch._utils._rebuild_parameter": lambda tensor, *_: tensor,
    "torch._utils._rebuild_tensor": _tensor,
    "torch._utils._rebuild_tensor_v2": _tensor,
    "torch._load_from_bytes": _storage,
    **dict.fromkeys(_TORCH_TYPES, _refused),
}
_OLD_MODULES: Final = {
    "__builtin__": "builtins",
    "copy_reg": "copyreg",
    "numpy._core.multiarray": "numpy.core.multiarray",
    "numpy._core.numeric": "numpy.core.numeric",
    "torch.cuda": "torch",
    "torch.storage": "torch",
}
_SPARSE: Final = re.compile(r"scipy\.sparse\._?(csc|csr)\.(csc|csr)_(matrix|array)")
