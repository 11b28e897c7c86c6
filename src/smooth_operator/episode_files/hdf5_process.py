"""The process that opens an HDF5 file, as a separate script.

libhdf5 loops for ever over some damaged files, within compiled code that no signal handler of
Python interrupts, and its memory is not bounded by anything in the file. So it runs here, under
limits of the operating system where that has them, and the process that waits for it can end it.

A line of JSON on standard input, ``[file, bytes, seconds, head]``, asks for a file. The answer on
standard output is the length of a JSON text (8 bytes, little-endian), the text, and the data of its
arrays one after the other. The process ends with its input, or when nothing was asked for a while.
It imports nothing of this package, which would take longer than most files.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import threading
from typing import Any

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
    "transforms": (*EGODEX_JOINTS["right"], *EGODEX_JOINTS["left"], "camera"),
    "confidences": EGODEX_JOINTS["right"] + EGODEX_JOINTS["left"],
    "camera": ("intrinsic",),
    "/": ("configuration",),
    "hand": ("landmarks", "stamps", "valid", "metacarpals", "orientations", "T_world_wrist"),
    "commands": (
        *("joint_positions", "joint_names", "stamps", "latency_ms", "status"),
        *("wrist", "wrist_engaged", "wrist_valid"),
        *("arm", "arm_measured", "arm_wrist"),
    ),
    "state": ("joint_positions", "joint_names", "stamps", "actuator_names", "currents", "touch"),
}
"""Of the groups; all arrays of ``stages_ms`` are read."""

_MOST_STAGES = 64
_MOST_NAMES = 100
_MOST_ATTRIBUTES = 100
_MOST_WORDS = 4096
_TEXT_BYTES = 64
_IDLE_S = 10.0


class RefusedError(Exception):
    """The file holds what is not read; the message follows its name."""


def read(path: str, most: int, *, head: bool = False) -> tuple[dict[str, Any], list[Any]]:
    """What a file holds: a tree that JSON can say, and the arrays that it refers to by number.

    Args:
        path: the file.
        most: bytes that its arrays may take.
        head: only the attributes of the file.

    Raises:
        RefusedError: it holds links, data of other files, or more than ``most``.
        Exception: whatever h5py raises on damaged bytes.
    """
    import h5py

    values: list[Any] = []
    tree: dict[str, Any] = {}
    with h5py.File(path, "r", locking=False) as file:
        tree["/"] = _group(file, ARRAYS["/"] if not head else (), most, values, h5py)
        for name in () if head else GROUPS:
            parent, _, last = name.rpartition("/")
            above = file if not parent else file[parent] if parent in tree else None
            if above is None or last not in above:
                continue
            group = _linked(above, last, h5py)
            if isinstance(group, h5py.Group):
                arrays = ARRAYS.get(name) or tuple(_names(group, _MOST_STAGES + 1))
                if len(arrays) > _MOST_STAGES:
                    raise RefusedError(f"its group {name} holds more than {_MOST_STAGES} arrays")
                tree[name] = _group(group, arrays, most, values, h5py)
    return tree, values


def _group(group: Any, arrays: tuple[str, ...], most: int, result: list[Any], h5py: Any) -> Any:
    held = {}
    for name in arrays:
        if name in group:
            data = _linked(group, name, h5py)
            if isinstance(data, h5py.Dataset):
                held[name] = _array(data, most, result, h5py)
    return {
        "name": group.name,
        "names": _names(group, _MOST_NAMES),
        "attributes": _attributes(group, h5py),
        "arrays": held,
    }


def _names(group: Any, most: int) -> list[str]:
    names: list[str] = []
    for name in group:
        if len(names) == most:
            break
        names.append(name)
    return names


def _linked(group: Any, name: str, h5py: Any) -> Any:
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise RefusedError(f"its {name!r} is a link to another place, which is not followed")
    return group[name]


def _array(data: Any, most: int, result: list[Any], h5py: Any) -> dict[str, Any]:
    import numpy as np

    dtype, shape = data.dtype, data.shape  # h5py asks the file each time
    entry: dict[str, Any] = {
        "shape": list(shape or ()),
        "type": str(dtype),
        "kind": dtype.kind,
        "attributes": _attributes(data, h5py),
    }
    if shape is None:  # an array without a space
        raise RefusedError(f"its array {data.name} is empty")
    if data.external or data.is_virtual:
        raise RefusedError(f"the data of {data.name} stand in other files, which are not read")
    words = h5py.check_string_dtype(dtype) is not None
    each = max(dtype.itemsize, _TEXT_BYTES if words else 8)
    takes = max(math.prod(shape), math.prod(data.chunks or ())) * each
    if takes + sum(array.nbytes for array in result) > most:
        raise RefusedError(
            f"it would take {takes / 1e6:,.0f} MB of memory to read {data.name}, more than is "
            f"allowed for a file of this size ({most / 1e6:,.0f} MB for all)"
        )
    if words:
        if math.prod(shape) > _MOST_WORDS:
            raise RefusedError(f"its array {data.name} holds more than {_MOST_WORDS} texts")
        entry["texts"] = [_text(item) for item in np.ravel(data[()])]
    elif dtype.kind in "fiub":
        kind = {"f": "<f8", "b": "|b1", "i": "<i8", "u": "<i8"}[dtype.kind]
        entry["stored"], entry["index"] = kind, len(result)
        with np.errstate(all="ignore"):
            result.append(np.ascontiguousarray(data[()], kind))
    return entry


def _attributes(item: Any, h5py: Any) -> dict[str, Any]:
    import numpy as np

    held: dict[str, Any] = {}
    for name in list(item.attrs)[:_MOST_ATTRIBUTES]:
        with contextlib.suppress(KeyError):
            about = item.attrs.get_id(name)
            count = math.prod(about.shape)
            if count > _MOST_WORDS or count * about.dtype.itemsize > 1 << 20:
                continue
            value = item.attrs[name]
            if isinstance(value, h5py.Empty):
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


def limit(memory: int, seconds: int) -> None:
    """Limits this process where the system can.

    Args:
        memory: beyond what it has now [bytes].
        seconds: of the processor, from now on.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    import time

    kinds = {resource.RLIMIT_CPU: int(time.process_time()) + 1 + seconds, resource.RLIMIT_CORE: 0}
    with contextlib.suppress(OSError, ValueError):
        with open("/proc/self/statm") as stream:
            pages = int(stream.read().split()[0])
        kinds[resource.RLIMIT_AS] = pages * resource.getpagesize() + memory
    for kind, value in kinds.items():
        with contextlib.suppress(OSError, ValueError):
            hard = resource.getrlimit(kind)[1]
            resource.setrlimit(kind, (value if hard < 0 else min(value, hard), hard))


def answer(path: str, most: int, seconds: int, head: bool) -> None:
    """Answers for one file; an error is an answer, too."""
    limit(4 * most + (256 << 20), seconds)
    arrays: list[Any] = []
    try:
        tree, arrays = read(path, most, head=head)
        answer_head: dict[str, Any] = {"tree": tree}
    except RefusedError as error:
        answer_head = {"refused": str(error)}
    except Exception as error:  # h5py promises no list of what damaged bytes raise
        answer_head = {"damaged": f"{error or type(error).__name__}"[:300]}
    text = json.dumps(answer_head).encode()
    sys.stdout.buffer.write(len(text).to_bytes(8, "little") + text)
    for array in arrays:
        sys.stdout.buffer.write(array.data)
    sys.stdout.buffer.flush()


def main() -> None:
    """Answers until the input ends."""
    import h5py  # before the limits, which are for the file
    import numpy

    assert h5py, numpy
    while True:
        idle = threading.Timer(_IDLE_S, os._exit, (0,))
        idle.daemon = True
        idle.start()
        line = sys.stdin.buffer.readline()
        idle.cancel()
        if not line:
            return
        answer(*json.loads(line))


if __name__ == "__main__":
    main()
