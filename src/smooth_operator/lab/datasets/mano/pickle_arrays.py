"""What stands for the arrays of a pickle: NumPy's, SciPy's sparse ones, chumpy's."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from smooth_operator.lab.datasets.mano.pickle_parts import (
    Budget,
    Instance,
    Maker,
    NotDataError,
    Numeric,
)

_MOST_ROWS: Final = 10_000_000  # numbers in lists
_NUMBERS: Final = re.compile(r"[<>=|]?(b1|i[1248]|u[1248]|f(2|4|8|16)|c8|c16|[SU]\d{0,6}|O8?)")
_ORDERS: Final = ("<", ">", "=", "|")


class Dtype(Instance):
    """An element type."""

    def __init__(self, code: Any) -> None:
        if not isinstance(code, str) or not _NUMBERS.fullmatch(code):
            raise NotDataError("it has an array of an element type that is not read")
        self.value: np.dtype[Any] = np.dtype(code)

    def build(self, budget: Budget, state: Any) -> None:
        """Takes the order of bytes; fields and sub-arrays are not read."""
        if not isinstance(state, tuple) or len(state) < 5 or any(state[2:5]):
            raise NotDataError("it has an array of an element type that is not read")
        order = state[1]
        if order not in _ORDERS:
            raise ValueError("order of bytes")
        if order in "<>":
            self.value = self.value.newbyteorder(order)


class PickledArray(np.ndarray, Instance):
    """An array, empty until its state has come.

    Attributes:
        objects: what it holds, where it is one of objects: those are not put into an array.
    """

    objects: list[Any] | None = None
    objects_shape: tuple[int, ...] = ()

    def build(self, budget: Budget, state: Any) -> None:
        """Takes shape, element type and bytes."""
        if not isinstance(state, tuple) or len(state) not in (4, 5):
            raise TypeError("state of an array")
        shape, dtype, fortran, raw = state[-4:]
        if not isinstance(dtype, Dtype):
            raise TypeError("element type")
        shape = lengths(shape)
        if dtype.value.hasobject:
            if not isinstance(raw, list) or len(raw) != math.prod(shape):
                raise ValueError("objects")
            self.objects, self.objects_shape = raw, shape
            return
        raw = raw.encode("latin-1") if isinstance(raw, str) else raw
        _check_bytes(raw, shape, dtype.value)
        budget.take(len(raw))
        checked: Any = (1, shape, dtype.value, bool(fortran), raw)
        np.ndarray.__setstate__(self, checked)
        _check_text(self)


def lengths(shape: Any) -> tuple[int, ...]:
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


def new_array(budget: Budget, kind: Any, *_: Any) -> PickledArray:
    """An empty array, as ``numpy.core.multiarray._reconstruct`` makes it."""
    if kind is not NDARRAY:
        raise NotDataError("it has an array of a kind that is not read")
    return np.ndarray.__new__(PickledArray, (0,), np.int8)


NDARRAY: Final = Maker(lambda budget, *_: new_array(budget, None))
"""``numpy.ndarray``, which is only an argument of what makes arrays."""


def scalar(budget: Budget, dtype: Any, raw: Any = None) -> Any:
    """One number or text of an element type."""
    if not isinstance(dtype, Dtype):
        raise TypeError("element type")
    raw = raw.encode("latin-1") if isinstance(raw, str) else raw
    _check_bytes(raw, (), dtype.value)
    found = np.frombuffer(raw, dtype.value)
    _check_text(found)
    return found[0].item()


def from_buffer(budget: Budget, raw: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    """An array of bytes that stand in the pickle, as protocol 5 has it."""
    if not isinstance(dtype, Dtype) or order not in ("C", "F"):
        raise TypeError("element type")
    shape = lengths(shape)
    _check_bytes(raw, shape, dtype.value)
    found = np.frombuffer(raw, dtype.value).reshape(shape, order=order)
    _check_text(found)
    return found


class Stated(Instance, Numeric):
    """An object that is known by its class and attributes.

    Attributes:
        name: its class, with the module.
        state: its attributes.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: dict[Any, Any] = {}

    def build(self, budget: Budget, state: Any) -> None:
        """Takes the attributes; of a pair, as Python has it for slots, the first."""
        if isinstance(state, tuple) and len(state) == 2 and not state[1]:
            state = state[0]
        if not isinstance(state, dict):
            raise TypeError("attributes")
        self.state = state

    def array(self) -> np.ndarray:
        """None: its class is not known."""
        raise NotDataError(f"it has an object of {self.name[:80]} where numbers should be")


class Chumpy(Stated):
    """An array of chumpy, which is an expression: those of published models are read."""

    def array(self) -> np.ndarray:
        """Its numbers: ``x`` of ``Ch``, ``a.ravel()[idxs]`` in a shape of ``Select``."""
        state = self.state
        try:
            if self.name == "chumpy.ch.Ch" and "x" in state:
                return numbers(state["x"])
            if self.name == "chumpy.reordering.Select" and "a" in state:
                found = numbers(state["a"]).ravel()[numbers(state["idxs"]).astype(np.int64)]
                shape = state.get("preferred_shape")
                return found if shape is None else found.reshape(lengths(shape))
        except (LookupError, TypeError, ValueError) as error:
            raise NotDataError(f"its array of {self.name} is damaged") from error
        raise NotDataError(
            f"it has an array of {self.name[:80]}, which is not read; convert the file once to "
            "plain arrays, as smplx does with tools/clean_ch.py"
        )


class SparseMatrix(Stated):
    """A sparse matrix of SciPy, by rows or columns."""

    def array(self) -> np.ndarray:
        """Its numbers, with the zeros."""
        state = self.state
        shape = state.get("_shape", state.get("shape"))
        kept = [numbers(state.get(key)) for key in ("data", "indices", "indptr")]
        if self.name not in ("csc", "csr") or not isinstance(shape, tuple) or len(shape) != 2:
            raise NotDataError("it has a sparse matrix of a kind that is not read")
        rows, columns = (int(n) for n in lengths(shape))
        major, minor = (columns, rows) if self.name == "csc" else (rows, columns)
        data, indices, ends = kept[0], kept[1].astype(np.int64), kept[2].astype(np.int64)
        if major * minor > 50_000_000:
            raise NotDataError("its sparse matrix is too large")
        counts = np.diff(ends)
        if (
            not data.ndim == indices.ndim == ends.ndim == 1
            or len(ends) != major + 1
            or len(data) != len(indices)
            or (counts < 0).any()
            or ends[0] != 0
            or ends[-1] != len(data)
            or (len(indices) and not 0 <= indices.min() <= indices.max() < minor)
        ):
            raise NotDataError("its sparse matrix is damaged")
        found = np.zeros((major, minor))
        np.add.at(found, (np.repeat(np.arange(major), counts), indices), data)
        return found.T if self.name == "csc" else found


def numbers(value: Any) -> np.ndarray:
    """The numbers of a value of a pickle, as float64 whatever held them.

    Args:
        value: an array, a stand-in, a number, or lists of numbers up to three levels.

    Raises:
        NotDataError: it holds something else.
    """
    if isinstance(value, Numeric):
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
    if isinstance(value, PickledArray) and value.objects is not None:
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
