"""A clip with robot commands as bytes, for the time between its retargeting and its shard."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from typing import Any, Final

import numpy as np

from smooth_operator.formats.jsonable import to_json
from smooth_operator.lab.datasets.retargeting import shared_config
from smooth_operator.lab.datasets.robot_clip import RobotClip
from smooth_operator.lab.datasets.store import decoded, encoded

_LENGTH: Final = struct.Struct("<Q")


def encode(whole: RobotClip) -> bytes:
    """A clip, before it is filtered, as one piece; a pack of ``store`` holds the same of many."""
    arrays, document = encoded(whole)
    values = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    fields = {
        "arrays": {name: [array.dtype.str, array.shape] for name, array in values.items()},
        "document": document,
        "config": to_json(whole.config),
    }
    text = to_json(fields).encode()
    content = (array.tobytes() for array in values.values())
    return b"".join((_LENGTH.pack(len(text)), text, *content))


def decode(content: bytes) -> RobotClip:
    """A clip from what ``encode`` gave; its arrays can't be written to."""
    (length,) = _LENGTH.unpack_from(content)
    at = _LENGTH.size + length
    fields: dict[str, Any] = json.loads(content[_LENGTH.size : at])
    arrays: dict[str, np.ndarray] = {}
    for name, (kind, shape) in fields["arrays"].items():
        dtype, count = np.dtype(kind), int(np.prod(shape, dtype=int))
        arrays[name] = np.frombuffer(content, dtype, count, at).reshape(shape)
        at += count * dtype.itemsize
    whole = decoded(arrays, fields["document"])
    return replace(whole, config=shared_config(fields["config"]))
