"""Values as Protocol Buffers have them on the wire, for messages written many times a second.

The library's objects take several times as long. What is written here is held against the library
in the tests. Source: https://protobuf.dev/programming-guides/encoding
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any, Final

import numpy as np

_FLOAT64: Final = np.dtype("<f8")
_FIXED64, _BYTES = 1, 2
_SMALL: Final = tuple(bytes((value,)) for value in range(256))

pack_double: Final = struct.Struct("<Bd").pack
"""A field of a double: ``double_key(number)`` and the value."""


def double_key(number: int) -> int:
    """What stands before a double; fields up to 15."""
    return number << 3 | _FIXED64


def varint(value: int) -> bytes:
    """A whole number from 0 on."""
    if value < 0x80:
        return _SMALL[value]
    if value < 0x4000:
        return _SMALL[value & 0x7F | 0x80] + _SMALL[value >> 7]
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def whole(number: int, value: int) -> bytes:
    """A field of a whole number, an enumeration or a flag; negative ones as of ``int64``."""
    return varint(number << 3) + varint(value & 0xFFFF_FFFF_FFFF_FFFF)


@lru_cache(maxsize=1024)
def head(number: int, length: int) -> bytes:
    """What stands before the bytes of a field."""
    return varint(number << 3 | _BYTES) + varint(length)


def part(number: int, content: bytes) -> bytes:
    """A field of bytes, or of a message."""
    return head(number, len(content)) + content


@lru_cache(maxsize=1024)
def text(number: int, value: str) -> bytes:
    """A field of text."""
    return part(number, value.encode())


@lru_cache(maxsize=256)
def texts(number: int, values: tuple[str, ...]) -> bytes:
    """A repeated field of text."""
    return b"".join(text(number, value) for value in values)


def doubles(number: int, values: Any) -> bytes:
    """A repeated field of doubles, packed, from an array of any shape."""
    content = np.asarray(values, _FLOAT64).tobytes()
    return head(number, len(content)) + content


def flags(number: int, values: Any) -> bytes:
    """A repeated field of truth values, packed."""
    content = np.asarray(values, np.bool_).tobytes()
    return head(number, len(content)) + content


def time(number: int, at: int) -> bytes:
    """A field of ``google.protobuf.Timestamp``; ``at`` in nanoseconds from 0 on."""
    seconds, nanoseconds = divmod(at, 1_000_000_000)
    content = _seconds(seconds) + varint(nanoseconds)
    return head(number, len(content)) + content


@lru_cache(maxsize=16)
def _seconds(value: int) -> bytes:
    return whole(1, value) + b"\x10"
