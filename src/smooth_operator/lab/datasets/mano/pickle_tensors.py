"""What stands for the tensors of PyTorch in a plain pickle; PyTorch is not needed."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from smooth_operator.lab.datasets.mano.pickle_arrays import lengths
from smooth_operator.lab.datasets.mano.pickle_machine import Machine
from smooth_operator.lab.datasets.mano.pickle_parts import Budget, NotDataError, Numeric


class Storage:
    """The numbers of tensors, in the form that PyTorch writes into a plain pickle.

    Args:
        raw: what ``torch.save`` wrote in its old form: four pickles, then the numbers.
    """

    def __init__(self, raw: bytes) -> None:
        self.raw = raw

    def numbers(self) -> np.ndarray:
        """(n,) its numbers.

        Raises:
            NotDataError: it is damaged, or of an element type that is not read.
        """
        start = next((len(head) for head in _heads if self.raw.startswith(head)), 0)
        machine = Machine(self.raw, start, Budget(len(self.raw)), _storage_kind, _storage_key)
        if not start:
            _check_head(machine)
        found, keys = machine.run(), machine.run()
        if not isinstance(found, _StorageKey) or keys != [found.key]:
            raise NotDataError("its tensor is damaged")
        count = machine.number("<q", 8)
        itemsize = np.dtype(found.code).itemsize
        if count != found.count or not 0 <= count <= len(self.raw) // itemsize:
            raise NotDataError("its tensor is damaged")
        return np.frombuffer(machine.take(count * itemsize), found.code)


_heads: list[bytes] = []
"""Beginnings that have been checked: a file repeats one for each of its thousands of tensors."""


def _check_head(machine: Machine) -> None:
    """The three pickles before that of the storage."""
    magic, version, system = machine.run(), machine.run(), machine.run()
    if magic != _TORCH_MAGIC or version != 1001:
        raise NotDataError("it has a tensor in a form that is not read")
    if not isinstance(system, dict) or system.get("little_endian") is not True:
        raise NotDataError("its tensor is damaged")
    if len(_heads) < 8:
        _heads.append(machine.data[: machine.at])


class _StorageKey:
    def __init__(self, code: str, key: str, count: int) -> None:
        self.code, self.key, self.count = code, key, count


class _StorageType:
    def __init__(self, code: str) -> None:
        self.code = code


_TORCH_MAGIC: Final = 0x1950A86A20F9469CFC6C
_TORCH_TYPES: Final = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8",
    "IntStorage": "<i4", "ShortStorage": "<i2", "CharStorage": "i1", "ByteStorage": "u1",
    "BoolStorage": "?",
}  # fmt: skip


def _storage_kind(module: str, name: str) -> Any:
    kinds = ("torch", "torch.cuda", "torch.storage")
    if module in kinds and name in _TORCH_TYPES:
        return _StorageType(_TORCH_TYPES[name])
    raise NotDataError(f"it asks for {module}.{name}, which is no data")


def _storage_key(identifier: Any) -> _StorageKey:
    if not isinstance(identifier, tuple) or len(identifier) not in (5, 6):
        raise TypeError("storage")
    word, kind, key, _, count, *view = identifier
    if word != "storage" or not isinstance(kind, _StorageType) or any(view):
        raise TypeError("storage")
    if not isinstance(key, str) or not isinstance(count, int):
        raise TypeError("storage")
    return _StorageKey(kind.code, key, count)


class Tensor(Numeric):
    """A tensor of PyTorch; its numbers are read when they are wanted."""

    def __init__(self, storage: Any, offset: Any, size: Any, stride: Any) -> None:
        if not isinstance(storage, Storage) or not isinstance(offset, int) or offset < 0:
            raise TypeError("tensor")
        self.storage, self.offset = storage, offset
        self.size, self.stride = lengths(size), lengths(stride)
        if len(self.size) != len(self.stride):
            raise ValueError("tensor")

    def array(self) -> np.ndarray:
        """Its numbers."""
        found = self.storage.numbers()
        spans = [(n - 1) * step for n, step in zip(self.size, self.stride, strict=True)]
        count = math.prod(self.size)
        if count and self.offset + sum(spans) >= len(found):
            raise NotDataError("its tensor is damaged")
        if count > len(found):  # the same number many times, which parameters of hands are not
            raise NotDataError("its tensor takes more than its numbers")
        plain = tuple(math.prod(self.size[i + 1 :]) for i in range(len(self.size)))
        if self.stride == plain:
            return found[self.offset : self.offset + count].reshape(self.size)
        steps = [step * found.itemsize for step in self.stride]
        strided = np.lib.stride_tricks.as_strided(found[self.offset :], self.size, steps)
        return strided.copy()
