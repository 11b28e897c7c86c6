"""What the globals of a pickle stand for.

Each is named here, by its module and name; all others are refused. Nothing is imported.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, Final

from smooth_operator.lab.datasets.mano.pickle_arrays import (
    NDARRAY,
    Chumpy,
    Dtype,
    PickledArray,
    SparseMatrix,
    Stated,
    from_buffer,
    new_array,
    scalar,
)
from smooth_operator.lab.datasets.mano.pickle_parts import Budget, Maker, NotDataError
from smooth_operator.lab.datasets.mano.pickle_tensors import Storage, Tensor

MOST_LEVELS: Final = 64
"""Levels of containers in each other."""


def _new(budget: Budget, kind: Any, *arguments: Any) -> Any:
    if not isinstance(kind, Maker):
        raise TypeError("class")
    return kind.make(budget, *arguments)


def _reconstructed(budget: Budget, kind: Any, base: Any, state: Any = None) -> Any:
    if not isinstance(kind, Maker) or base is not _OBJECT or state is not None:
        raise TypeError("class")
    return kind.make(budget)


def _plain_set(budget: Budget, items: Any = ()) -> set[Any]:
    if not isinstance(items, list | tuple) or not all(isinstance(i, str | int) for i in items):
        raise TypeError("set")
    budget.take(240 + 32 * len(items))
    return set(items)


def _ordered(budget: Budget, items: Any = ()) -> dict[Any, Any]:
    if not isinstance(items, list | tuple) or items:
        raise TypeError("table")
    budget.take(80)
    return {}


def _encoded(budget: Budget, text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise TypeError("bytes")
    return text.encode("latin-1")


def _storage(budget: Budget, raw: Any) -> Storage:
    if not isinstance(raw, bytes):
        raise TypeError("storage")
    return Storage(raw)


def _parameter(budget: Budget, tensor: Any, *_: Any) -> Any:
    return tensor


_OBJECT: Final = Maker(lambda budget: Stated("object"))
_MAKERS: Final[dict[str, Callable[..., Any]]] = {
    "builtins.set": _plain_set,
    "builtins.frozenset": _plain_set,
    "builtins.bytes": lambda budget: b"",
    "builtins.bytearray": lambda budget, raw=b"", *_: raw,
    "builtins.complex": lambda budget, real, imaginary: complex(real, imaginary),
    "_codecs.encode": _encoded,
    "collections.OrderedDict": _ordered,
    "copyreg.__newobj__": _new,
    "copyreg._reconstructor": _reconstructed,
    "numpy.dtype": lambda budget, code, *_: Dtype(code),
    "numpy.core.multiarray._reconstruct": new_array,
    "numpy.core.multiarray.scalar": scalar,
    "numpy.core.numeric._frombuffer": from_buffer,
    "torch.Size": lambda budget, lengths: lengths(tuple(lengths)),
    "torch._utils._rebuild_parameter": _parameter,
    "torch._utils._rebuild_tensor": lambda budget, *of: Tensor(*of),
    "torch._utils._rebuild_tensor_v2": lambda budget, a, b, c, d, *_: Tensor(a, b, c, d),
    "torch.storage._load_from_bytes": _storage,
}
_GLOBALS: Final[dict[str, Any]] = {
    **{name: Maker(make) for name, make in _MAKERS.items()},
    "builtins.object": _OBJECT,
    "numpy.ndarray": NDARRAY,
}
_OLD_NAMES: Final = {
    "__builtin__": "builtins",
    "copy_reg": "copyreg",
    "numpy._core.multiarray": "numpy.core.multiarray",
    "numpy._core.numeric": "numpy.core.numeric",
}
_SPARSE: Final = re.compile(r"scipy\.sparse\._?(csc|csr)\.(csc|csr)_(matrix|array)")


def find_global(module: str, name: str) -> Any:
    """What stands for a global.

    Raises:
        NotDataError: it is no data, with its name.
    """
    module = _OLD_NAMES.get(module, module)
    whole = f"{module}.{name}"
    found = _GLOBALS.get(whole)
    if found is not None:
        return found
    sparse = _SPARSE.fullmatch(whole)
    if sparse:
        kind = sparse[2]
        return Maker(lambda budget, *_: SparseMatrix(kind))
    if re.fullmatch(r"chumpy(\.\w+)+", whole):
        return Maker(lambda budget, *_: Chumpy(whole))
    raise NotDataError(f"it asks for {whole[:120]!r}, which is no data")


def check_nesting(value: Any) -> None:
    """Refuses containers that hold themselves, or are nested deeper than ``MOST_LEVELS``.

    Raises:
        NotDataError: they do, they are, or an array of objects is among them.
    """
    heights: dict[int, int] = {}  # of containers that are done; -1 of those that are not
    left: list[tuple[Any, bool]] = [(value, False)]
    while left:
        one, done = left.pop()
        inner = _children(one)
        if inner is None or (not done and heights.get(id(one), -1) > 0):
            continue
        if done:
            heights[id(one)] = 1 + max((heights.get(id(i), 0) for i in inner), default=0)
            if heights[id(one)] > MOST_LEVELS:
                raise NotDataError(f"it has more than {MOST_LEVELS} levels of lists and tables")
            continue
        if heights.get(id(one)) == -1:
            raise NotDataError("it has a list or table that holds itself")
        heights[id(one)] = -1
        left.append((one, True))
        left += [(child, False) for child in inner if _children(child) is not None]


def _children(value: Any) -> Any:
    kind = type(value)
    if kind is dict:
        return value.values()
    if kind is list or kind is tuple:
        return value
    if isinstance(value, Stated):
        return (value.state,)
    if kind is PickledArray and value.objects is not None:
        raise NotDataError("it has an array of objects among its values")
    return None
