"""Reads untrusted regular files, and defines the limits for parsing them.

The parsers of the standard library accept brackets nested until the stack overflows, whole numbers
too long for a float, and dotted keys that take minutes. Every document from a user, a file or a
network is read with ``read_text``, ``parse_toml`` (``io.entries``) or ``parse_json``
(``io.documents``), which only raise ``DocumentError``.
"""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Final

from smooth_operator.errors import DocumentError

MOST_BYTES: Final = 8_000_000
"""Longest text that is parsed by default."""

MOST_LEVELS: Final = 64
"""Largest number of nested lists and tables. The documents of this package have six levels."""

MOST_DIGITS: Final = 20
"""Largest number of digits of a whole number; 64-bit integers do not have more."""


def check_plain_file(path: Path) -> int:
    """Returns the size of a regular file in bytes; refuses anything else. Links are followed.

    Opening a pipe could wait forever for a writer.

    Raises:
        OSError: there is no such file, or its status can't be read.
        DocumentError: it is a folder, a pipe, a socket or a device.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
        kind = kinds.get(stat.S_IFMT(status.st_mode), "a device")
        raise DocumentError(f"it is {kind}, not a regular file")
    return status.st_size


def read_text(path: Path, *, most_bytes: int = MOST_BYTES) -> str:
    """Reads a regular file in UTF-8; a byte order mark is removed.

    Raises:
        OSError: there is no such file, or it can't be read.
        DocumentError: it is not a regular file, is longer than ``most_bytes``, or is not UTF-8.
    """
    size = check_plain_file(path)
    with path.open("rb") as stream:
        data = b"" if size > most_bytes else stream.read(most_bytes + 1)
    if size > most_bytes or len(data) > most_bytes:
        raise DocumentError(f"it has {max(size, len(data))} bytes, more than {most_bytes}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DocumentError(f"it is not text in UTF-8: {error}") from error


def too_deep() -> DocumentError:
    """Creates the error for a text that is nested more than ``MOST_LEVELS`` deep."""
    return DocumentError(f"it has more than {MOST_LEVELS} levels of lists and tables")
